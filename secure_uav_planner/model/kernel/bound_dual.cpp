// The smoothed maxima of the bound's dual function over columns; see bound/search/dual.py.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "array.hpp"

namespace py = pybind11;
using kernel::Array;

namespace {

constexpr double kNegligible = 1e-10;   // Weight of a column that has no part in the derivatives.
constexpr std::size_t kSlopes = 14;     // Entries of a potential at both edges of a stage, at most.
constexpr double kLeast = -40.0;        // Logarithm of one that has no part in the value, either.

// Columns of a UAV in G stages, C in each: see dual.py for what they hold.
class Columns {
public:
    explicit Columns(const py::dict& given)
        : stages_(kernel::size_of(given, "count")),
          columns_(kernel::size_of(given, "ground") / std::max<std::size_t>(stages_, 1)),
          eavesdroppers_(kernel::size_of(given, "shares") / std::max<std::size_t>(stages_, 1)),
          width_(kernel::size_of(given, "potentials") / (stages_ + 1)),
          quadratic_(given["quadratic"].cast<bool>()), base_(quadratic_ ? 5 : 2),
          acceleration_(given["acceleration"].cast<bool>()), tau_(given["tau"].cast<double>()),
          price_(given["price"].cast<double>()), place_(given, "place", 2 * stages_ * columns_),
          power_(given, "power", stages_ * columns_),
          ground_(given, "ground", stages_ * columns_),
          leaks_(given, "leaks", stages_ * columns_ * eavesdroppers_),
          potentials_(given, "potentials", (stages_ + 1) * width_),
          count_(given, "count", stages_), step_(given, "step", stages_),
          mean_(given, "mean", 2 * stages_), weights_(given, "weights", stages_),
          shares_(given, "shares", stages_ * eavesdroppers_),
          features_(eavesdroppers_ + 2 * width_ + 1) {
        kernel::expect(width_ == base_ + (acceleration_ ? 2 : 0), "potentials");
    }

    // Call `visit` for every stage with all columns' values listed, and the best one.
    template <typename Visit>
    void evaluate(const Visit& visit) {
        potential_.resize(columns_);
        values_.resize(columns_);
        for (std::size_t g = 0; g < stages_; ++g) {
            // What linear potentials cost is the same everywhere.
            const double level = quadratic_ ? 0.0 : lengths(g, 0, nullptr);
            for (std::size_t c = 0; c < columns_; ++c)
                potential_[c] = change(g, c) + (quadratic_ ? lengths(g, c, nullptr) : level);
            visit(g, list(g));
        }
    }

    std::size_t columns() const { return columns_; }
    std::size_t stages() const { return stages_; }
    std::size_t features() const { return features_; }
    const std::vector<double>& values() const { return values_; }

    // The smoothed maximum of the values listed last, with derivatives where there is room.
    double smooth(std::size_t g, std::size_t best, double* slope, double* hessian) {
        const std::size_t e = eavesdroppers_, f = features_;
        const double top = values_[best];
        double total = 0.0;
        for (double& value : values_) {
            const double less = (value - top) / tau_;
            value = less > kLeast ? std::exp(less) : 0.0;
            total += value;
        }
        const double value = top + tau_ * std::log(total);
        if (!slope) return value;
        std::fill(slope, slope + f, 0.0);
        std::fill(hessian, hessian + f * f, 0.0);
        row_.resize(f);
        for (std::size_t c = 0; c < columns_; ++c) {
            const double weight = values_[c] / total;
            if (weight < kNegligible) continue;
            const std::size_t column = g * columns_ + c;
            std::copy(&leaks_[column * e], &leaks_[column * e] + e, row_.begin());
            std::fill(row_.begin() + e, row_.end(), 0.0);
            double phi[5];
            monomials(&place_[2 * column], phi);
            for (std::size_t i = 0; i < base_; ++i) {
                row_[e + i] -= phi[i] / count_[g];
                row_[e + width_ + i] += phi[i] / count_[g];
            }
            row_[f - 1] = -power_[column];
            if (quadratic_) add_lengths(g, c, weight, hessian);
            for (std::size_t i = 0; i < f; ++i) slope[i] += weight * row_[i];
            add_square(hessian, weight / tau_, row_.data(), 0, f);
        }
        add_square(hessian, -1.0 / tau_, slope, 0, f);
        if (!quadratic_) {
            std::fill(row_.begin(), row_.end(), 0.0);
            add_lengths(g, 0, 1.0, hessian);
            for (std::size_t i = 0; i < f; ++i) slope[i] += row_[i];
        }
        for (std::size_t i = 0; i < f; ++i)
            for (std::size_t j = 0; j < i; ++j) hessian[j * f + i] = hessian[i * f + j];
        return value;
    }

private:
    struct Length {
        double factor, n0, n1, small;  // step / norm, the direction, and delta / norm.
    };

    const double* potential(std::size_t edge) const { return &potentials_[edge * width_]; }
    static void monomials(const double* q, double* phi) {
        const double x = q[0], y = q[1], all[5] = {x, y, x * x / 2, x * y, y * y / 2};
        std::copy(all, all + 5, phi);
    }

    // The potentials' changes at a column, less what its powers cost.
    double change(std::size_t g, std::size_t c) const {
        const std::size_t column = g * columns_ + c;
        const double *before = potential(g), *after = potential(g + 1);
        double sum = 0.0, phi[5];
        monomials(&place_[2 * column], phi);
        for (std::size_t i = 0; i < base_; ++i) sum += phi[i] * (after[i] - before[i]);
        return sum / count_[g] - price_ * power_[column];
    }

    // The lengths |u + S q| at a column, smoothed.
    double lengths(std::size_t g, std::size_t c, Length* terms) const {
        const double step = step_[g], *q = &place_[2 * (g * columns_ + c)];
        const double *before = potential(g), *after = potential(g + 1);
        double value = 0.0;
        for (std::size_t edge = 0; edge < 2; ++edge) {
            const double factor = mean_[edge * stages_ + g] * step;
            if (terms) terms[edge].factor = 0.0;
            if (factor == 0.0) continue;
            const double* own = edge ? after : before;
            double g0 = own[0], g1 = own[1];
            if (quadratic_) {
                g0 += own[2] * q[0] + own[3] * q[1];
                g1 += own[3] * q[0] + own[4] * q[1];
            }
            if (acceleration_) {
                g0 += (after[base_] - before[base_]) / count_[g];
                g1 += (after[base_ + 1] - before[base_ + 1]) / count_[g];
            }
            const double delta = tau_ / step;
            const double norm = std::sqrt(g0 * g0 + g1 * g1 + delta * delta);
            value += factor * (norm - delta);
            if (terms) terms[edge] = {factor / norm, g0 / norm, g1 / norm, delta / norm};
        }
        return value;
    }

    // The derivative of a . (u + S q + the change of w) by the potentials at both edges.
    void chain(std::size_t g, std::size_t c, std::size_t edge, double a0, double a1,
               double* row) const {
        std::fill(row, row + kSlopes, 0.0);
        double* own = row + edge * width_;
        const double* q = &place_[2 * (g * columns_ + c)];
        own[0] = a0;
        own[1] = a1;
        if (quadratic_) {
            own[2] = a0 * q[0];
            own[3] = a0 * q[1] + a1 * q[0];
            own[4] = a1 * q[1];
        }
        if (acceleration_) {
            const double turn[2] = {a0 / count_[g], a1 / count_[g]};
            for (std::size_t i = 0; i < 2; ++i) {
                row[base_ + i] = -turn[i];
                row[width_ + base_ + i] = turn[i];
            }
        }
    }

    // List the values of a stage's columns; return the best one.
    std::size_t list(std::size_t g) {
        const std::size_t e = eavesdroppers_;
        std::size_t best = 0;
        for (std::size_t c = 0; c < columns_; ++c) {
            const std::size_t column = g * columns_ + c;
            double value = potential_[c] + weights_[g] * ground_[column];
            for (std::size_t i = 0; i < e; ++i)
                value += shares_[g * e + i] * leaks_[column * e + i];
            values_[c] = value;
            if (value > values_[best]) best = c;
        }
        return best;
    }

    // Add the tilts' first derivatives to row_ and the second ones to a Hessian.
    void add_lengths(std::size_t g, std::size_t c, double weight, double* hessian) {
        Length own[2];
        lengths(g, c, own);
        const std::size_t e = eavesdroppers_, last = features_ - 1;
        for (std::size_t edge = 0; edge < 2; ++edge) {
            const Length& length = own[edge];
            if (length.factor == 0.0) continue;
            double row[kSlopes];
            chain(g, c, edge, length.n0, length.n1, row);
            for (std::size_t i = e; i < last; ++i)
                row_[i] += mean_[edge * stages_ + g] * step_[g] * row[i - e];
            // I - n n' = t t' + (delta / norm)^2 I with t across n.
            const double ways[3][2] = {
                {-length.n1, length.n0}, {length.small, 0.0}, {0.0, length.small}};
            for (const auto& way : ways) {
                chain(g, c, edge, way[0], way[1], row);
                add_square(hessian, weight * length.factor, row, e, last);
            }
        }
    }

    // Add factor row row' to the lower triangle of a matrix, from `first` on.
    void add_square(double* matrix, double factor, const double* row, std::size_t first,
                    std::size_t last) const {
        for (std::size_t i = first; i < last; ++i) {
            const double scaled = factor * row[i - first];
            if (scaled == 0.0) continue;
            for (std::size_t j = first; j <= i; ++j)
                matrix[i * features_ + j] += scaled * row[j - first];
        }
    }

    std::size_t stages_, columns_, eavesdroppers_, width_;
    bool quadratic_;
    std::size_t base_;
    bool acceleration_;
    double tau_, price_;
    Array<const double> place_, power_, ground_, leaks_, potentials_, count_, step_, mean_,
        weights_, shares_;
    std::size_t features_;
    std::vector<double> potential_, values_, row_;
};

// Write smoothed maxima, (G,), and, unless these are empty, their derivatives.
void smooth_maxima(const py::dict& given, const py::buffer& value, const py::buffer& slope,
                   const py::buffer& hessian) {
    Columns columns(given);
    const std::size_t count = columns.stages(), f = columns.features();
    const bool second = kernel::size_of(slope) > 0;
    const Array<double> values(value, "value", count);
    const Array<double> first(slope, "slope", second ? count * f : 0);
    const Array<double> bend(hessian, "hessian", second ? count * f * f : 0);
    const py::gil_scoped_release release;
    columns.evaluate([&](std::size_t g, std::size_t best) {
        values[g] = columns.smooth(g, best, second ? &first[g * f] : nullptr,
                                   second ? &bend[g * f * f] : nullptr);
    });
}

// Write the values of all columns, (G, C).
void column_values(const py::dict& given, const py::buffer& values) {
    Columns columns(given);
    const Array<double> written(values, "values", columns.stages() * columns.columns());
    const py::gil_scoped_release release;
    columns.evaluate([&](std::size_t g, std::size_t) {
        std::copy(columns.values().begin(), columns.values().end(),
                  &written[g * columns.columns()]);
    });
}

}  // namespace

void add_bound_dual(py::module_& module) {
    module.def("bound_smooth_maxima", &smooth_maxima);
    module.def("bound_column_values", &column_values);
}
