// Arrays of Python's, for what is given by name.
#pragma once

#include <pybind11/pybind11.h>

#include <stdexcept>
#include <string>

namespace kernel {

namespace py = pybind11;

// A contiguous array of Python's, kept as long as this is.
template <typename T>
class Array {
public:
    Array(const py::dict& given, const char* name, std::size_t size) : Array(
        py::buffer(given[name].cast<py::buffer>()), name, size) {}
    Array(const py::buffer& given, const char* name, std::size_t size) : info_(given.request()) {
        bool right = info_.itemsize == sizeof(T) && std::size_t(info_.size) == size
                     && py::detail::compare_buffer_info<T>::compare(info_);
        py::ssize_t stride = sizeof(T);
        for (py::ssize_t axis = info_.ndim - 1; axis >= 0; --axis) {
            right = right && (info_.strides[axis] == stride || info_.shape[axis] < 2);
            stride *= info_.shape[axis];
        }
        if (!right) throw std::invalid_argument(std::string("wrong array: ") + name);
    }
    T& operator[](std::size_t i) const { return static_cast<T*>(info_.ptr)[i]; }

private:
    py::buffer_info info_;
};

inline std::size_t size_of(const py::dict& given, const char* name) {
    return std::size_t(given[name].cast<py::buffer>().request().size);
}

}  // namespace kernel
