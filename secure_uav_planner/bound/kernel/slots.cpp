// The multipliers v of the certificate: the bound of a slot on columns, minimised over v at a w0.
//
// The bound is m(w0 - s) - H(v) + sum over UAVs of the largest base + w0 ground + v . leaks, which
// is convex in v; see bound/proof/certificate.py. It is minimised along one direction after the
// other: along v itself, and from one eavesdropper's place to another's. Along a direction the
// largest is taken over a list of columns only. Before every sweep over the directions, the best
// columns at the present v are added to this list.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "array.hpp"
#include "numbers.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::expect;
using kernel::TINY;

namespace {

constexpr int SWEEPS = 4;            // Number of sweeps over all directions.
constexpr int LINE_STEPS = 20;       // Golden sections along a direction.
constexpr std::size_t JOINING = 60;  // Columns that join a UAV's list before a sweep.

// -share log(share), a term of an entropy.
double find_entropy(double share) {
    share = std::min(std::max(share, 0.0), 1.0);
    return -share * std::log(std::max(share, TINY));
}

// The bound of one slot at one w0. `listeners` has the listener of every place. `price` and `peak`
// are the price and the peak of the transmit power.
class SlotBound {
public:
    SlotBound(std::vector<std::size_t> listeners, double price, double peak)
        : listeners_(std::move(listeners)), price_(price), peak_(peak),
          totals_(listeners_.size()), v_(listeners_.size()) {}

    // Begin with another slot, at another w0 (`weight`), without columns.
    void begin(double weight, std::size_t uavs) {
        weight_ = weight;
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
    // given v, which the result replaces. Every sweep first adds the best columns at v to the
    // columns that the line searches use. Then it changes the sum of v, and moves a part of v from
    // one eavesdropper's place to another for each pair of places.
    void minimise(double* v) {
        const std::size_t count = listeners_.size();
        std::vector<double> direction(count);
        for (int sweep = 0; sweep < SWEEPS; ++sweep) {
            for (Uav& uav : uavs_) extend(uav, v);
            scale(v);
            for (std::size_t e = 0; e < count; ++e)
                for (std::size_t f = 0; f < e; ++f) {
                    std::fill(direction.begin(), direction.end(), 0.0);
                    direction[e] = 1.0;
                    direction[f] = -1.0;
                    const double length = search_line(v, direction.data(), -v[e], v[f]);
                    v[e] = std::max(v[e] + length, 0.0);
                    v[f] = std::max(v[f] - length, 0.0);
                }
        }
    }

    // Find the largest value of a UAV's columns, -infinity without any.
    double find_maximum(std::size_t uav, const double* v) const {
        double most = -kernel::INFINITE;
        for (const Column& column : uavs_[uav].columns) most = std::max(most, value(column, v));
        return most;
    }

    // The part of the bound that depends on v alone, m(w0 - s) - H(v).
    double constant(const double* v) {
        double sum = 0.0;
        std::fill(totals_.begin(), totals_.end(), 0.0);
        for (std::size_t e = 0; e < listeners_.size(); ++e) {
            totals_[listeners_[e]] += v[e];
            sum += v[e];
        }
        double entropy = find_entropy(1.0 - sum);
        for (const double total : totals_) entropy += find_entropy(total);
        const double slack = std::max(weight_ - sum, 0.0);
        const double power = std::min(slack / std::max(price_, TINY), peak_);
        return slack * std::log(std::max(power, TINY)) - price_ * power - entropy;
    }

private:
    struct Column {
        double value;
        const double* leaks;
    };

    // All columns of a UAV; the list of columns that are used along a direction; and the values and
    // slopes of this list along the present direction.
    struct Uav {
        std::vector<Column> columns, list;
        std::vector<std::pair<double, double>> line;
    };

    double value(const Column& column, const double* v) const {
        double sum = column.value;
        for (std::size_t e = 0; e < listeners_.size(); ++e) sum += v[e] * column.leaks[e];
        return sum;
    }

    // Add the best columns at v to a UAV's list.
    void extend(Uav& uav, const double* v) {
        order_.clear();
        for (std::size_t c = 0; c < uav.columns.size(); ++c)
            order_.emplace_back(-value(uav.columns[c], v), c);
        const std::size_t joining = std::min(JOINING, order_.size());
        std::nth_element(order_.begin(), order_.begin() + std::ptrdiff_t(joining), order_.end());
        for (std::size_t i = 0; i < joining; ++i)
            uav.list.push_back(uav.columns[order_[i].second]);
    }

    // Minimise over the sum of v, with the places' shares of this sum unchanged.
    void scale(double* v) {
        double sum = 0.0;
        for (std::size_t e = 0; e < listeners_.size(); ++e) sum += v[e];
        std::vector<double> share(v, v + listeners_.size());
        const std::vector<double> zero(share.size(), 0.0);
        for (double& part : share) part /= std::max(sum, TINY);
        sum = search_line(zero.data(), share.data(), 0.0, weight_);
        for (std::size_t e = 0; e < share.size(); ++e) v[e] = sum * share[e];
    }

    // Return the length of a step along a direction that minimises the bound, by golden section.
    double search_line(const double* start, const double* direction, double low, double high) {
        const double zero = 0.0;
        for (Uav& uav : uavs_) {
            uav.line.clear();
            for (const Column& column : uav.list)
                uav.line.emplace_back(value(column, start),
                                      value({zero, column.leaks}, direction));
        }
        const auto find_bound = [&](double length) {
            for (std::size_t e = 0; e < v_.size(); ++e) v_[e] = start[e] + length * direction[e];
            double sum = constant(v_.data());
            for (const Uav& uav : uavs_) {
                double most = -kernel::INFINITE;
                for (const auto& [value, slope] : uav.line)
                    most = std::max(most, value + length * slope);
                sum += most;
            }
            return sum;
        };
        const double gold = (std::sqrt(5.0) - 1) / 2;
        double x1 = high - gold * (high - low), x2 = low + gold * (high - low);
        double f1 = find_bound(x1), f2 = find_bound(x2);
        for (int step = 0; step < LINE_STEPS; ++step) {
            if (f1 < f2) {
                high = x2;
                x2 = x1;
                f2 = f1;
                x1 = high - gold * (high - low);
                f1 = find_bound(x1);
            } else {
                low = x1;
                x1 = x2;
                f1 = f2;
                x2 = low + gold * (high - low);
                f2 = find_bound(x2);
            }
        }
        return (low + high) / 2;
    }

    std::vector<std::size_t> listeners_;
    double price_, peak_;
    std::vector<double> totals_, v_;  // Sums of v over every listener; v along a direction.
    double weight_ = 0.0;
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

    Array<const double> place, base, ground, leaks;
    std::size_t groups, count;
};

// Minimise the bound of every row of w0 and cell over v; see core.pyi for the arguments.
void minimise_slot_bounds(const py::sequence& uavs, const py::buffer& listeners, double price,
                          double peak, const py::buffer& group, const py::buffer& low,
                          const py::buffer& high, const py::buffer& weights, const py::buffer& v,
                          const py::buffer& maxima, const py::buffer& bounds) {
    const Array<const std::int64_t> listener(listeners, "listeners"), groups(group, "group");
    const Array<const double> w0(weights, "weights");
    const std::size_t rows = w0.size(), places = listener.size(), cells = groups.size();
    const Array<const double> lows(low, "low", 2 * cells), highs(high, "high", 2 * cells);
    const Array<double> found(v, "v", rows * places), values(bounds, "bounds", rows);
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
    std::vector<std::size_t> owners(listener.data(), listener.data() + places);
    for (const std::size_t owner : owners) expect(owner < places, "listeners");
    const py::gil_scoped_release release;
    SlotBound bound(std::move(owners), price, peak);
    for (std::size_t row = 0; row < rows; ++row) {
        const std::size_t cell = row % cells;
        const double *a = &lows[2 * cell], *b = &highs[2 * cell];
        bound.begin(w0[row], columns.size());
        for (std::size_t uav = 0; uav < columns.size(); ++uav) {
            const Columns& own = columns[uav];
            const std::size_t first = std::size_t(groups[cell]) * own.count;
            for (std::size_t c = first; c < first + own.count; ++c) {
                const double* q = &own.place[2 * c];
                // Only the last UAV's columns are restricted to a cell.
                if (uav + 1 < columns.size()
                    || (q[0] >= a[0] && q[0] <= b[0] && q[1] >= a[1] && q[1] <= b[1]))
                    bound.add(uav, own.base[c] + w0[row] * own.ground[c], &own.leaks[c * places]);
            }
        }
        double* best = &found[row * places];
        bound.minimise(best);
        values[row] = bound.constant(best);
        for (std::size_t uav = 0; uav < columns.size(); ++uav) {
            largest[uav * rows + row] = bound.find_maximum(uav, best);
            values[row] += largest[uav * rows + row];
        }
    }
}

}  // namespace

void add_bound_slots(py::module_& module) {
    module.def("minimise_slot_bounds", &minimise_slot_bounds);
}
