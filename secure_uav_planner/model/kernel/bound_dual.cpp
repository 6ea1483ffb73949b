// The smoothed maxima of the bound's dual function over columns; see bound/search/dual.py.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "array.hpp"

namespace py = pybind11;
using kernel::Array;

namespace {

constexpr double kNegligible = 1e-10;  // Weight of a column that has no part in the derivatives.
constexpr int kSlopes = 14;            // Entries of the potentials at both edges of a stage.
constexpr double kLeast = -40.0;       // Logarithm of one that has no part in the value, either.

// One UAV's columns in G stages, C in each, and B branches: see dual.py for what they hold.
class Columns {
public:
    explicit Columns(const py::dict& given)
        : stages_(kernel::size_of(given, "count")),
          columns_(kernel::size_of(given, "power") / std::max<std::size_t>(stages_, 1)),
          branches_(kernel::size_of(given, "weights") / std::max<std::size_t>(stages_, 1)),
          eavesdroppers_(kernel::size_of(given, "shares") / std::max<std::size_t>(
              kernel::size_of(given, "weights"), 1)),
          width_(kernel::size_of(given, "potentials") / (stages_ + 1)),
          curved_(given["curved"].cast<bool>()), base_(curved_ ? 5 : 2),
          turns_(given["turns"].cast<bool>()),
          tau_(given["tau"].cast<double>()), price_(given["price"].cast<double>()),
          place_(given, "place", 2 * stages_ * columns_),
          power_(given, "power", stages_ * columns_), ground_(given, "ground", stages_ * columns_),
          leaks_(given, "leaks", stages_ * columns_ * eavesdroppers_),
          potentials_(given, "potentials", (stages_ + 1) * width_),
          count_(given, "count", stages_), step_(given, "step", stages_),
          mean_(given, "mean", 2 * stages_), weights_(given, "weights", branches_ * stages_),
          shares_(given, "shares", branches_ * stages_ * eavesdroppers_),
          parts_(given, "parts", branches_ * stages_ * eavesdroppers_),
          value_(given, "value", branches_ * stages_),
          features_(eavesdroppers_ + 2 * width_ + 1), second_(given["second"].cast<bool>()),
          slope_(given, "slope", second_ ? branches_ * stages_ * features_ : 0),
          hessian_(given, "hessian", second_ ? branches_ * stages_ * features_ * features_ : 0) {
        if (width_ != base_ + (turns_ ? 2 : 0))
            throw std::invalid_argument("wrong array: potentials");
    }

    void evaluate(const Array<double>* values) {
        potential_.resize(columns_);
        worth_.resize(columns_);
        for (std::size_t g = 0; g < stages_; ++g) {
            for (std::size_t c = 0; c < columns_; ++c) potential_[c] = potential(g, c, nullptr);
            for (std::size_t b = 0; b < branches_; ++b) {
                const double top = list(g, b);
                if (values)
                    std::copy(worth_.begin(), worth_.end(),
                              &(*values)[(b * stages_ + g) * columns_]);
                else
                    smooth(g, b, top);
            }
        }
    }

    std::size_t entries() const { return branches_ * stages_ * columns_; }

private:
    struct Tilt {
        double factor, n0, n1, small;  // step / norm, the direction, and delta / norm.
    };
    // A column's derivatives by the potentials at the edge before and the one after, and the two
    // tilts |u + S q|, from which the second derivatives come.
    struct Derivatives {
        double slope[kSlopes];
        Tilt tilts[2];
    };

    // The potential's terms at a column, with derivatives where they are wanted.
    double potential(std::size_t g, std::size_t c, Derivatives* found) const {
        const double x = place_[2 * (g * columns_ + c)], y = place_[2 * (g * columns_ + c) + 1];
        const double phi[5] = {x, y, x * x / 2, x * y, y * y / 2};
        const double* before = &potentials_[g * width_];
        const double* after = before + width_;
        double value = 0.0;
        for (std::size_t i = 0; i < base_; ++i) value += phi[i] * (after[i] - before[i]);
        value /= count_[g];
        if (found) {
            std::fill(found->slope, found->slope + kSlopes, 0.0);
            for (std::size_t i = 0; i < base_; ++i) {
                found->slope[i] = -phi[i] / count_[g];
                found->slope[width_ + i] = phi[i] / count_[g];
            }
        }
        for (std::size_t edge = 0; edge < 2; ++edge) {
            const double step = step_[g], factor = mean_[edge * stages_ + g] * step;
            if (found) found->tilts[edge].factor = 0.0;
            if (factor == 0.0) continue;
            const double* u = edge ? after : before;
            double g0 = u[0], g1 = u[1];
            if (curved_) {
                g0 += u[2] * x + u[3] * y;
                g1 += u[3] * x + u[4] * y;
            }
            if (turns_) {
                g0 += (after[base_] - before[base_]) / count_[g];
                g1 += (after[base_ + 1] - before[base_ + 1]) / count_[g];
            }
            const double delta = tau_ / step, norm = std::sqrt(g0 * g0 + g1 * g1 + delta * delta);
            value += factor * (norm - delta);
            if (!found) continue;
            found->tilts[edge] = {factor / norm, g0 / norm, g1 / norm, delta / norm};
            double row[kSlopes];
            chain(g, edge, x, y, g0 / norm, g1 / norm, row);
            for (std::size_t i = 0; i < 2 * width_; ++i) found->slope[i] += factor * row[i];
        }
        return value;
    }

    // The derivative of a . (u + S q + the change of w) by the potentials at both edges.
    void chain(std::size_t g, std::size_t edge, double x, double y, double a0, double a1,
               double* row) const {
        std::fill(row, row + kSlopes, 0.0);
        double* own = row + edge * width_;
        own[0] = a0;
        own[1] = a1;
        if (curved_) {
            own[2] = a0 * x;
            own[3] = a0 * y + a1 * x;
            own[4] = a1 * y;
        }
        if (turns_) {
            row[width_ + base_] = a0 / count_[g];
            row[width_ + base_ + 1] = a1 / count_[g];
            row[base_] = -row[width_ + base_];
            row[base_ + 1] = -row[width_ + base_ + 1];
        }
    }

    // Compute the values of a stage's columns in a branch; return the largest.
    double list(std::size_t g, std::size_t b) {
        const std::size_t at = b * stages_ + g, e = eavesdroppers_;
        double top = -HUGE_VAL;
        for (std::size_t c = 0; c < columns_; ++c) {
            const std::size_t column = g * columns_ + c;
            double value = potential_[c] + weights_[at] * ground_[column] - price_ * power_[column];
            for (std::size_t i = 0; i < e; ++i)
                value += shares_[at * e + i] * parts_[at * e + i] * leaks_[column * e + i];
            worth_[c] = value;
            top = std::max(top, value);
        }
        return top;
    }

    void smooth(std::size_t g, std::size_t b, double top) {
        const std::size_t at = b * stages_ + g, e = eavesdroppers_, f = features_;
        double total = 0.0;
        for (double& worth : worth_) {
            const double less = (worth - top) / tau_;
            worth = less > kLeast ? std::exp(less) : 0.0;
            total += worth;
        }
        value_[at] = top + tau_ * std::log(total);
        if (!second_) return;
        double* slope = &slope_[at * f];
        double* hessian = &hessian_[at * f * f];
        std::fill(slope, slope + f, 0.0);
        std::fill(hessian, hessian + f * f, 0.0);
        row_.resize(f);
        for (std::size_t c = 0; c < columns_; ++c) {
            const double weight = worth_[c] / total;
            if (weight < kNegligible) continue;
            const std::size_t column = g * columns_ + c;
            Derivatives own;
            potential(g, c, &own);
            for (std::size_t i = 0; i < e; ++i)
                row_[i] = parts_[at * e + i] * leaks_[column * e + i];
            std::copy(own.slope, own.slope + 2 * width_, row_.begin() + e);
            row_[f - 1] = -power_[column];
            for (std::size_t i = 0; i < f; ++i) slope[i] += weight * row_[i];
            add_square(hessian, weight / tau_, row_.data(), 0, f);
            for (std::size_t edge = 0; edge < 2; ++edge) {
                const Tilt& tilt = own.tilts[edge];
                if (tilt.factor == 0.0) continue;
                // I - n n' = t t' + (delta / norm)^2 I with t across n.
                const double ways[3][2] = {
                    {-tilt.n1, tilt.n0}, {tilt.small, 0.0}, {0.0, tilt.small}};
                for (const auto& way : ways) {
                    double row[kSlopes];
                    chain(g, edge, place_[2 * column], place_[2 * column + 1], way[0], way[1], row);
                    add_square(hessian, weight * tilt.factor, row, e, e + 2 * width_);
                }
            }
        }
        add_square(hessian, -1.0 / tau_, slope, 0, f);
        for (std::size_t i = 0; i < f; ++i)
            for (std::size_t j = 0; j < i; ++j) hessian[j * f + i] = hessian[i * f + j];
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

    std::size_t stages_, columns_, branches_, eavesdroppers_, width_;
    bool curved_;
    std::size_t base_;
    bool turns_;
    double tau_, price_;
    Array<double> place_, power_, ground_, leaks_, potentials_, count_, step_, mean_, weights_,
        shares_, parts_, value_;
    std::size_t features_;
    bool second_;
    Array<double> slope_, hessian_;
    std::vector<double> potential_, worth_, row_;
};

void smooth_maxima(const py::dict& given) {
    Columns columns(given);
    const py::gil_scoped_release release;
    columns.evaluate(nullptr);
}

// Write the values of all columns in all branches, (B, G, C).
void column_values(const py::dict& given, const py::buffer& values) {
    Columns columns(given);
    const Array<double> found(values, "values", columns.entries());
    const py::gil_scoped_release release;
    columns.evaluate(&found);
}

}  // namespace

void add_bound_dual(py::module_& module) {
    module.def("bound_smooth_maxima", &smooth_maxima);
    module.def("bound_column_values", &column_values);
}
