// Arrays of Python's, by the buffer protocol, so that any NumPy will do.
#pragma once

#include <pybind11/pybind11.h>

#include <stdexcept>
#include <string>
#include <type_traits>

namespace kernel {

namespace py = pybind11;

// Whatever Python hands over is checked, so that nothing here reads beyond an array.
inline void expect(bool right, const char* name) {
    if (!right) throw std::invalid_argument(std::string("wrong array: ") + name);
}

// A contiguous array of Python's, kept as long as this is; of a const T if it is only read.
template <typename T>
class Array {
public:
    Array(const py::buffer& given, const char* name)
        : info_(given.request(!std::is_const_v<T>)) {
        using Number = std::remove_const_t<T>;
        py::ssize_t stride = sizeof(T);
        bool right = info_.itemsize == stride
                     && py::detail::compare_buffer_info<Number>::compare(info_);
        for (py::ssize_t axis = info_.ndim - 1; axis >= 0; --axis) {
            right = right && (info_.strides[axis] == stride || info_.shape[axis] < 2);
            stride *= info_.shape[axis];
        }
        expect(right, name);
    }
    Array(const py::buffer& given, const char* name, std::size_t size) : Array(given, name) {
        expect(this->size() == size, name);
    }
    Array(const py::dict& given, const char* name, std::size_t size)
        : Array(given[name].cast<py::buffer>(), name, size) {}

    T* data() const { return static_cast<T*>(info_.ptr); }
    T& operator[](std::size_t i) const { return data()[i]; }
    std::size_t size() const { return std::size_t(info_.size); }
    std::size_t axes() const { return std::size_t(info_.ndim); }
    std::size_t shape(std::size_t axis) const { return std::size_t(info_.shape[axis]); }

private:
    py::buffer_info info_;
};

inline std::size_t size_of(const py::buffer& given) { return std::size_t(given.request().size); }

inline std::size_t size_of(const py::dict& given, const char* name) {
    return size_of(given[name].cast<py::buffer>());
}

}  // namespace kernel
