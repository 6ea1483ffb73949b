// Lemma 9 of bound/proof: which places a UAV reaches in time around what it may not enter. See
// detours.py.
#pragma once

#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "array.hpp"

namespace kernel {

class Detours {
public:
    explicit Detours(const py::dict& given)
        : low_(given, "detour_low", 2), size_(given, "detour_size", 2),
          lengths_(given["detour_lengths"].cast<py::buffer>(), "detour_lengths"),
          side_(lengths_.axes() == 3 ? lengths_.shape(2) : 0) {
        expect(lengths_.size() == 2 * side_ * side_, "detour_lengths");
    }

    // Whether a UAV may be somewhere in a rectangle, with ways of `near` from its start and of
    // `far` to its goal.
    bool reaches(const double* low, const double* high, double near, double far) const {
        if (!side_) return true;
        double first[2], last[2];
        for (int i = 0; i < 2; ++i) {
            const double begin = low_[i], size = size_[i];
            first[i] = std::max(0.0, std::floor((low[i] - begin) / size - 1e-7));
            last[i] = std::min(double(side_) - 1, std::floor((high[i] - begin) / size + 1e-7));
        }
        const double* there = lengths_.data();
        const double* back = there + side_ * side_;
        for (double i = first[0]; i <= last[0]; ++i)
            for (double j = first[1]; j <= last[1]; ++j) {
                const std::size_t cell = std::size_t(i) * side_ + std::size_t(j);
                if (there[cell] <= near && back[cell] <= far) return true;
            }
        return false;
    }

private:
    Array<const double> low_, size_, lengths_;
    std::size_t side_;
};

}  // namespace kernel
