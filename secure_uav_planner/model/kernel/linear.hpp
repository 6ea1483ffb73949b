// The linear system of a Newton step: a band, and a row for each average power.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <type_traits>
#include <vector>

namespace kernel {

constexpr double FIRST_SHIFT = 1e-12;  // For matrices that are singular by rounding.
// Failures after which more and more slots are made convex at once, and after which all are.
constexpr int SINGLE_SLOTS = 3, ALL_SLOTS = 12;
// Of the diagonal, when all slots have been made convex.
constexpr std::array<double, 9> SHIFTS{1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6, 1e8};

// Replace a symmetric matrix (size, size), of which the lower triangle counts, by what it lacks
// to be positive semidefinite. `space` holds size * (2 * size + 2) numbers.
void find_negative_part(double* matrix, int size, double* space);

// Solve a small dense system in place by elimination with row pivots; return false if singular.
bool solve_dense(double* matrix, double* right, int size);

inline bool is_finite(const double* numbers, std::size_t count) {
    return std::all_of(numbers, numbers + count, [](double x) { return std::isfinite(x); });
}

// Factor a symmetric band matrix as L D L^T, beginning at a column; those before it are factored.
//
// Column j holds the entries j, j + 1, ... j + below of the lower triangle; `below` more columns
// of zeros follow the last. Return the column at which it is not positive definite, or -1. In the
// factor, the first entry of a column is 1 / D.
template <int BELOW>
std::ptrdiff_t factor_band(const double* band, double* factor, std::ptrdiff_t columns,
                           int bandwidth, std::ptrdiff_t from) {
    const int below = BELOW ? BELOW : bandwidth;
    const int height = below + 1;
    std::copy(band + from * height, band + (from + below) * height, factor + from * height);
    // Subtract the columns before from those that are to be factored.
    for (std::ptrdiff_t j = std::max<std::ptrdiff_t>(0, from - below); j < from; ++j) {
        const double* column = factor + j * height;
        for (int k = int(from - j); k <= below; ++k) {
            const double multiplier = column[k] / column[0];
            double* later = factor + (j + k) * height - k;
            for (int i = k; i <= below; ++i) later[i] -= multiplier * column[i];
        }
    }
    for (std::ptrdiff_t j = from; j < columns; ++j) {
        double* column = factor + j * height;
        std::copy(band + (j + below) * height, band + (j + below + 1) * height,
                  column + below * height);
        if (!(column[0] > 0.0)) return j;
        const double inverse = 1.0 / column[0];
        for (int k = 1; k <= below; ++k) {
            const double multiplier = column[k] * inverse;
            double* later = column + k * height - k;
            for (int i = k; i <= below; ++i) later[i] -= multiplier * column[i];
        }
        column[0] = inverse;
        for (int k = 1; k <= below; ++k) column[k] *= inverse;
    }
    return -1;
}

// Divide several right sides, (columns + below, SIDES), by the L of a factor.
template <int BELOW, int SIDES>
void divide_by_lower(const double* factor, std::ptrdiff_t columns, int bandwidth, double* right,
                     int right_sides) {
    const int below = BELOW ? BELOW : bandwidth;
    const int sides = SIDES ? SIDES : right_sides;
    for (std::ptrdiff_t j = 0; j < columns; ++j) {
        const double* column = factor + j * (below + 1);
        double* row = right + j * sides;
        for (int k = 1; k <= below; ++k)
            for (int s = 0; s < sides; ++s) row[k * sides + s] -= column[k] * row[s];
    }
}

// Divide a right side, (columns + below), by L^T.
template <int BELOW>
void divide_by_upper(const double* factor, std::ptrdiff_t columns, int bandwidth, double* right) {
    const int below = BELOW ? BELOW : bandwidth;
    for (std::ptrdiff_t j = columns - 1; j >= 0; --j) {
        const double* column = factor + j * (below + 1);
        double sum = 0.0;
        for (int k = below; k > 0; --k) sum += column[k] * right[j + k];
        right[j] -= sum;
    }
}

// For a number of UAVs that is known when compiling, or for any (UAVS = 0).
template <int UAVS>
class NewtonSystem {
public:
    NewtonSystem(std::size_t slots, int uavs, int bandwidth, double unit)
        : slots_(slots), count_(uavs), below_(bandwidth), unit_(unit) {
        const std::size_t n = slots_, v = 3 * count_;
        blocks.resize(n * v * v);
        band.resize((n * v + below_) * (below_ + 1));
        factor_.resize(band.size());
        right_.resize((n * v + below_) * (1 + count_));
        convex_.resize(n);
        space_.resize(v * (2 * v + 4));
    }

    int height() const { return below_ + 1; }

    // Add a slot's block to the band.
    void add_block(std::size_t n, const double* block) {
        const int V = size();
        for (int j = 0; j < V; ++j)
            for (int i = j; i < V; ++i) band[(n * V + j) * height() + i - j] += block[i * V + j];
    }

    // Find minus the inverse of the Hessian, made positive definite, times the gradient. Return
    // false if that fails or is stopped. `mean_ratios`, (U), are the slacks of the average powers
    // divided by their duals.
    bool solve(const double* gradient, const double* mean_ratios, double* step,
               const std::atomic<bool>& stop) {
        const int U = uavs(), V = size(), sides = 1 + U;
        const std::size_t columns = slots_ * V;
        if (!is_finite(band.data(), band.size()) || !factor_positive_definite(stop)) return false;
        std::fill(right_.begin(), right_.end(), 0.0);
        for (std::size_t i = 0; i < columns; ++i) right_[i * sides] = -gradient[i];
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u)
                right_[(n * V + 3 * u) * sides + 1 + u] = -1.0 / double(slots_);
        with_bandwidth([this](auto below) {
            divide_by_lower<below.value, UAVS ? UAVS + 1 : 0>(
                factor_.data(), slots_ * size(), below_, right_.data(), 1 + uavs());
        });
        // Woodbury's formula for the rows of the average powers, before dividing by L^T.
        double* products = space_.data();
        double* right = products + U * U;
        std::fill(products, right + U, 0.0);
        for (std::size_t i = 0; i < columns; ++i) {
            const double* row = &right_[i * sides];
            const double inverse = factor_[i * height()];
            for (int u = 0; u < U; ++u) {
                const double scaled = row[1 + u] * inverse;
                right[u] += scaled * row[0];
                for (int s = 0; s <= u; ++s) products[u * U + s] += scaled * row[1 + s];
            }
        }
        for (int u = 0; u < U; ++u) {
            for (int s = 0; s < u; ++s) products[s * U + u] = products[u * U + s];
            products[u * U + u] += mean_ratios[u];
        }
        if (!solve_dense(products, right, U)) return false;
        for (std::size_t i = 0; i < columns; ++i) {
            const double* row = &right_[i * sides];
            double change = row[0];
            for (int u = 0; u < U; ++u) change -= row[1 + u] * right[u];
            step[i] = change * factor_[i * height()];
        }
        with_bandwidth([this, step](auto below) {
            divide_by_upper<below.value>(factor_.data(), slots_ * size(), below_, step);
        });
        return is_finite(step, columns);
    }

    std::vector<double> blocks;  // The objective's Hessian slot by slot, (N, 3 U, 3 U).
    std::vector<double> band;    // The Hessian with the limits' terms, by columns.

private:
    int uavs() const { return UAVS ? UAVS : count_; }
    int size() const { return 3 * uavs(); }

    // Factor the band after making it positive definite, as little as that takes.
    //
    // First, the blocks of the slots where the factorisation fails and of their neighbours are
    // projected on the semidefinite cone. All limits' terms are convex, so that this ends; shifts
    // of the diagonal then repair what is left of rounding.
    bool factor_positive_definite(const std::atomic<bool>& stop) {
        const int V = size();
        const std::ptrdiff_t slots = slots_;
        std::fill(convex_.begin(), convex_.end(), 0);
        std::ptrdiff_t left = slots;
        for (std::ptrdiff_t j = 0; j < slots * V; ++j) band[j * height()] += FIRST_SHIFT * unit_;
        std::ptrdiff_t begin = 0;  // The first column that has changed.
        for (int failures = 0; left; ++failures) {
            if (stop) return false;
            const std::ptrdiff_t failed = factor(begin);
            if (failed < 0) return true;
            std::ptrdiff_t first = 0, last = slots - 1;
            if (failures < ALL_SLOTS) {
                const std::ptrdiff_t width =
                    std::ptrdiff_t(1) << std::max(0, failures - SINGLE_SLOTS);
                const std::ptrdiff_t near_first = std::max(first, failed / V - width);
                const std::ptrdiff_t near_last = std::min(last, failed / V + width);
                if (!std::all_of(convex_.begin() + near_first, convex_.begin() + near_last + 1,
                                 [](char convex) { return convex; })) {
                    first = near_first;
                    last = near_last;
                }
            }
            begin = failed;
            for (std::ptrdiff_t n = first; n <= last; ++n) {
                if (convex_[n]) continue;
                convex_[n] = 1;
                --left;
                begin = std::min(begin, n * V);
                find_negative_part(&blocks[n * V * V], V, space_.data());
                add_block(n, &blocks[n * V * V]);
            }
        }
        double scale = unit_;
        for (std::ptrdiff_t j = 0; j < slots * V; ++j)
            scale = std::max(scale, std::fabs(band[j * height()]));
        for (const double shift : SHIFTS) {
            if (stop) return false;
            if (factor(0) < 0) return true;
            for (std::ptrdiff_t j = 0; j < slots * V; ++j) band[j * height()] += shift * scale;
        }
        return false;
    }

    // Call a function with the bandwidth as a constant where points are coupled with the next,
    // with separation or without, or with the next two; else with 0.
    template <typename Function>
    auto with_bandwidth(Function function) {
        constexpr int V = 3 * UAVS;
        if (UAVS && below_ == V + 1) return function(std::integral_constant<int, V + 1>());
        if (UAVS && below_ == 2 * V + 1) return function(std::integral_constant<int, 2 * V + 1>());
        if (UAVS > 1 && below_ == 2 * V - 2)
            return function(std::integral_constant<int, (UAVS > 1) ? 2 * V - 2 : 0>());
        return function(std::integral_constant<int, 0>());
    }

    std::ptrdiff_t factor(std::ptrdiff_t from) {
        return with_bandwidth([this, from](auto below) {
            return factor_band<below.value>(band.data(), factor_.data(), slots_ * size(), below_,
                                            from);
        });
    }

    const std::size_t slots_;
    const int count_, below_;
    const double unit_;  // Of the objective.
    std::vector<double> factor_, right_, space_;
    std::vector<char> convex_;
};

}  // namespace kernel
