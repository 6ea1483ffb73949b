// The multipliers v of the certificate: the bound of a slot on columns, minimised over v at a w0.
//
// The bound is m(w0 - s) - H(v) + sum over UAVs of the largest base + w0 ground + v . leaks, which
// is convex in v; see bound/proof/certificate.py. It is minimised by Newton's method at falling
// temperatures tau, with tau log sum exp(. / tau) for every largest value and with barriers for
// v > 0 and for s < w0. The sum is taken over a list of columns only. At every temperature, the
// best columns at the present v are added to this list. A search along one direction after the
// other would stop at a kink of the bound, up to 0.3 nats above the least value.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "array.hpp"
#include "linear.hpp"
#include "numbers.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::expect;
using kernel::TINY;

namespace {

constexpr double TEMPERATURES[] = {0.02, 2e-3, 2.5e-4};  // Temperatures in nats.
constexpr int NEWTON_STEPS = 10;     // Largest number of Newton steps at a temperature.
constexpr double ENOUGH = 1e-2;      // Decrease, over tau, below which a temperature ends.
constexpr double BARRIER = 0.1;      // Weight of the barriers, over tau.
constexpr double INTERIOR = 1e-4;    // Least first share of w0 of every v.
constexpr double LEAST_SLACK = 1e-7; // Least first share of w0 of w0 - s.
constexpr double MOST_OF_WAY = 0.95; // Largest part of the way to the bounds of v in a step.
constexpr std::size_t JOINING = 60;  // Columns that join a UAV's list at a temperature.

// -share log(share), a term of an entropy.
double compute_entropy_term(double share) {
    share = std::min(std::max(share, 0.0), 1.0);
    return -share * std::log(std::max(share, TINY));
}

// The bound of one slot at one w0. An adversary is a group of eavesdroppers' places, and only its
// worst place counts: one disc with colluding eavesdroppers, otherwise all discs together.
// `adversaries` (E) has the index of every place's adversary. `price` [nats per W] and `peak` [W]
// belong to the transmit power.
class SlotBound {
public:
    SlotBound(std::vector<std::size_t> adversaries, double price, double peak)
        : adversaries_(std::move(adversaries)), price_(price), peak_(peak),
          totals_(adversaries_.size()), trial_(adversaries_.size()) {}

    // Forget all columns, and begin the bound of a slot at a given w0, for a number of UAVs.
    void begin(double w0, std::size_t uavs) {
        w0_ = w0;
        uavs_.resize(uavs);
        for (Uav& uav : uavs_) {
            uav.columns.clear();
            uav.list.clear();
        }
    }

    // Add a column of a UAV: its value without v, and its factors of v (`leaks`).
    void add(std::size_t uav, double value, const double* leaks) {
        uavs_[uav].columns.push_back({value, leaks});
    }

    // Minimise the bound approximately over the eavesdroppers' multipliers v, beginning at the
    // given v, which a better result replaces. A v with an infinite bound is left as it is.
    void minimise(double* v) {
        const double before = compute_bound(v);
        if (!std::isfinite(before)) return;
        std::vector<double> point = move_inside(v);
        for (const double tau : TEMPERATURES) {
            for (Uav& uav : uavs_) extend(uav, point.data());
            descend(point, tau);
        }
        if (compute_bound(point.data()) < before) std::copy(point.begin(), point.end(), v);
    }

    // The bound at v [nats]: constant(v) plus the largest value of each UAV's columns.
    double compute_bound(const double* v) {
        double sum = constant(v);
        for (std::size_t uav = 0; uav < uavs_.size(); ++uav) sum += find_maximum(uav, v);
        return sum;
    }

    // Find the largest value at v [nats] of a UAV's columns; -infinity without columns.
    double find_maximum(std::size_t uav, const double* v) const {
        double most = -kernel::INFINITE;
        for (const Column& column : uavs_[uav].columns) most = std::max(most, value(column, v));
        return most;
    }

    // Return the part of the bound without columns, m(w0 - s) - H(v) [nats], with the sum s of v.
    // w0 is the multiplier of the log SINR at the ground node. m(x) is the largest x log(power) -
    // price * power over powers up to the peak. The entropy H(v) is the sum of -t log t over the
    // rest t = 1 - s and each adversary's sum t of v. Fill totals_ for differentiate_constant.
    double constant(const double* v) {
        double sum = 0.0;
        std::fill(totals_.begin(), totals_.end(), 0.0);
        for (std::size_t e = 0; e < adversaries_.size(); ++e) {
            totals_[adversaries_[e]] += v[e];
            sum += v[e];
        }
        double entropy = compute_entropy_term(1.0 - sum);
        for (const double total : totals_) entropy += compute_entropy_term(total);
        const double slack = std::max(w0_ - sum, 0.0);
        const double power = std::min(slack / std::max(price_, TINY), peak_);
        return slack * std::log(std::max(power, TINY)) - price_ * power - entropy;
    }

private:
    struct Column {
        double value;
        const double* leaks;
    };

    // Return v moved to where the barriers are finite: every v_e is at least INTERIOR w0 / E, then
    // all are scaled so that their sum is at most (1 - LEAST_SLACK) w0.
    std::vector<double> move_inside(const double* v) const {
        const std::size_t count = adversaries_.size();
        std::vector<double> point(count);
        double sum = 0.0;
        for (std::size_t e = 0; e < count; ++e)
            sum += point[e] = std::max(v[e], INTERIOR * w0_ / double(count));
        const double most = w0_ * (1 - LEAST_SLACK);
        if (sum > most)
            for (double& part : point) part *= most / sum;
        return point;
    }

    // All columns of a UAV, and the list of columns that the smoothed bound uses.
    struct Uav {
        std::vector<Column> columns, list;
    };

    double value(const Column& column, const double* v) const {
        double sum = column.value;
        for (std::size_t e = 0; e < adversaries_.size(); ++e) sum += v[e] * column.leaks[e];
        return sum;
    }

    // Add the JOINING best columns at v to a UAV's list. A column may be in the list repeatedly.
    void extend(Uav& uav, const double* v) {
        order_.clear();
        for (std::size_t c = 0; c < uav.columns.size(); ++c)
            order_.emplace_back(-value(uav.columns[c], v), c);
        const std::size_t joining = std::min(JOINING, order_.size());
        std::nth_element(order_.begin(), order_.begin() + std::ptrdiff_t(joining), order_.end());
        for (std::size_t i = 0; i < joining; ++i)
            uav.list.push_back(uav.columns[order_[i].second]);
    }

    // Minimise the smoothed bound F over v by Newton's method: v moves by -length step_, with
    // step_ = Hessian^-1 gradient. `length` is halved until F falls by a tenth of length times
    // `decrease` = step_ . gradient. The search ends when `decrease` is below ENOUGH tau, `length`
    // is below 1e-8, or the Hessian is singular, and after NEWTON_STEPS steps.
    void descend(std::vector<double>& v, double tau) {
        const std::size_t count = v.size();
        for (int step = 0; step < NEWTON_STEPS; ++step) {
            const double before = smooth(v, tau, true);
            step_ = gradient_;
            if (!kernel::solve_dense(hessian_.data(), step_.data(), int(count))) return;
            double decrease = 0.0;
            for (std::size_t e = 0; e < count; ++e) decrease += step_[e] * gradient_[e];
            if (!(decrease >= ENOUGH * tau)) return;
            for (double length = find_longest_step(v);; length /= 2) {
                if (length < 1e-8) return;
                for (std::size_t e = 0; e < count; ++e) trial_[e] = v[e] - length * step_[e];
                if (smooth(trial_, tau, false) <= before - 0.1 * length * decrease) break;
            }
            std::swap(v, trial_);
        }
    }

    // The largest length, at most 1, with which v - length step_ stays within its bounds:
    // MOST_OF_WAY of the way to where a v is 0 or the sum of v is w0.
    double find_longest_step(const std::vector<double>& v) const {
        double sum = 0.0, total = 0.0, length = 1.0;
        for (std::size_t e = 0; e < v.size(); ++e) {
            if (step_[e] > 0) length = std::min(length, MOST_OF_WAY * v[e] / step_[e]);
            sum -= step_[e];
            total += v[e];
        }
        return sum > 0 ? std::min(length, MOST_OF_WAY * (w0_ - total) / sum) : length;
    }

    // Return the smoothed bound on the lists of columns, plus the barriers -BARRIER tau log(.) of
    // every v and of w0 - s. If `differentiate`, fill gradient_ and hessian_ by v.
    double smooth(const std::vector<double>& v, double tau, bool differentiate) {
        double bound = constant(v.data()), sum = 0.0;
        for (const double part : v) {
            sum += part;
            bound -= BARRIER * tau * std::log(std::max(part, TINY));
        }
        bound -= BARRIER * tau * std::log(std::max(w0_ - sum, TINY));
        if (differentiate) differentiate_constant(v, sum, tau);
        for (const Uav& uav : uavs_) bound += smooth_maximum(uav, v, tau, differentiate);
        return bound;
    }

    // Fill gradient_ and hessian_ with the derivatives of m(w0 - s) - H(v) and of the barriers by
    // v, with the sum s. m has the gradient -log p and, with p below the peak, the Hessian
    // 1 / (w0 - s). -H has the gradient log t - log(1 - s) and the Hessian 1 / (1 - s), plus 1 / t
    // for two places of the same adversary; t is the sum of v over the places of that adversary.
    void differentiate_constant(const std::vector<double>& v, double sum, double tau) {
        const std::size_t count = v.size();
        const double slack = std::max(w0_ - sum, TINY), rest = std::max(1.0 - sum, TINY);
        const double best = slack / std::max(price_, TINY), power = std::min(best, peak_);
        const double slope = BARRIER * tau / slack - std::log(std::max(power, TINY) * rest);
        const double curvature = (best < peak_ ? 1 / slack : 0.0) + 1 / rest
            + BARRIER * tau / (slack * slack);
        gradient_.assign(count, slope);
        hessian_.assign(count * count, curvature);
        for (std::size_t e = 0; e < count; ++e) {
            const double total = std::max(totals_[adversaries_[e]], TINY);
            gradient_[e] += std::log(total) - BARRIER * tau / v[e];
            hessian_[e * count + e] += BARRIER * tau / (v[e] * v[e]);
            for (std::size_t f = 0; f < count; ++f)
                if (adversaries_[e] == adversaries_[f]) hessian_[e * count + f] += 1 / total;
        }
    }

    // Return tau log sum exp(value / tau) over the columns of a UAV's list, at v. If
    // `differentiate`, add its derivatives by v to gradient_ and hessian_.
    double smooth_maximum(const Uav& uav, const std::vector<double>& v, double tau,
                          bool differentiate) {
        weights_.clear();
        double top = -kernel::INFINITE, total = 0.0;
        for (const Column& column : uav.list) {
            weights_.push_back(value(column, v.data()));
            top = std::max(top, weights_.back());
        }
        for (double& weight : weights_) total += weight = std::exp((weight - top) / tau);
        if (differentiate) add_list(uav, total, tau);
        return top + tau * std::log(total);
    }

    // Add the derivatives by v of smooth_maximum(uav): to gradient_ the mean m of the columns'
    // leaks (E), to hessian_ their covariance over tau. Column c has the share weights_[c] / total.
    void add_list(const Uav& uav, double total, double tau) {
        const std::size_t count = adversaries_.size();
        mean_.assign(count, 0.0);
        for (std::size_t c = 0; c < weights_.size(); ++c) {
            const double share = weights_[c] / total, *leaks = uav.list[c].leaks;
            if (share < 1e-12) continue;
            for (std::size_t e = 0; e < count; ++e) {
                mean_[e] += share * leaks[e];
                for (std::size_t f = 0; f < count; ++f)
                    hessian_[e * count + f] += share / tau * leaks[e] * leaks[f];
            }
        }
        for (std::size_t e = 0; e < count; ++e) {
            gradient_[e] += mean_[e];
            for (std::size_t f = 0; f < count; ++f)
                hessian_[e * count + f] -= mean_[e] * mean_[f] / tau;
        }
    }

    std::vector<std::size_t> adversaries_;
    double price_, peak_;
    std::vector<double> totals_, trial_;  // Sums of v over every adversary; v after a step.
    std::vector<double> gradient_, hessian_, step_, mean_, weights_;
    double w0_ = 0.0;
    std::vector<Uav> uavs_;
    std::vector<std::pair<double, std::size_t>> order_;
};

// The columns of a UAV, the same number in every group.
struct Columns {
    explicit Columns(const py::tuple& arrays)
        : place(arrays[0].cast<py::buffer>(), "place"), base(arrays[1].cast<py::buffer>(), "base"),
          ground(arrays[2].cast<py::buffer>(), "ground", base.size()),
          leaks(arrays[3].cast<py::buffer>(), "leaks"), groups(base.shape(0)),
          count(base.shape(1)) {}

    // Add the columns of group g to a bound at w0: those whose places are between the corners `low`
    // and `high` of a cell, or all if `low` is null. Only the last UAV is restricted to a cell.
    void add_to(SlotBound& bound, std::size_t uav, std::size_t g, double w0, const double* low,
                const double* high) const {
        const std::size_t places = leaks.size() / base.size();
        for (std::size_t c = g * count; c < (g + 1) * count; ++c) {
            const double* q = &place[2 * c];
            if (!low
                || (q[0] >= low[0] && q[0] <= high[0] && q[1] >= low[1] && q[1] <= high[1]))
                bound.add(uav, base[c] + w0 * ground[c], &leaks[c * places]);
        }
    }

    Array<const double> place, base, ground, leaks;
    std::size_t groups, count;
};

// Minimise over v the bound of every row, a pair of one of K w0 and one of C' cells: row k C' + c.
// Replace `v` (K, C', E), the start, by the result; fill `maxima` (U, K, C') and `bounds` (K, C')
// at the result, in nats. core.pyi describes the other arguments.
void minimise_slot_bounds(const py::sequence& uavs, const py::buffer& adversaries, double price,
                          double peak, const py::buffer& group, const py::buffer& low,
                          const py::buffer& high, const py::buffer& weights, const py::buffer& v,
                          const py::buffer& maxima, const py::buffer& bounds) {
    const Array<const std::int64_t> adversary(adversaries, "adversaries"), groups(group, "group");
    const Array<const double> w0(weights, "weights");
    const std::size_t rows = w0.size(), places = adversary.size(), cells = groups.size();
    const Array<const double> lows(low, "low", 2 * cells), highs(high, "high", 2 * cells);
    const Array<double> points(v, "v", rows * places), values(bounds, "bounds", rows);
    const Array<double> largest(maxima, "maxima", uavs.size() * rows);
    std::vector<Columns> columns;
    for (const py::handle& uav : uavs) {
        columns.emplace_back(uav.cast<py::tuple>());
        const Columns& own = columns.back();
        expect(own.place.size() == 2 * own.base.size()
                   && own.leaks.size() == places * own.base.size(), "columns");
        for (std::size_t cell = 0; cell < cells; ++cell)
            expect(groups[cell] >= 0 && std::size_t(groups[cell]) < own.groups, "group");
    }
    std::vector<std::size_t> owners(adversary.data(), adversary.data() + places);
    for (const std::size_t owner : owners) expect(owner < places, "adversaries");
    const py::gil_scoped_release release;
    SlotBound bound(std::move(owners), price, peak);
    for (std::size_t row = 0; row < rows; ++row) {
        const std::size_t cell = row % cells, g = std::size_t(groups[cell]);
        bound.begin(w0[row], columns.size());
        for (std::size_t uav = 0; uav < columns.size(); ++uav) {
            const bool is_last = uav + 1 == columns.size();
            columns[uav].add_to(bound, uav, g, w0[row], is_last ? &lows[2 * cell] : nullptr,
                                &highs[2 * cell]);
        }
        double* point = &points[row * places];  // v of the row: its start, then its result.
        bound.minimise(point);
        values[row] = bound.constant(point);
        for (std::size_t uav = 0; uav < columns.size(); ++uav)
            values[row] += largest[uav * rows + row] = bound.find_maximum(uav, point);
    }
}

}  // namespace

void add_bound_slots(py::module_& module) {
    module.def("minimise_slot_bounds", &minimise_slot_bounds);
}
