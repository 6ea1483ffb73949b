// Lemma 8's boxes: how the shares and the powers of two jammers are divided. See bound/proof,
// jammer_shares.py, for what they are, and bound/search, breakpoints.py, for the arrays.
//
// What is found here may be bad, never wrong: the certificate computes every bound anew.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "array.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::size_of;

namespace {

constexpr std::size_t kMost = 4;        // Receivers at most: the ground node and eavesdroppers.
constexpr std::size_t kVertices = 8;    // Corners of a box of shares at most.
constexpr std::size_t kExtra = 96;      // Improved columns that a box keeps.
constexpr int kBisections = 12;
constexpr int kRounds = 8;              // Of a search for a better place and power.
constexpr double kAside = 0.02;         // On both sides of the best theta columns are improved.
constexpr double kEnd = 0.005;          // Share of a jammer from which it is cut no finer.
constexpr double kHuge = std::numeric_limits<double>::infinity();

double entropy(double x) {
    const double y = 1 - x;
    return -(x > 0 ? x * std::log(x) : 0.0) - (y > 0 ? y * std::log(y) : 0.0);
}

double sigmoid(double z) { return 1 / (1 + std::exp(-std::min(std::max(z, -700.0), 700.0))); }

// A jammer's place and log p, their worth without the rates, and log(1 + 2 x) at receivers.
struct Column {
    double place[2], power, base, heard[kMost];
};

using Columns = std::vector<Column>;

struct Box {
    double low[kMost + 1], high[kMost + 1];  // Of the shares, then of log p of both jammers.
    double theta, slope[kMost - 1];
    double known[2][kVertices];
    double bound;
    double at[kMost + 1];  // Where every side may be cut.
    Columns extra[2];
};

class Problem {
public:
    explicit Problem(const py::dict& given)
        : stages_(given["stages"].cast<std::size_t>()),
          receivers_(size_of(given, "radii") / 2), shares_(receivers_ - 1),
          vertices_(std::size_t(1) << shares_),
          columns_(size_of(given, "power") / (2 * stages_)),
          place_(given, "place", 4 * stages_ * columns_),
          power_(given, "power", 2 * stages_ * columns_),
          base_(given, "base", 2 * stages_ * columns_), pull_(given, "pull", 4 * stages_),
          people_(given, "people", 4 * receivers_), radii_(given, "radii", 2 * receivers_),
          gain_(given, "gain", 2 * receivers_), altitude_(given, "altitude", 2),
          distance_(given, "distance", 2), price_(given, "price", 2), peak_(given, "peak", 2),
          from_start_(given, "from_start", 2 * stages_), to_goal_(given, "to_goal", 2 * stages_),
          width_(given, "width", 2 * stages_) {
        if (receivers_ < 2 || receivers_ > kMost)
            throw std::invalid_argument("wrong array: radii");
    }

    std::size_t shares() const { return shares_; }
    std::size_t vertices() const { return vertices_; }
    std::size_t stages() const { return stages_; }

    // Take up a stage with w0 and v.
    void begin(std::size_t stage, double weight, const double* v) {
        stage_ = stage;
        weight_ = weight;
        std::copy(v, v + shares_, v_);
        for (std::size_t j = 0; j < 2; ++j) {
            own_[j].resize(columns_);
            for (std::size_t c = 0; c < columns_; ++c) {
                const std::size_t at = (j * stages_ + stage) * columns_ + c;
                Column& column = own_[j][c];
                column.place[0] = place_[2 * at];
                column.place[1] = place_[2 * at + 1];
                column.power = power_[at];
                column.base = base_[at];
                hear(j, column);
            }
        }
    }

    Box whole() {
        Box box{};
        std::fill(box.high, box.high + shares_, 1.0);
        std::fill(box.low + shares_, box.low + shares_ + 2, -kHuge);
        std::fill(box.high + shares_, box.high + shares_ + 2, kHuge);
        fit(box);
        return box;
    }

    // Cut a box as lowers it most, keep the lower part, return the upper one and the cut.
    Box split(Box& box, std::size_t* side, double* at) {
        Box best[2];
        double score = kHuge;
        for (std::size_t i = 0; i < shares_ + 2; ++i) {
            Box part[2] = {box, box};
            const double cut = std::min(std::max(box.at[i], box.low[i]), box.high[i]);
            if (i > 0 && !(cut > box.low[i] && cut < box.high[i])) continue;
            part[0].high[i] = part[1].low[i] = cut;
            fit(part[0]);
            fit(part[1]);
            const double more = std::max(part[0].bound, part[1].bound)
                                + 1e-3 * std::min(part[0].bound, part[1].bound);
            if (i > 0 && !(more < score)) continue;
            score = more;
            best[0] = part[0];
            best[1] = part[1];
            *side = i;
            *at = cut;
        }
        box = best[0];
        return best[1];
    }

private:
    void hear(std::size_t j, Column& column) const {
        const double watts = std::exp(column.power), square = altitude_[j] * altitude_[j];
        for (std::size_t r = 0; r < receivers_; ++r) {
            const double x = column.place[0] - people_[2 * (j * receivers_ + r)];
            const double y = column.place[1] - people_[2 * (j * receivers_ + r) + 1];
            const double d = std::sqrt(x * x + y * y) + radii_[j * receivers_ + r];
            column.heard[r] = std::log1p(gain_[j * receivers_ + r] * watts / (d * d + square));
        }
    }

    // The weights of what receivers hear of jammer j at a corner.
    void weights(const Box& box, std::size_t j, std::size_t vertex, double theta,
                 double* w) const {
        w[0] = -weight_ * (j ? 1 - theta : theta);
        for (std::size_t e = 0; e < shares_; ++e) {
            const double rho = corner(box, vertex, e);
            w[e + 1] = v_[e] * (j ? 1 - rho : rho);
        }
    }

    double corner(const Box& box, std::size_t vertex, std::size_t e) const {
        return vertex >> (shares_ - 1 - e) & 1 ? box.high[e] : box.low[e];
    }

    double worth(std::size_t j, const Column& column, const double* w) const {
        double value = column.base - price_[j] * std::exp(column.power);
        for (std::size_t r = 0; r < receivers_; ++r) value += w[r] * column.heard[r];
        return value;
    }

    // List the columns with their powers drawn into a box.
    void list(const Box& box) {
        for (std::size_t j = 0; j < 2; ++j) {
            listed_[j] = own_[j];
            listed_[j].insert(listed_[j].end(), box.extra[j].begin(), box.extra[j].end());
            for (Column& column : listed_[j]) {
                const double power = std::min(std::max(column.power, box.low[shares_ + j]),
                                              std::min(box.high[shares_ + j], peak_[j]));
                if (power == column.power) continue;
                column.power = power;
                hear(j, column);
            }
        }
    }

    // What columns are worth at the corners without the ground node, and what that takes away.
    void tabulate(const Box& box) {
        double w[kMost];
        for (std::size_t j = 0; j < 2; ++j) {
            const std::size_t n = listed_[j].size();
            table_[j].resize(n * vertices_);
            less_[j].resize(n);
            for (std::size_t c = 0; c < n; ++c) {
                const Column& column = listed_[j][c];
                less_[j][c] = weight_ * column.heard[0];
                const double cost = price_[j] * std::exp(column.power);
                for (std::size_t vertex = 0; vertex < vertices_; ++vertex) {
                    weights(box, j, vertex, 0.0, w);
                    double value = column.base - cost;
                    for (std::size_t e = 1; e < receivers_; ++e) value += w[e] * column.heard[e];
                    table_[j][vertex * n + c] = value;
                }
            }
        }
    }

    std::size_t best(std::size_t j, std::size_t vertex, double theta) const {
        const double share = j ? 1 - theta : theta;
        const std::size_t n = listed_[j].size();
        const double *row = &table_[j][vertex * n], *less = less_[j].data();
        double top = -kHuge;
        std::size_t found = 0;
        for (std::size_t c = 0; c < n; ++c) {
            const double value = row[c] - share * less[c];
            if (value > top) {
                top = value;
                found = c;
            }
        }
        return found;
    }

    // The theta that minimises F at a corner.
    double best_theta(std::size_t vertex) const {
        double low = 0, high = 1;
        for (int k = 0; k < kBisections; ++k) {
            const double theta = (low + high) / 2;
            const double slope = -listed_[0][best(0, vertex, theta)].heard[0]
                + listed_[1][best(1, vertex, theta)].heard[0] + std::log(theta / (1 - theta));
            (slope < 0 ? low : high) = theta;
        }
        return (low + high) / 2;
    }

    // Move a column to where it is worth more.
    void improve(const Box& box, std::size_t j, const double* w, Column& column) const {
        double step = width_[j * stages_ + stage_] / 12, ratio = 0.4;
        double top = worth(j, column, w);
        const double* pull = &pull_[2 * (j * stages_ + stage_)];
        const double from = from_start_[j * stages_ + stage_], to = to_goal_[j * stages_ + stage_];
        const double least = box.low[shares_ + j];
        const double most = std::min(box.high[shares_ + j], peak_[j]);
        for (int round = 0; round < kRounds; ++round) {
            Column next = column;
            for (int move = 0; move < 6; ++move) {
                Column trial = column;
                const double sign = move % 2 ? -1 : 1;
                if (move < 4) {
                    const int axis = move / 2;
                    trial.place[axis] += sign * step;
                    const double x = trial.place[0], y = trial.place[1];
                    if (x * x + y * y > from * from) continue;
                    if ((x - distance_[j]) * (x - distance_[j]) + y * y > to * to) continue;
                    trial.base += pull[axis] * sign * step;
                } else {
                    trial.power = std::min(std::max(trial.power + sign * ratio, least), most);
                    if (!(trial.power != column.power)) continue;
                }
                hear(j, trial);
                const double value = worth(j, trial, w);
                if (value > top) {
                    top = value;
                    next = trial;
                }
            }
            if (next.power == column.power) ratio /= 2.5;
            if (next.place[0] == column.place[0] && next.place[1] == column.place[1]) step /= 2.5;
            column = next;
        }
    }

    // Add what is better than the columns near given theta at every corner.
    void extend(Box& box, const double* theta, double aside) {
        double w[kMost];
        for (std::size_t j = 0; j < 2; ++j) {
            Columns fresh;
            for (std::size_t vertex = 0; vertex < vertices_; ++vertex)
                for (int sign = -1; sign <= (aside > 0 ? 1 : -1); sign += 2) {
                    const double at = std::min(std::max(theta[vertex] + sign * aside, 0.0), 1.0);
                    Column column = listed_[j][best(j, vertex, at)];
                    weights(box, j, vertex, at, w);
                    const double before = worth(j, column, w);
                    improve(box, j, w, column);
                    if (worth(j, column, w) > before + 1e-5) fresh.push_back(column);
                }
            Columns& extra = box.extra[j];
            if (extra.size() + fresh.size() > kExtra)
                extra.erase(extra.begin(), extra.begin() + std::min<std::size_t>(
                    fresh.size(), extra.size()));
            extra.insert(extra.end(), fresh.begin(), fresh.end());
        }
        list(box);
        tabulate(box);
    }

    // Find theta, the bound and the cuts of a box.
    void fit(Box& box) {
        double theta[kVertices];
        list(box);
        tabulate(box);
        for (int round = 0; round < 2; ++round) {
            for (std::size_t vertex = 0; vertex < vertices_; ++vertex)
                theta[vertex] = best_theta(vertex);
            if (round == 0) extend(box, theta, kAside);
        }
        plane(box, theta);
        extend(box, theta, 0.0);
        double values[kVertices];
        for (std::size_t vertex = 0; vertex < vertices_; ++vertex) {
            values[vertex] = -weight_ * (entropy(theta[vertex]) - std::log(2.0));
            for (std::size_t j = 0; j < 2; ++j) {
                const std::size_t c = best(j, vertex, theta[vertex]);
                const double share = j ? 1 - theta[vertex] : theta[vertex];
                box.known[j][vertex] = table_[j][vertex * listed_[j].size() + c]
                                       - share * less_[j][c];
                values[vertex] += box.known[j][vertex];
            }
        }
        bound(box, values);
        choose(box, theta);
    }

    // The slope of values at the corners along a share.
    double rise(const Box& box, const double* values, std::size_t e) const {
        double sum = 0;
        for (std::size_t vertex = 0; vertex < vertices_; ++vertex)
            sum += (vertex >> (shares_ - 1 - e) & 1 ? 1 : -1) * values[vertex];
        const double width = box.high[e] - box.low[e];
        return width > 1e-9 ? sum / (double(vertices_) / 2) / width : 0.0;
    }

    // Make theta affine in the shares, with values from 0 to 1.
    void plane(Box& box, double* theta) const {
        double middle = 0, most = 1e-300;
        for (std::size_t vertex = 0; vertex < vertices_; ++vertex)
            middle += theta[vertex] / double(vertices_);
        for (std::size_t e = 0; e < shares_; ++e) box.slope[e] = rise(box, theta, e);
        const auto away = [&](std::size_t vertex) {
            double sum = 0;
            for (std::size_t e = 0; e < shares_; ++e)
                sum += box.slope[e] * (corner(box, vertex, e) - (box.low[e] + box.high[e]) / 2);
            return sum;
        };
        for (std::size_t vertex = 0; vertex < vertices_; ++vertex)
            most = std::max(most, std::abs(away(vertex)));
        const double factor = std::min(1.0, std::min(middle, 1 - middle) * (1 - 1e-9) / most);
        box.theta = middle;
        for (std::size_t e = 0; e < shares_; ++e) {
            box.slope[e] *= factor;
            box.theta -= box.slope[e] * (box.low[e] + box.high[e]) / 2;
        }
        for (std::size_t vertex = 0; vertex < vertices_; ++vertex)
            theta[vertex] = std::min(std::max(middle + away(vertex), 0.0), 1.0);
    }

    // The bound over a box from F at its corners; see over_boxes.
    void bound(Box& box, const double* values) const {
        double slope[kMost], top = -kHuge;
        for (std::size_t e = 0; e < shares_; ++e)
            slope[e] = std::min(std::max(
                rise(box, values, e) / std::max(v_[e], 1e-300), -100.0), 100.0);
        for (std::size_t vertex = 0; vertex < vertices_; ++vertex) {
            double value = values[vertex];
            for (std::size_t e = 0; e < shares_; ++e)
                value -= corner(box, vertex, e) * v_[e] * slope[e];
            top = std::max(top, value);
        }
        for (std::size_t e = 0; e < shares_; ++e) {
            const double rho = std::min(std::max(sigmoid(slope[e]), box.low[e]), box.high[e]);
            top += v_[e] * (rho * slope[e] + entropy(rho) - std::log(2.0));
        }
        box.bound = top;
    }

    // Find where every share and every power may be cut.
    void choose(Box& box, const double* theta) const {
        // The middle, by the logarithm of what one jammer is heard with more than the other.
        for (std::size_t e = 0; e < shares_; ++e) {
            double z = 0;
            for (const double end : {box.low[e], box.high[e]}) {
                const double x = std::min(std::max(end, kEnd), 1 - kEnd);
                z += std::log(x / (1 - x)) / 2;
            }
            box.at[e] = sigmoid(z);
        }
        for (std::size_t j = 0; j < 2; ++j) {
            const Column *quiet = nullptr, *loud = nullptr;
            for (std::size_t vertex = 0; vertex < vertices_; ++vertex)
                for (int sign = -1; sign <= 1; sign += 2) {
                    const double at = std::min(std::max(theta[vertex] + sign * kAside, 0.0), 1.0);
                    const Column* one = &listed_[j][best(j, vertex, at)];
                    if (!quiet || one->power < quiet->power) quiet = one;
                    if (!loud || one->power > loud->power) loud = one;
                }
            // The middle of what is heard by whoever hears the louder one best.
            const double heard = *std::max_element(loud->heard, loud->heard + receivers_);
            const double gain = std::expm1(heard) / std::exp(loud->power);
            const double middle = (heard + std::log1p(gain * std::exp(quiet->power))) / 2;
            box.at[shares_ + j] = quiet->power < loud->power ? std::log(std::expm1(middle) / gain)
                                                       : -kHuge;
        }
    }

    std::size_t stages_, receivers_, shares_, vertices_, columns_;
    Array<double> place_, power_, base_, pull_, people_, radii_, gain_, altitude_, distance_,
        price_, peak_, from_start_, to_goal_, width_;
    std::size_t stage_ = 0;
    double weight_ = 0, v_[kMost] = {};
    Columns own_[2], listed_[2];
    std::vector<double> table_[2], less_[2];
};

// Divide what two jammers can do at M breakpoints.
void share_boxes(const py::dict& given) {
    Problem problem(given);
    const std::size_t count = size_of(given, "stage"), e = problem.shares();
    const std::size_t splits = size_of(given, "at") / std::max<std::size_t>(count, 1);
    const std::size_t boxes = splits + 1, vertices = problem.vertices();
    const Array<std::int64_t> stage(given, "stage", count), which(given, "box", count * splits),
        side(given, "side", count * splits);
    const Array<double> weight(given, "weight", count), shares(given, "shares", count * e),
        at(given, "at", count * splits), theta(given, "theta", count * boxes),
        slope(given, "slope", count * boxes * e),
        known(given, "known", 2 * count * boxes * vertices);
    for (std::size_t m = 0; m < count; ++m)
        if (stage[m] < 0 || std::size_t(stage[m]) >= problem.stages())
            throw std::invalid_argument("wrong array: stage");
    const py::gil_scoped_release release;
    for (std::size_t m = 0; m < count; ++m) {
        problem.begin(std::size_t(stage[m]), weight[m], &shares[m * e]);
        std::vector<Box> found{problem.whole()};
        for (std::size_t s = 0; s < splits; ++s) {
            std::size_t worst = 0, cut = 0;
            for (std::size_t b = 1; b < found.size(); ++b)
                if (found[b].bound > found[worst].bound) worst = b;
            Box rest = problem.split(found[worst], &cut, &at[m * splits + s]);
            which[m * splits + s] = std::int64_t(worst);
            side[m * splits + s] = std::int64_t(cut);
            found.push_back(rest);
        }
        for (std::size_t b = 0; b < boxes; ++b) {
            theta[m * boxes + b] = found[b].theta;
            std::copy(found[b].slope, found[b].slope + e, &slope[(m * boxes + b) * e]);
            for (std::size_t j = 0; j < 2; ++j)
                std::copy(found[b].known[j], found[b].known[j] + vertices,
                          &known[((m * boxes + b) * 2 + j) * vertices]);
        }
    }
}

}  // namespace

void add_bound_shares(py::module_& module) { module.def("bound_share_boxes", &share_boxes); }
