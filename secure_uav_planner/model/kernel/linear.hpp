// The linear system of a Newton step: a band, a few dense rows, and shares that single slots have.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <type_traits>
#include <vector>

namespace kernel {

constexpr double FIRST_SHIFT = 1e-12;  // Shift of the diagonal against rounding, in units.
// After SINGLE_SLOTS failed factorisations, each doubles the number of slots that are made convex
// at once. After ALL_SLOTS failures all slots are made convex.
constexpr int SINGLE_SLOTS = 3, ALL_SLOTS = 12;
// Shifts of the diagonal, over its largest entry, that are tried when all slots are convex.
constexpr std::array<double, 9> SHIFTS{0.0, 1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6};

// Replace a symmetric matrix A by a positive semidefinite E so that A + E is positive semidefinite.
void find_modification(double* matrix, int size, double* space);

// Solve a small dense system in place; return false if it is singular.
bool solve_dense(double* matrix, double* right, int size);

inline bool is_finite(const double* numbers, std::size_t count) {
    return std::all_of(numbers, numbers + count, [](double x) { return std::isfinite(x); });
}

// row -= of_a a + of_b b + of_c c, each a row of `count` numbers.
// __restrict says that no output overlaps an input, so that loops need no test of that.
inline void subtract_rows(double of_a, const double* a, double of_b, const double* b,
                          double of_c, const double* c, int count, double* __restrict row) {
    for (int i = 0; i < count; ++i)
        row[i] = row[i] - of_a * a[i] - of_b * b[i] - of_c * c[i];
}

// Factor a symmetric band matrix as L D L^T from column `from` on; columns before it are factored
// already. Return the first column whose pivot is not positive, or -1. `bandwidth`, the number of
// rows below the diagonal, is used only if BELOW is 0; otherwise it is BELOW.
//
// Storage: column j of the lower triangle begins at j * height and has rows j to j + below, so
// height = below + 1. A pointer shifted by -k to column j + k has the entry of row j + i at index
// i. `below` more columns of zeros follow the last. A factored column is 1 / D, then L's entries.
//
// In wide bands the three columns of a UAV in a slot are subtracted from later columns at once, so
// that later columns are read and written once. In narrow bands loops of a few passes are unrolled.
// Multipliers of 0 are skipped, such as for powers of the next slot: slots do not couple powers.
template <int BELOW>
std::ptrdiff_t factor_band(const double* band, double* factor, std::ptrdiff_t columns,
                           int bandwidth, std::ptrdiff_t from) {
    constexpr bool WIDE = BELOW == 0 || BELOW > 12;
    const int below = BELOW ? BELOW : bandwidth;
    const int height = below + 1;
    std::copy(band + from * height, band + (from + below) * height, factor + from * height);
    // Subtract the factored columns from the columns that are to be factored.
    for (std::ptrdiff_t j = std::max<std::ptrdiff_t>(0, from - below); j < from; ++j) {
        const double* column = factor + j * height;
        for (int k = int(from - j); k <= below; ++k) {
            const double multiplier = column[k] / column[0];
            double* later = factor + (j + k) * height - k;
            for (int i = k; i <= below; ++i) later[i] -= multiplier * column[i];
        }
    }
    // Subtract column j, not yet divided by its pivot column[0], from the next `count` columns.
    const auto subtract = [=](std::ptrdiff_t j, int count) {
        const double* column = factor + j * height;
        const double inverse = 1.0 / column[0];
#pragma GCC unroll 16
        for (int k = 1; k <= count; ++k) {
            const double multiplier = column[k] * inverse;
            if (multiplier == 0.0) continue;
            double* __restrict later = factor + (j + k) * height - k;
            for (int i = k; i <= below; ++i) later[i] -= multiplier * column[i];
        }
    };
    // Divide columns by their pivots, and replace the pivots by their inverses.
    const auto scale = [=](std::ptrdiff_t begin, std::ptrdiff_t end) {
        for (std::ptrdiff_t j = begin; j < end; ++j) {
            double* column = factor + j * height;
            column[0] = 1.0 / column[0];
            for (int k = 1; k <= below; ++k) column[k] *= column[0];
        }
    };
    for (std::ptrdiff_t begin = from, end; begin < columns; begin = end) {
        // Whether to factor a UAV's three columns, begin, begin + 1 and begin + 2, together.
        const bool together = WIDE && begin % 3 == 0;
        end = begin + (together ? 3 : 1);
        for (std::ptrdiff_t j = begin; j < end; ++j) {
            std::copy(band + (j + below) * height, band + (j + height) * height,
                      factor + (j + below) * height);
            if (!(factor[j * height] > 0.0)) {
                scale(begin, j);
                return j;
            }
            subtract(j, together ? int(end - j) - 1 : below);
        }
        if (together) {
            // Columns begin, begin + 1 and begin + 2, shifted so that a[k], b[k] and c[k] are the
            // entries of row begin + k. They end with rows begin + below, + 1 and + 2.
            const double *a = factor + begin * height, *b = a + below, *c = b + below;
            const double inverse_a = 1.0 / a[0], inverse_b = 1.0 / b[1], inverse_c = 1.0 / c[2];
            for (int k = 3; k <= below + 2; ++k) {
                const double of_a = k <= below ? a[k] * inverse_a : 0.0;
                const double of_b = k <= below + 1 ? b[k] * inverse_b : 0.0;
                const double of_c = c[k] * inverse_c;
                if (of_a == 0.0 && of_b == 0.0 && of_c == 0.0) continue;
                // Column begin + k; later[i] is the entry of row begin + i.
                double* later = factor + (begin + k) * height - k;
                subtract_rows(of_a, a + k, of_b, b + k, of_c, c + k, below + 1 - k, later + k);
                if (k <= below + 1)
                    later[below + 1] =
                        later[below + 1] - of_b * b[below + 1] - of_c * c[below + 1];
                later[below + 2] -= of_c * c[below + 2];
            }
        }
        scale(begin, end);
    }
    return -1;
}

// Replace right sides B, (columns + below, sides), by L^-1 B with a factor's L: forward
// substitution. BELOW is the bandwidth, and SIDES the number of sides, if known when compiling, or
// 0. The three columns a, b and c of a UAV in a slot, j, j + 1 and j + 2, are subtracted at once:
// a[k], b[k] and c[k] are in row j + k.
template <int BELOW, int SIDES>
void divide_by_lower(const double* factor, std::ptrdiff_t columns, int bandwidth, double* right,
                     int right_sides) {
    const int below = BELOW ? BELOW : bandwidth;
    const int sides = SIDES ? SIDES : right_sides;
    for (std::ptrdiff_t j = 0; j < columns; j += 3) {
        const double *a = factor + j * (below + 1), *b = a + below, *c = b + below;
        double *row_a = right + j * sides, *row_b = row_a + sides, *row_c = row_b + sides;
        for (int s = 0; s < sides; ++s) {
            row_b[s] -= a[1] * row_a[s];
            row_c[s] = row_c[s] - a[2] * row_a[s] - b[2] * row_b[s];
        }
#pragma GCC unroll 16
        for (int k = 3; k <= below + 2; ++k) {
            const double of_a = k <= below ? a[k] : 0.0, of_b = k <= below + 1 ? b[k] : 0.0;
            if (of_a == 0.0 && of_b == 0.0 && c[k] == 0.0) continue;
            subtract_rows(of_a, row_a, of_b, row_b, c[k], row_c, sides, row_a + k * sides);
        }
    }
}

// Replace a right side b, (columns + below), by L^-T b with a factor's L: back substitution.
template <int BELOW>
void divide_by_upper(const double* factor, std::ptrdiff_t columns, int bandwidth, double* right) {
    const int below = BELOW ? BELOW : bandwidth;
    for (std::ptrdiff_t j = columns - 1; j >= 0; --j) {
        const double* column = factor + j * (below + 1);  // column[k] is in row j + k.
        double sum = 0.0;
        for (int k = below; k > 0; --k) sum += column[k] * right[j + k];
        right[j] -= sum;
    }
}

// The variables are x, (N, 3 U), which limits couple to a band, and behind them shares, (N, S).
// Shares are coupled only to their own slot and are eliminated from it. UAVS is the number of UAVs
// if it is known when compiling, or 0 for any number.
template <int UAVS>
class NewtonSystem {
public:
    // Reserve memory for `uavs` UAVs, `shares` variable shares in each slot and a number of dense
    // rows. `unit` is the unit of the objective, in which the first shift of the diagonal is.
    NewtonSystem(std::size_t slots, int uavs, int shares, int dense_rows, int bandwidth,
                 double unit)
        : slots_(slots), count_(uavs), shares_(shares), rows_(dense_rows), below_(bandwidth),
          unit_(unit) {
        const std::size_t n = slots_, v = 3 * count_, w = v + shares_;
        blocks.resize(n * w * w);
        rows.resize(n * w * rows_);
        share_curvatures.resize(n * (shares_ ? shares_ + 1 : 0));
        band.resize((n * v + below_) * (below_ + 1));
        factor_.resize(band.size());
        right_.resize((n * v + below_) * (1 + rows_));
        eliminated_.resize(shares_ ? blocks.size() : 0);
        share_right_.resize(n * shares_ * (1 + rows_));
        convex_.resize(n);
        space_.resize(std::max(w * (2 * w + 4), std::size_t(rows_ * (rows_ + 1))));
    }

    int height() const { return below_ + 1; }

    // Eliminate the shares of a slot from its block, and add what is left in x to the band.
    void add_slot(std::size_t n) {
        const int W = width();
        if (shares_) eliminate_shares(n);
        add_block(n, (shares_ ? &eliminated_[0] : &blocks[0]) + n * W * W);
    }

    // Fill `step` with minus the inverse of the Hessian times the gradient, where the Hessian is
    // first made positive definite. Return false if this fails or is stopped. The Hessian is the
    // band plus row row^T / ratio of each of R dense rows; `ratios` are (R).
    bool solve(const double* gradient, const double* ratios, double* step,
               const std::atomic<bool>& stop) {
        if (!is_finite(band.data(), band.size()) || !factor_positive_definite(stop)) return false;
        return rows_ == UAVS ? solve_factored<UAVS>(gradient, ratios, step)
            : rows_ == 2 * UAVS ? solve_factored<2 * UAVS>(gradient, ratios, step)
                                : solve_factored<0>(gradient, ratios, step);
    }
    std::vector<double> blocks;  // The objective's Hessian by slots, (N, 3 U + S, 3 U + S).
    std::vector<double> band;    // The Hessian with the limits' terms, by columns.
    std::vector<double> rows;    // The dense rows, by variables, (N (3 U + S), R).
    // Curvatures of the limits share > 0, (N, S + 1). The first share is 1 minus the S variables.
    std::vector<double> share_curvatures;

private:
    int uavs() const { return UAVS ? UAVS : count_; }
    int size() const { return 3 * uavs(); }
    int width() const { return size() + shares_; }
    // The number of dense rows; a constant if it is known when compiling.
    template <int ROWS>
    int row_count() const { return ROWS ? ROWS : rows_; }
    std::size_t share_index(std::size_t n, int j) const {
        return slots_ * size() + n * shares_ + j - size();
    }
    double* share_right(std::size_t n, int j) {
        return &share_right_[(n * shares_ + j - size()) * (1 + rows_)];
    }
    const double* pivot_row(std::size_t n, int j) const {
        return &eliminated_[(n * width() + j) * width()];
    }

    // Call a function for every share of a slot, the last one first, with the share's index j in
    // the slot and the row of its j multipliers, which ends with the inverse pivot at index j.
    template <typename Function>
    void for_pivots(std::size_t n, Function function) {
        for (int j = width() - 1; j >= size(); --j) function(j, pivot_row(n, j));
    }

    // Add the part of a slot's block that belongs to x, a lower triangle, to the band.
    void add_block(std::size_t n, const double* block) {
        const int V = size(), W = width();
        for (int j = 0; j < V; ++j)
            for (int i = j; i < V; ++i) band[(n * V + j) * height() + i - j] += block[i * W + j];
    }

    // Eliminate the shares of slot n from its block (W, W), W = V + S, the last share first, by
    // symmetric elimination. Row j >= V of a share then has its multipliers at i < j and its
    // inverse pivot at j. The curvatures (S + 1) of the limits share > 0 are added before. The
    // first share is 1 minus the S variable ones, so curvatures[0] is added to every pair of these.
    void eliminate_shares(std::size_t n) {
        const int V = size(), W = width();
        double* block = &eliminated_[n * W * W];
        std::copy(&blocks[n * W * W], &blocks[n * W * W] + W * W, block);
        const double* curvatures = &share_curvatures[n * (shares_ + 1)];
        for (int j = V; j < W; ++j) {
            for (int i = V; i <= j; ++i) block[j * W + i] += curvatures[0];
            block[j * W + j] += curvatures[1 + j - V];
        }
        for (int j = W - 1; j >= V; --j) {
            double* row = block + j * W;
            const double inverse = 1.0 / row[j];
            for (int i = 0; i < j; ++i) {
                const double multiplier = row[i] * inverse;
                for (int k = 0; k <= i; ++k) block[i * W + k] -= multiplier * row[k];
            }
            for (int i = 0; i < j; ++i) row[i] *= inverse;
            row[j] = inverse;
        }
    }

    // Find the step -(B + sum_r row_r row_r^T / ratio_r)^-1 gradient with the factored band B and R
    // dense rows, by Woodbury's formula; return false if no finite step exists. `step` has x,
    // (N, V), and behind it shares, (N, S). ROWS is R if known when compiling, or 0 for any number.
    template <int ROWS>
    bool solve_factored(const double* gradient, const double* ratios, double* step) {
        fill_right_sides<ROWS>(gradient);
        eliminate_shares_of_right_sides<ROWS>();
        with_bandwidth([this](auto below) {
            divide_by_lower<below.value, ROWS ? ROWS + 1 : 0>(
                factor_.data(), slots_ * size(), below_, right_.data(), 1 + rows_);
        });
        const double* multipliers = find_row_multipliers<ROWS>(ratios);
        if (!multipliers) return false;
        const int R = row_count<ROWS>();
        const std::size_t columns = slots_ * size();
        for (std::size_t i = 0; i < columns; ++i)
            step[i] = combine_sides(R, multipliers, &right_[i * (1 + R)], factor_[i * height()]);
        with_bandwidth([this, step](auto below) {
            divide_by_upper<below.value>(factor_.data(), slots_ * size(), below_, step);
        });
        find_share_steps(R, multipliers, step);
        return is_finite(step, slots_ * width());
    }

    // Fill 1 + R right sides: column 0 with minus the gradient, columns 1 to R with the dense rows,
    // which couple all slots. right_, (N V + below, 1 + R), has x, and behind it zeros for the
    // band's `below` columns beyond the last. share_right_, (N S, 1 + R), has the shares.
    template <int ROWS>
    void fill_right_sides(const double* gradient) {
        const int R = row_count<ROWS>();
        const std::size_t columns = slots_ * size(), variables = slots_ * width();
        const auto fill_variable = [&](std::size_t i, double* right) {
            right[0] = -gradient[i];
            for (int r = 0; r < R; ++r) right[1 + r] = rows[i * R + r];
        };
        for (std::size_t i = 0; i < columns; ++i) fill_variable(i, &right_[i * (1 + R)]);
        std::fill(right_.begin() + columns * (1 + R), right_.end(), 0.0);
        for (std::size_t i = columns; i < variables; ++i)
            fill_variable(i, &share_right_[(i - columns) * (1 + R)]);
    }

    // Forward substitution of the shares: subtract the right sides of each eliminated share, times
    // its multipliers, from the right sides of its slot's other variables.
    template <int ROWS>
    void eliminate_shares_of_right_sides() {
        const int sides = 1 + row_count<ROWS>();
        for (std::size_t n = 0; n < slots_; ++n)
            for_pivots(n, [&](int j, const double* multipliers) {
                const double* row = share_right(n, j);
                for (int i = 0; i < j; ++i) {
                    double* to = i < size() ? &right_[(n * size() + i) * sides]
                                            : share_right(n, i);
                    for (int s = 0; s < sides; ++s) to[s] -= multipliers[i] * row[s];
                }
            });
    }

    // Return the multiplier of each dense row, (R), by Woodbury's formula: the solution of
    // (diag(ratios) + Y^T D^-1 Y) multipliers = Y^T D^-1 y. The right sides of the gradient and of
    // the dense rows are y and Y (variables, R) after forward substitution. Null if it is singular.
    template <int ROWS>
    const double* find_row_multipliers(const double* ratios) {
        const int R = row_count<ROWS>();
        const std::size_t columns = slots_ * size();
        double *products = space_.data(), *right = products + R * R;
        std::fill(products, right + R, 0.0);
        const auto add_products = [&](const double* row, double inverse) {
            for (int r = 0; r < R; ++r) {
                const double scaled = row[1 + r] * inverse;
                right[r] += scaled * row[0];
                for (int s = 0; s <= r; ++s) products[r * R + s] += scaled * row[1 + s];
            }
        };
        for (std::size_t i = 0; i < columns; ++i)
            add_products(&right_[i * (1 + R)], factor_[i * height()]);
        for (std::size_t n = 0; n < slots_; ++n)
            for_pivots(n, [&](int j, const double* multipliers) {
                add_products(share_right(n, j), multipliers[j]);
            });
        for (int r = 0; r < R; ++r) {
            for (int s = 0; s < r; ++s) products[s * R + r] = products[r * R + s];
            products[r * R + r] += ratios[r];
        }
        return solve_dense(products, right, R) ? right : nullptr;
    }

    // Return (row[0] - sum_r row[1 + r] multipliers[r]) * inverse_pivot for a variable's 1 + R
    // right sides in `row`: of the gradient, then of R dense rows.
    static double combine_sides(int R, const double* multipliers, const double* row,
                                double inverse_pivot) {
        double change = row[0];
        for (int r = 0; r < R; ++r) change -= row[1 + r] * multipliers[r];
        return change * inverse_pivot;
    }

    // Back substitution: find share j's step from the steps of x and of the slot's earlier shares.
    void find_share_steps(int R, const double* row_multipliers, double* step) {
        for (std::size_t n = 0; n < slots_; ++n)
            for (int j = size(); j < width(); ++j) {
                const double* multipliers = pivot_row(n, j);
                double change =
                    combine_sides(R, row_multipliers, share_right(n, j), multipliers[j]);
                for (int i = 0; i < j; ++i)
                    change -= multipliers[i] * step[i < size() ? n * size() + i
                                                               : share_index(n, i)];
                step[share_index(n, j)] = change;
            }
    }

    // Add to the band what makes a slot's block positive semidefinite. find_modification replaces
    // its argument by the matrix to add. Without shares this goes to the band. With shares it goes
    // to the block, shares are eliminated again, and the reduced block's change goes to the band.
    void make_convex(std::size_t n) {
        const int W = width();
        double* block = &blocks[n * W * W];
        if (!shares_) {
            find_modification(block, W, space_.data());
            return add_block(n, block);
        }
        const double* reduced = &eliminated_[n * W * W];
        std::vector<double> added(block, block + W * W), before(reduced, reduced + W * W);
        find_modification(added.data(), W, space_.data());
        for (int i = 0; i < W; ++i)
            for (int j = 0; j <= i; ++j) block[i * W + j] += added[i * W + j];
        eliminate_shares(n);
        for (int i = 0; i < W * W; ++i) before[i] = reduced[i] - before[i];
        add_block(n, before.data());
    }

    // Factor the band after making it positive definite with few changes; false if that fails.
    //
    // FIRST_SHIFT units are added to the diagonal. When the factorisation fails in a slot, the
    // blocks of this slot and its neighbours, one on each side and twice as many for each failure
    // after SINGLE_SLOTS, are made positive semidefinite. If they are so already, or after
    // ALL_SLOTS failures, this is done in all slots. Then only rounding can make the factorisation
    // fail, because all limits' terms are convex. The diagonal is raised by SHIFTS (first 0) times
    // its largest entry, one after the other, until the factorisation succeeds.
    bool factor_positive_definite(const std::atomic<bool>& stop) {
        const int V = size();
        const std::ptrdiff_t slots = slots_;
        std::fill(convex_.begin(), convex_.end(), 0);
        std::ptrdiff_t not_convex = slots;  // Number of slots whose blocks are as they were.
        for (std::ptrdiff_t j = 0; j < slots * V; ++j) band[j * height()] += FIRST_SHIFT * unit_;
        std::ptrdiff_t begin = 0;  // The first column that has changed.
        for (int failures = 0; not_convex; ++failures) {
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
                --not_convex;
                begin = std::min(begin, n * V);
                make_convex(n);
            }
        }
        double scale = unit_;
        for (std::ptrdiff_t j = 0; j < slots * V; ++j)
            scale = std::max(scale, std::fabs(band[j * height()]));
        for (const double shift : SHIFTS) {
            if (stop) return false;
            for (std::ptrdiff_t j = 0; j < slots * V; ++j) band[j * height()] += shift * scale;
            if (factor(0) < 0) return true;
        }
        return false;
    }

    // Call a function with the bandwidth as a compile-time constant if it is one of three, and with
    // 0 for any other. V + 1 couples a point with the next one, 2 V + 1 with the next two, and
    // 2 V - 2 with the next ones of all UAVs, by separation.
    template <typename Function>
    auto with_bandwidth(Function function) {
        constexpr int V = 3 * UAVS;
        if (UAVS && below_ == V + 1) return function(std::integral_constant<int, V + 1>());
        if (UAVS && below_ == 2 * V + 1) return function(std::integral_constant<int, 2 * V + 1>());
        if (UAVS > 1 && below_ == 2 * V - 2)
            return function(std::integral_constant<int, (UAVS > 1) ? 2 * V - 2 : 0>());
        return function(std::integral_constant<int, 0>());
    }

    // Factor the band from a column on; return the first column whose pivot is not positive, or -1.
    std::ptrdiff_t factor(std::ptrdiff_t from) {
        return with_bandwidth([this, from](auto below) {
            return factor_band<below.value>(band.data(), factor_.data(), slots_ * size(), below_,
                                            from);
        });
    }

    const std::size_t slots_;
    const int count_, shares_, rows_, below_;
    const double unit_;  // Unit of the objective.
    std::vector<double> factor_, right_, space_;
    std::vector<double> eliminated_;   // Blocks after eliminating shares, with the multipliers.
    std::vector<double> share_right_;  // Right sides of the shares.
    std::vector<char> convex_;
};

}  // namespace kernel
