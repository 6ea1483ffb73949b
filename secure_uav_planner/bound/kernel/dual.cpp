// The smoothed maxima of the bound's dual function over columns; see bound/search/dual.py.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "array.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::count_entries;

namespace {

constexpr double NEGLIGIBLE = 1e-10;      // Weight of a column left out of the derivatives.
constexpr double LEAST_LOG = -40.0;       // Log weight of a column left out of the value as well.
constexpr std::size_t MOST_ENTRIES = 14;  // Largest number of potentials at both edges of a group.

// C columns in each of G slot groups: a column is a place and a power of one UAV. pack_columns in
// columns.py makes the arguments.
class Columns {
public:
    // Read the arguments. A potential has width_ numbers: u (2), S (3) if quadratic, w (2) if a
    // UAV has a limit of acceleration. The features_ unknowns of a group are v, the potentials at
    // the edge before and at the edge after the group, and the price, in this order.
    explicit Columns(const py::dict& args)
        : groups_(count_entries(args, "count")),
          columns_(count_entries(args, "ground") / std::max<std::size_t>(groups_, 1)),
          eavesdroppers_(count_entries(args, "v") / std::max<std::size_t>(groups_, 1)),
          width_(count_entries(args, "potentials") / (groups_ + 1)),
          quadratic_(args["quadratic"].cast<bool>()),
          acceleration_(args["accelerates"].cast<bool>()), base_(quadratic_ ? 5 : 2),
          tau_(args["tau"].cast<double>()),
          price_(args["price"].cast<double>()), place_(args, "place", 2 * groups_ * columns_),
          power_(args, "power", groups_ * columns_), ground_(args, "ground", groups_ * columns_),
          leaks_(args, "leaks", groups_ * columns_ * eavesdroppers_),
          potentials_(args, "potentials", (groups_ + 1) * width_),
          count_(args, "count", groups_), step_(args, "step", groups_),
          mean_(args, "mean", 2 * groups_), w0_(args, "weights", groups_),
          v_(args, "v", groups_ * eavesdroppers_),
          features_(eavesdroppers_ + 2 * width_ + 1) {
        kernel::expect(width_ == base_ + (acceleration_ ? 2 : 0), "potentials");
    }

    // Group by group, fill values_ (C) with the values of the group's columns [nats], and call
    // visit(g, best) with the index of the group and the index of its best column.
    template <typename Visit>
    void evaluate(const Visit& visit) {
        values_.resize(columns_);
        for (std::size_t g = 0; g < groups_; ++g) {
            // The lengths of linear potentials are the same at all columns.
            const double length = quadratic_ ? 0.0 : sum_lengths(g, 0, nullptr);
            std::size_t best = 0;
            for (std::size_t c = 0; c < columns_; ++c) {
                values_[c] = compute_value(g, c, quadratic_ ? sum_lengths(g, c, nullptr) : length);
                if (values_[c] > values_[best]) best = c;
            }
            visit(g, best);
        }
    }

    std::size_t columns() const { return columns_; }
    std::size_t groups() const { return groups_; }
    std::size_t features() const { return features_; }
    const std::vector<double>& values() const { return values_; }

    // Return tau log sum exp(value / tau) over the columns of group g, whose values `evaluate` has
    // just filled, and replace each value in values_ by its weight exp((value - largest) / tau).
    // `best` is the index of the largest value. Unless `slope` is null, fill the slope (F) and the
    // Hessian (F, F) by the group's unknowns: v, the potentials at both edges, and the price.
    double smooth_maximum(std::size_t g, std::size_t best, double* slope, double* hessian) {
        const double top = values_[best];
        double total = 0.0;
        for (double& value : values_) {
            const double log_weight = (value - top) / tau_;
            value = log_weight > LEAST_LOG ? std::exp(log_weight) : 0.0;
            total += value;
        }
        if (slope) differentiate(g, total, slope, hessian);
        return top + tau_ * std::log(total);
    }

private:
    // Fill the slope (F) and the Hessian (F, F) of the smoothed maximum of group g. values_ has a
    // weight of each column, `total` is their sum. With the shares r = weight / total, and the
    // slope g and Hessian H of each column, the slope is m = sum of r g, and the Hessian is
    // sum of r (H + g g' / tau) - m m' / tau.
    void differentiate(std::size_t g, double total, double* slope, double* hessian) {
        const std::size_t f = features_;
        std::fill(slope, slope + f, 0.0);
        std::fill(hessian, hessian + f * f, 0.0);
        row_.resize(f);
        for (std::size_t c = 0; c < columns_; ++c) {
            const double share = values_[c] / total;
            if (share < NEGLIGIBLE) continue;
            fill_row(g, c);
            if (quadratic_) add_lengths(g, c, share, hessian);
            for (std::size_t i = 0; i < f; ++i) slope[i] += share * row_[i];
            add_square(hessian, share / tau_, row_.data(), 0, f);
        }
        add_square(hessian, -1.0 / tau_, slope, 0, f);
        // The lengths of linear potentials are the same at all columns.
        if (!quadratic_) {
            std::fill(row_.begin(), row_.end(), 0.0);
            add_lengths(g, 0, 1.0, hessian);
            for (std::size_t i = 0; i < f; ++i) slope[i] += row_[i];
        }
        for (std::size_t i = 0; i < f; ++i)
            for (std::size_t j = 0; j < i; ++j) hessian[j * f + i] = hessian[i * f + j];
    }

    // Fill row_ (F) with the derivatives of compute_value(g, c, 0), the value of column c in slot
    // group g without lengths. The unknowns are the multipliers v of the E eavesdroppers, the
    // potentials at the edges before and after the group, and the price.
    void fill_row(std::size_t g, std::size_t c) {
        const std::size_t e = eavesdroppers_, column = g * columns_ + c;
        std::copy(&leaks_[column * e], &leaks_[column * e] + e, row_.begin());
        std::fill(row_.begin() + e, row_.end(), 0.0);
        double monomials[5];
        fill_monomials(&place_[2 * column], monomials);
        for (std::size_t i = 0; i < base_; ++i) {
            row_[e + i] -= monomials[i] / count_[g];
            row_[e + width_ + i] += monomials[i] / count_[g];
        }
        row_[features_ - 1] = -power_[column];
    }

    // The smoothed length |h| of sum_lengths at an edge, for derivatives: with r =
    // sqrt(|h|^2 + delta^2), `factor` is m step / r, (n0, n1) is h / r, `smoothing` is delta / r.
    struct Length {
        double factor, n0, n1, smoothing;
    };

    const double* potential(std::size_t edge) const { return &potentials_[edge * width_]; }
    // Fill (x, y, x^2 / 2, x y, y^2 / 2), by which u and S enter u . q + q . S q / 2. Callers use
    // the first base_ of these: 2 of linear potentials, 5 of quadratic ones.
    static void fill_monomials(const double* q, double* monomials) {
        const double x = q[0], y = q[1], all[5] = {x, y, x * x / 2, x * y, y * y / 2};
        std::copy(all, all + 5, monomials);
    }

    // The value [nats] of column c of group g: compute_change + lengths + w0 ground + v . leaks,
    // where `lengths` is sum_lengths(g, c).
    double compute_value(std::size_t g, std::size_t c, double lengths) const {
        const std::size_t column = g * columns_ + c;
        double value = compute_change(g, c) + lengths + w0_[g] * ground_[column];
        for (std::size_t i = 0; i < eavesdroppers_; ++i)
            value += v_[g * eavesdroppers_ + i] * leaks_[column * eavesdroppers_ + i];
        return value;
    }

    // (W_after(q) - W_before(q)) / count - price p for the place q and power p of column c. W are
    // the potentials u . q + q . S q / 2 at the edges of group g, which has `count` slots.
    double compute_change(std::size_t g, std::size_t c) const {
        const std::size_t column = g * columns_ + c;
        const double *before = potential(g), *after = potential(g + 1);
        double sum = 0.0, monomials[5];
        fill_monomials(&place_[2 * column], monomials);
        for (std::size_t i = 0; i < base_; ++i) sum += monomials[i] * (after[i] - before[i]);
        return sum / count_[g] - price_ * power_[column];
    }

    // Return the bound [nats] of the potential's growth by a move from place q of column c: the
    // sum over both edges of the group of m step (sqrt(|h|^2 + delta^2) - delta), which smooths
    // m step |h|. m is the edge's weight in mean_. With u and S of the edge, h = u + S q +
    // (w after - w before) / count, and delta = tau / step. Unless `lengths` is null, fill
    // lengths[edge] for the derivatives.
    double sum_lengths(std::size_t g, std::size_t c, Length* lengths) const {
        const double step = step_[g], *q = &place_[2 * (g * columns_ + c)];
        const double *before = potential(g), *after = potential(g + 1);
        double value = 0.0;
        for (std::size_t edge = 0; edge < 2; ++edge) {
            const double factor = mean_[edge * groups_ + g] * step;
            if (lengths) lengths[edge].factor = 0.0;
            if (factor == 0.0) continue;
            const double* own = edge ? after : before;
            double h0 = own[0], h1 = own[1];
            if (quadratic_) {
                h0 += own[2] * q[0] + own[3] * q[1];
                h1 += own[3] * q[0] + own[4] * q[1];
            }
            if (acceleration_) {
                h0 += (after[base_] - before[base_]) / count_[g];
                h1 += (after[base_ + 1] - before[base_ + 1]) / count_[g];
            }
            const double delta = tau_ / step;
            const double norm = std::sqrt(h0 * h0 + h1 * h1 + delta * delta);
            value += factor * (norm - delta);
            if (lengths) lengths[edge] = {factor / norm, h0 / norm, h1 / norm, delta / norm};
        }
        return value;
    }

    // Fill `row` with the derivative of (a0, a1) . (u + S q + (w after - w before) / count) by the
    // group's potentials: width_ numbers (u, S, w) before the group, then width_ after it. u and S
    // belong to one edge, 0 before or 1 after the group; q is the place of column c.
    void apply_chain_rule(std::size_t g, std::size_t c, std::size_t edge, double a0, double a1,
                          double* row) const {
        std::fill(row, row + MOST_ENTRIES, 0.0);
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
            const double change[2] = {a0 / count_[g], a1 / count_[g]};
            for (std::size_t i = 0; i < 2; ++i) {
                row[base_ + i] = -change[i];
                row[width_ + base_ + i] = change[i];
            }
        }
    }

    // Add the gradient of sum_lengths(g, c) to row_, and its Hessian times `weight` to `hessian`.
    // An edge's length is m step r up to a constant, with r = sqrt(|h|^2 + delta^2). Its gradient
    // by h is m step n with n = h / r, and its Hessian by h is m step / r (I - n n'). Only the
    // entries of the potentials, from `first` to `last`, change.
    void add_lengths(std::size_t g, std::size_t c, double weight, double* hessian) {
        Length own[2];
        sum_lengths(g, c, own);
        const std::size_t first = eavesdroppers_, last = features_ - 1;
        for (std::size_t edge = 0; edge < 2; ++edge) {
            const Length& length = own[edge];
            if (length.factor == 0.0) continue;
            double row[MOST_ENTRIES];
            apply_chain_rule(g, c, edge, length.n0, length.n1, row);
            for (std::size_t i = first; i < last; ++i)
                row_[i] += mean_[edge * groups_ + g] * step_[g] * row[i - first];
            // I - n n' = t t' + (delta / r)^2 I with t = (-n1, n0) across n.
            const double factors[3][2] = {
                {-length.n1, length.n0}, {length.smoothing, 0.0}, {0.0, length.smoothing}};
            for (const auto& a : factors) {
                apply_chain_rule(g, c, edge, a[0], a[1], row);
                add_square(hessian, weight * length.factor, row, first, last);
            }
        }
    }

    // Add factor x x' to the lower triangle of a Hessian's rows and columns from `first` to `last`,
    // where x is `row` and has last - first entries.
    void add_square(double* matrix, double factor, const double* row, std::size_t first,
                    std::size_t last) const {
        for (std::size_t i = first; i < last; ++i) {
            const double scaled = factor * row[i - first];
            if (scaled == 0.0) continue;
            for (std::size_t j = first; j <= i; ++j)
                matrix[i * features_ + j] += scaled * row[j - first];
        }
    }

    std::size_t groups_, columns_, eavesdroppers_, width_;
    bool quadratic_, acceleration_;  // Whether potentials have S and w.
    std::size_t base_;               // Count of u and S, which precede w.
    double tau_, price_;
    Array<const double> place_, power_, ground_, leaks_, potentials_, count_, step_, mean_,
        w0_, v_;
    std::size_t features_;
    std::vector<double> values_, row_;
};

// Fill `value` (G) with the smoothed maximum of each group over the columns `args`, which
// pack_columns makes; unless `slope` is empty, fill `slope` (G, F) and `hessian` (G, F, F).
void smooth_maxima(const py::dict& args, const py::buffer& value, const py::buffer& slope,
                   const py::buffer& hessian) {
    Columns columns(args);
    const std::size_t count = columns.groups(), f = columns.features();
    const Array<double> values(value, "value", count);
    const bool differentiate = count_entries(slope) > 0;
    const Array<double> first(slope, "slope", differentiate ? count * f : 0);
    const Array<double> second(hessian, "hessian", differentiate ? count * f * f : 0);
    const py::gil_scoped_release release;
    columns.evaluate([&](std::size_t g, std::size_t best) {
        values[g] = columns.smooth_maximum(g, best, differentiate ? &first[g * f] : nullptr,
                                           differentiate ? &second[g * f * f] : nullptr);
    });
}

// Fill `values` (G, C) in nats with the values of the columns `args`, which pack_columns makes.
void evaluate_columns(const py::dict& args, const py::buffer& values) {
    Columns columns(args);
    const Array<double> written(values, "values", columns.groups() * columns.columns());
    const py::gil_scoped_release release;
    columns.evaluate([&](std::size_t g, std::size_t) {
        std::copy(columns.values().begin(), columns.values().end(),
                  &written[g * columns.columns()]);
    });
}

}  // namespace

void add_bound_dual(py::module_& module) {
    module.def("smooth_maxima", &smooth_maxima);
    module.def("evaluate_columns", &evaluate_columns);
}
