// Arrays from Python, by the buffer protocol: this does not depend on NumPy's version.
#pragma once

#include <pybind11/pybind11.h>

#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

namespace kernel {

namespace py = pybind11;

// Throw std::invalid_argument, which names an argument, unless the argument is valid.
inline void expect(bool valid, const char* name) {
    if (!valid) throw std::invalid_argument(std::string("wrong array: ") + name);
}

// A contiguous array of Python's, which lives as long as this object; read only if T is const.
template <typename T>
class Array {
public:
    // View a Python buffer. Throw std::invalid_argument, which names `name`, unless the buffer is
    // contiguous in C order and of type T. If T is not const, a read-only buffer throws, too.
    Array(const py::buffer& buffer, const char* name)
        : info_(buffer.request(!std::is_const_v<T>)) {
        using Number = std::remove_const_t<T>;
        py::ssize_t stride = sizeof(T);
        bool valid = info_.itemsize == stride
                     && py::detail::compare_buffer_info<Number>::compare(info_);
        for (py::ssize_t axis = info_.ndim - 1; axis >= 0; --axis) {
            valid = valid && (info_.strides[axis] == stride || info_.shape[axis] < 2);
            stride *= info_.shape[axis];
        }
        expect(valid, name);
    }
    Array(const py::buffer& buffer, const char* name, std::size_t size) : Array(buffer, name) {
        expect(this->size() == size, name);
    }
    Array(const py::dict& args, const char* name, std::size_t size)
        : Array(args[name].cast<py::buffer>(), name, size) {}

    T* data() const { return static_cast<T*>(info_.ptr); }
    T& operator[](std::size_t i) const { return data()[i]; }
    std::size_t size() const { return std::size_t(info_.size); }
    std::size_t axes() const { return std::size_t(info_.ndim); }
    std::size_t shape(std::size_t axis) const { return std::size_t(info_.shape[axis]); }

private:
    py::buffer_info info_;
};

inline std::size_t count_entries(const py::buffer& buffer) {
    return std::size_t(buffer.request().size);
}

inline std::size_t count_entries(const py::dict& args, const char* name) {
    return count_entries(args[name].cast<py::buffer>());
}

// Copy an array of `size` numbers: a buffer, or the entry `name` of a dict.
template <typename Source>
std::vector<double> copy_reals(const Source& source, const char* name, std::size_t size) {
    const Array<const double> array(source, name, size);
    return std::vector<double>(array.data(), array.data() + size);
}

template <typename Source>
std::vector<char> copy_flags(const Source& source, const char* name, std::size_t size) {
    const Array<const bool> array(source, name, size);
    return std::vector<char>(array.data(), array.data() + size);
}

// Throw if Ctrl-C was pressed. Called now and then by code without the interpreter's lock.
inline void check_signals() {
    const py::gil_scoped_acquire acquire;
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

}  // namespace kernel
