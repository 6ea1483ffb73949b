// Linear algebra of small and of band matrices.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "problem.hpp"

namespace kernel {

// Turn a symmetric matrix (size, size), of which the lower triangle counts, into what it lacks
// to be positive semidefinite. `space` holds size * (2 * size + 2) numbers.
void negative_part(double* matrix, int size, double* space);

// Solve a small dense system in place by elimination with row pivots; return whether it worked.
bool solve_small(double* matrix, double* right, int size);

// Factor a symmetric band matrix as L D L^T, from a column on; what is before it is factored.
//
// Column j holds the entries j, j + 1, ... j + below of the lower triangle; `below` more columns
// of zeros follow the last. Return the column at which it is not positive definite, or -1. In the
// factor, the first entry of a column is 1 / D.
template <int BELOW>
std::ptrdiff_t factor_band(const double* band, double* factor, std::ptrdiff_t columns,
                           int below_given, std::ptrdiff_t from) {
    const int below = BELOW ? BELOW : below_given;
    const int height = below + 1;
    std::copy(band + from * height, band + (from + below) * height, factor + from * height);
    // What the columns before take away from those that are to be factored.
    for (std::ptrdiff_t j = std::max<std::ptrdiff_t>(0, from - below); j < from; ++j) {
        const double* column = factor + j * height;
        for (int k = int(from - j); k <= below; ++k) {
            const double by = column[k] / column[0];
            double* later = factor + (j + k) * height - k;
            for (int i = k; i <= below; ++i) later[i] -= by * column[i];
        }
    }
    for (std::ptrdiff_t j = from; j < columns; ++j) {
        double* column = factor + j * height;
        std::copy(band + (j + below) * height, band + (j + below + 1) * height,
                  column + below * height);
        if (!(column[0] > 0.0)) return j;
        const double inverse = 1.0 / column[0];
        for (int k = 1; k <= below; ++k) {
            const double by = column[k] * inverse;
            double* later = column + k * height - k;
            for (int i = k; i <= below; ++i) later[i] -= by * column[i];
        }
        column[0] = inverse;
        for (int k = 1; k <= below; ++k) column[k] *= inverse;
    }
    return -1;
}

// Whether any of some numbers is not finite.
inline bool any_infinite(const double* numbers, std::size_t count) {
    return !std::all_of(numbers, numbers + count, [](double one) { return std::isfinite(one); });
}

// The first half of solving by the factor of a band, for several right sides (columns + below,
// SIDES): divide by L.
template <int BELOW, int SIDES>
void divide_by_lower(const double* factor, std::ptrdiff_t columns, int below_given, double* right,
                     int sides_given) {
    const int below = BELOW ? BELOW : below_given;
    const int sides = SIDES ? SIDES : sides_given;
    for (std::ptrdiff_t j = 0; j < columns; ++j) {
        const double* column = factor + j * (below + 1);
        double* row = right + j * sides;
        for (int k = 1; k <= below; ++k)
            for (int s = 0; s < sides; ++s) row[k * sides + s] -= column[k] * row[s];
    }
}

// The second half, for one right side (columns + below): divide by L^T.
template <int BELOW>
void divide_by_upper(const double* factor, std::ptrdiff_t columns, int below_given,
                     double* right) {
    const int below = BELOW ? BELOW : below_given;
    for (std::ptrdiff_t j = columns - 1; j >= 0; --j) {
        const double* column = factor + j * (below + 1);
        double sum = 0.0;
        for (int k = below; k > 0; --k) sum += column[k] * right[j + k];
        right[j] -= sum;
    }
}

}  // namespace kernel
