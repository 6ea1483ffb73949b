// Lemma 5 of bound/proof: the largest value of one UAV's term, by branch and bound.
//
// boxes.py says what is bounded and what its arrays hold; rounding.py what the margins cover.
//
// On a box with centre m a function F is at most F(m) + grad F(m) . dq + K |dq|^2 / 2, K being at
// least every second derivative in the box, negative where it can be. With q = d^2 + H^2 at a
// distance d from a receiver, the eigenvalues of the second derivatives are
//
//     of -log q:                   -2 / q across and 2 (d^2 - H^2) / q^2 along the radius; the
//                                  second is the larger one,
//     of log q:                    those with the other sign, at most 2 / q,
//     of -log((d + eps)^2 + H^2):  at most 2 (x^2 - H^2) / (x^2 + H^2)^2, x = d + eps; its kink at
//                                  d = 0 points upwards, so any supergradient serves there.
//
// log([d - eps]+^2 + H^2) needs no such search: the square of the distance from a disc changes by at
// most its gradient times dq plus |dq|^2, and log(q + x) <= log q + x / q. So 2 / q at the centre,
// with [d - eps]+ for d, serves for K over every box.
//
// A jammer's term is taken in pi = log p, with y = p b(q) and z = log y, so that
// phi' = y / (1 + y) and phi'' = y / (1 + y)^2. -w0 phi(z0) adds at most w0 phi'(z0) 2 / q, because
// -phi'' is not positive. v phi(z_e) adds v phi'' (|dpi| + G |dq|)^2, G being the largest gradient
// of z_e, 2 x / (x^2 + H^2), and v phi' times the eigenvalue above, with the largest phi' where
// that is positive and the smallest where it is not. -lam e^pi adds no more than -lam times its
// least value. Every factor is taken at the end of its range over the box where it is largest.
//
// The potential's q . S q / 2 is bounded as it is, and for its |g + S dq| with g = u + S m both
// |g| + g . S dq / |g| + |S dq|^2 / (2 |g|) and |g| + g . S dq / |g| + 2 |S dq| are bounds. What is
// linear is at most the box's maximum, and the reachable set's (support); on the rim `pressed`
// takes the slope across it away. Second order matters: near a maximum inside the reachable set,
// or on its rim, the number of boxes does not grow as they shrink.
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

constexpr int kParts = 4;               // Boxes along every side of the first grid.
constexpr double kBoxRounding = 1e-14;  // Share by which the halves of a box are widened.
constexpr double kTiny = 1e-300;

struct Box {
    double centre[3], half[3], bound;
};

// What a box is worth: at its centre, at most, and how much of that each side is to blame for.
struct Worth {
    double value, bound, score[3];
};

// The largest slope x + bend x^2 / 2 over |x| <= half.
double largest(double slope, double half, double bend) {
    slope = std::abs(slope);
    return bend * half < -slope ? slope * slope / (-2 * bend) : (slope + bend * half / 2) * half;
}

// The largest second derivative of -log(x^2 + H^2) for low <= x <= high:
// 2 (x^2 - H^2) / (x^2 + H^2)^2 rises up to x = sqrt(3) H and falls beyond.
double radial(double low, double high, double altitude) {
    const double x = std::min(std::max(low, std::sqrt(3.0) * altitude), high), x2 = x * x;
    const double square = altitude * altitude, q = x2 + square;
    return 2 * (x2 - square) / (q * q);
}

double positive(double x) { return x > 0 ? x : 0; }

class Terms {
public:
    explicit Terms(const py::dict& given)
        : count_(size_of(given, "weight")), stages_(size_of(given, "from_start")),
          eavesdroppers_(size_of(given, "radii")), altitude_(given["altitude"].cast<double>()),
          distance_(given["distance"].cast<double>()), price_(given["price"].cast<double>()),
          log_gain_(given["log_gain"].cast<double>()),
          jams_(given["jams"].cast<bool>()), ground_(given, "ground", 2),
          places_(given, "eavesdroppers", 2 * eavesdroppers_),
          radii_(given, "radii", eavesdroppers_),
          log_advantages_(given, "log_advantages", eavesdroppers_),
          from_start_(given, "from_start", stages_), to_goal_(given, "to_goal", stages_),
          corner_(given, "corner", 2 * stages_), low_(given, "low", 2 * stages_),
          high_(given, "high", 2 * stages_), stage_(given, "stage", count_),
          weight_(given, "weight", count_), shares_(given, "shares", count_ * eavesdroppers_),
          slope_(given, "slope", 2 * count_), bend_(given, "bend", 3 * count_),
          tilt_(given, "tilt", 6 * count_), margin_(given, "margin", count_),
          powers_(given, "powers", 2 * count_) {
        gain_.push_back(std::exp(log_gain_));
        for (std::size_t e = 0; e < eavesdroppers_; ++e)
            gain_.push_back(std::exp(log_gain_ + log_advantages_[e]));
        for (std::size_t k = 0; k < count_; ++k)
            if (stage_[k] < 0 || std::size_t(stage_[k]) >= stages_)
                throw std::invalid_argument("wrong array: stage");
    }

    std::size_t size() const { return count_; }
    int dimensions() const { return jams_ ? 3 : 2; }

    Worth worth(std::size_t k, const Box& box) const {
        const double a = box.centre[0], b = box.centre[1], ha = box.half[0], hb = box.half[1];
        const double rho = std::sqrt(ha * ha + hb * hb);
        Expansion f = jams_ ? jammer(k, box, rho) : transmitter(k, box, rho);
        double ga = slope_[2 * k], gb = slope_[2 * k + 1], rest = margin_[k];
        f.value += ga * a + gb * b;
        double ka = f.bend, kb = f.bend, size = f.size;
        const double *s = &bend_[3 * k], *t = &tilt_[6 * k];
        if (s[0] != 0 || s[1] != 0 || s[2] != 0) {
            const double sa = s[0] * a + s[1] * b, sb = s[1] * a + s[2] * b;
            f.value += (sa * a + sb * b) / 2;
            ga += sa;
            gb += sb;
            ka += s[0];
            kb += s[2];
            rest += std::abs(s[1]) * ha * hb;
            size += std::abs(s[0]) + 2 * std::abs(s[1]) + std::abs(s[2]);
        }
        if (t[0] != 0) {
            const double ta = t[1] + t[3] * a + t[4] * b, tb = t[2] + t[4] * a + t[5] * b;
            const double safe = std::max(std::sqrt(ta * ta + tb * tb), 1e-150);
            f.value += t[0] * safe;
            ga += t[0] * (t[3] * ta + t[4] * tb) / safe;
            gb += t[0] * (t[4] * ta + t[5] * tb) / safe;
            const double norm = std::sqrt(t[3] * t[3] + 2 * t[4] * t[4] + t[5] * t[5]);
            if (norm * rho > 4 * safe) {
                rest += 2 * t[0] * norm * rho;
            } else {
                const double more = t[0] * norm * norm / safe;
                ka += more;
                kb += more;
                size += more;
            }
        }
        ga += f.ga;
        gb += f.gb;
        double plane = largest(ga, ha, ka) + largest(gb, hb, kb);
        const bool out[2] = {
            outside(box, 0.0, from_start_[stage_[k]]), outside(box, distance_, to_goal_[stage_[k]])};
        if (out[0] || out[1]) {  // Else the reachable set says no more than the box.
            const double whole = support(ga, gb, stage_[k]) - (ga * a + gb * b)
                + (positive(ka) * ha * ha + positive(kb) * hb * hb) / 2;
            double g[2] = {ga, gb}, bend[2] = {ka, kb};
            const double extra = pressed(box, out, g, bend, stage_[k]);
            const double rim = extra + largest(g[0], ha, bend[0]) + largest(g[1], hb, bend[1]);
            plane = std::min(plane, std::min(whole, rim));
        }
        Worth found{f.value, f.value + plane + rest, {0, 0, 0}};
        // Where terms cancel, or a box sticks out of the set, it is their sizes that count.
        found.score[0] = (std::abs(ga) + size * ha / 2) * ha;
        found.score[1] = (std::abs(gb) + size * hb / 2) * hb;
        if (jams_) {
            found.bound += largest(f.gp, box.half[2], f.bend_power);
            found.score[2] = (std::abs(f.gp) + f.size_power * box.half[2] / 2) * box.half[2];
        }
        return found;
    }

    // An upper bound of the largest value of function k.
    double maximum(std::size_t k, double known, double tolerance, double budget) const {
        const int dimensions = this->dimensions();
        const std::size_t stage = stage_[k];
        double best = known + tolerance;
        std::vector<Box> queue = grid(k);
        for (std::size_t head = 0; head < queue.size(); ++head) {
            const Box box = queue[head];
            // Written so that a NaN is never dropped.
            if (box.bound <= best || !meets(box, stage)) continue;
            const bool ended = double(head) >= budget;
            if (ended && std::isfinite(box.bound)) {
                best = std::max(best, box.bound);
                continue;
            }
            const Worth found = worth(k, box);
            if (ended) {
                if (!(found.bound <= best)) best = found.bound;
                if (std::isnan(best)) return best;
                continue;
            }
            if (inside(box.centre, stage)) best = std::max(best, found.value + tolerance);
            if (found.bound <= best) continue;
            int side = 0;
            for (int i = 1; i < dimensions; ++i)
                if (found.score[i] > found.score[side]) side = i;
            Box half = box;
            half.bound = found.bound;
            const double width = box.half[side] / 2;
            // A box twice as small as the spacing of floats is widened to it.
            half.half[side] = width * (1 + kBoxRounding) + 2e-16 * std::abs(box.centre[side]);
            half.centre[side] = box.centre[side] - width;
            queue.push_back(half);
            half.centre[side] = box.centre[side] + width;
            queue.push_back(half);
        }
        return best;
    }

private:
    // What the rates add to a function over a box: value and derivatives at the centre, numbers
    // such that bend |dq|^2 + bend_power dpi^2 is at least the second derivative along (dq, dpi)
    // anywhere in the box, and the sums of the sizes of their terms.
    struct Expansion {
        double value, ga, gb, gp, bend, bend_power, size, size_power;
    };

    Expansion transmitter(std::size_t k, const Box& box, double rho) const {
        const double square = altitude_ * altitude_, weight = weight_[k];
        const double da = box.centre[0] - ground_[0], db = box.centre[1] - ground_[1];
        const double d = std::sqrt(da * da + db * db), q = d * d + square;
        Expansion f{};
        f.value = weight * (log_gain_ - std::log(q));
        f.ga = -2 * weight / q * da;
        f.gb = -2 * weight / q * db;
        f.bend = weight * radial(positive(d - rho), d + rho, altitude_);
        f.size = std::abs(f.bend);
        for (std::size_t e = 0; e < eavesdroppers_; ++e) {
            const double share = shares_[k * eavesdroppers_ + e];
            const double ea = box.centre[0] - places_[2 * e];
            const double eb = box.centre[1] - places_[2 * e + 1];
            const double d = std::sqrt(ea * ea + eb * eb), x = positive(d - radii_[e]);
            const double q = x * x + square;
            f.value += share * (std::log(q) - (log_gain_ + log_advantages_[e]));
            const double factor = share * 2 * x / (q * std::max(d, kTiny));
            f.ga += factor * ea;
            f.gb += factor * eb;
            const double more = share * 2 / q;
            f.bend += more;
            f.size += more;
        }
        return f;
    }

    Expansion jammer(std::size_t k, const Box& box, double rho) const {
        const double square = altitude_ * altitude_, weight = weight_[k], width = box.half[2];
        const double watts = std::exp(box.centre[2]), more = std::exp(width);
        const double cost = price_ * watts, received = gain_[0] * watts;
        const double da = box.centre[0] - ground_[0], db = box.centre[1] - ground_[1];
        const double d2 = da * da + db * db, q = d2 + square, y = received / q;
        Expansion f{};
        f.value = -weight * std::log(1 + y) - cost;
        const double use = weight * (y / (1 + y));
        f.ga = 2 * use / q * da;
        f.gb = 2 * use / q * db;
        f.gp = -use - cost;
        const double nearest = positive(std::sqrt(d2) - rho), near = nearest * nearest + square;
        const double top = received * more / near;
        f.bend = weight * (top / (1 + top)) * 2 / near;
        f.bend_power = -cost / more;
        f.size = f.bend;
        f.size_power = -f.bend_power;
        for (std::size_t e = 0; e < eavesdroppers_; ++e) {
            const double share = shares_[k * eavesdroppers_ + e];
            const double gain = gain_[e + 1] * watts;
            const double ea = box.centre[0] - places_[2 * e];
            const double eb = box.centre[1] - places_[2 * e + 1];
            const double d = std::sqrt(ea * ea + eb * eb), x = d + radii_[e];
            const double q = x * x + square, y = gain / q;
            f.value += share * std::log(1 + y);
            const double use = share * (y / (1 + y));
            const double factor = -use * 2 * x / (q * std::max(d, kTiny));
            f.ga += factor * ea;
            f.gb += factor * eb;
            f.gp += use;
            const double low = positive(d - rho) + radii_[e], high = x + rho;
            const double top = gain * more / (low * low + square);
            const double least = gain / more / (high * high + square);
            // phi'' is y / (1 + y)^2, largest at y = 1.
            double at = std::min(std::max(least, 1.0), top);
            const double twice = share * at / ((1 + at) * (1 + at));
            at = std::min(std::max(altitude_, low), high);
            const double steep = 2 * at / (at * at + square);
            // (|dpi| + G |dq|)^2: the two squares and the product are shared out.
            const double plane = twice * steep * (steep + width / std::max(rho, kTiny));
            const double power = twice * (1 + steep * rho / std::max(width, kTiny));
            const double round = radial(low, high, altitude_);
            at = round > 0 ? top : least;
            const double along = share * (at / (1 + at)) * round;
            f.bend += plane + along;
            f.bend_power += power;
            f.size += plane + std::abs(along);
            f.size_power += power;
        }
        return f;
    }

    std::vector<Box> grid(std::size_t k) const {
        const std::size_t stage = stage_[k];
        double low[3], high[3];
        for (int i = 0; i < 2; ++i) {
            low[i] = low_[2 * stage + i];
            high[i] = high_[2 * stage + i];
        }
        low[2] = powers_[2 * k];
        high[2] = powers_[2 * k + 1];
        const int all = kParts * kParts * (jams_ ? kParts : 1);
        std::vector<Box> boxes(all);
        for (int number = 0; number < all; ++number) {
            Box& box = boxes[number];
            box.bound = std::numeric_limits<double>::infinity();
            int at = number;
            for (int i = 0; i < dimensions(); ++i, at /= kParts) {
                box.centre[i] = low[i] + (high[i] - low[i]) * (at % kParts + 0.5) / kParts;
                // The centre is off by a few eps of the corners, so boxes reach farther.
                box.half[i] = (high[i] - low[i]) / (2 * kParts) * (1 + kBoxRounding)
                              + 4e-16 * (std::abs(low[i]) + std::abs(high[i]));
            }
        }
        return boxes;
    }

    // Whether a box meets both discs.
    bool meets(const Box& box, std::size_t stage) const {
        const auto apart = [](double x, double half) {
            const double far = positive(std::abs(x) - half);
            return far * far;
        };
        const double across = apart(box.centre[1], box.half[1]);
        const double near = from_start_[stage], far = to_goal_[stage];
        return apart(box.centre[0], box.half[0]) + across <= near * near
               && apart(box.centre[0] - distance_, box.half[0]) + across <= far * far;
    }

    bool inside(const double* place, std::size_t stage) const {
        const double x = place[0], along = x - distance_, across = place[1] * place[1];
        const double near = from_start_[stage], far = to_goal_[stage];
        return x * x + across <= near * near && along * along + across <= far * far;
    }

    // Whether a box sticks out of the disc about (middle, 0).
    static bool outside(const Box& box, double middle, double radius) {
        const double x = std::abs(box.centre[0] - middle) + box.half[0];
        const double y = std::abs(box.centre[1]) + box.half[1];
        return x * x + y * y > radius * radius;
    }

    // ReachableSet.support, which derives it (lemma 6).
    double support(double ga, double gb, std::size_t stage) const {
        const double near = from_start_[stage], far = to_goal_[stage];
        const double along = corner_[2 * stage], across = corner_[2 * stage + 1];
        const double norm = std::sqrt(ga * ga + gb * gb);
        double best = std::min(near * norm, far * norm + ga * distance_);
        if (across > 0) {
            const double share =
                positive((along * std::abs(gb) / across - ga) / distance_);
            const double sa = share * (along - distance_);
            const double sb = share * (gb > 0 ? across : gb < 0 ? -across : 0.0);
            best = std::min(best, near * std::hypot(ga - sa, gb - sb) + far * std::hypot(sa, sb)
                                      + sa * distance_);
        }
        return best;
    }

    // What slope and second derivatives become on the rim, and what is added to the value.
    //
    // In a disc about c the function (R^2 - |q - c|^2) / (2 R) is not negative, and for any a >= 0
    // so many times it may be added to a function before it is bounded. With a the slope's part
    // along q - c that slope is gone, and a / R is taken from the second derivative: what is left
    // is second order near a maximum on the rim, too.
    double pressed(const Box& box, const bool* out, double* slope, double* bend,
                   std::size_t stage) const {
        const double radius[2] = {from_start_[stage], to_goal_[stage]}, y = box.centre[1];
        const double x[2] = {box.centre[0], box.centre[0] - distance_};
        double far[2], na[2], nb[2], along[2];
        bool use[2];
        for (int i = 0; i < 2; ++i) {
            far[i] = std::sqrt(x[i] * x[i] + y * y);
            // A place in the middle of a disc has no side to speak of.
            use[i] = out[i] && far[i] > radius[i] / 2;
            na[i] = x[i] / std::max(far[i], kTiny);
            nb[i] = y / std::max(far[i], kTiny);
            along[i] = use[i] ? na[i] * slope[0] + nb[i] * slope[1] : 0.0;
        }
        const double cosine = na[0] * na[1] + nb[0] * nb[1], sine2 = 1 - cosine * cosine;
        double push[2] = {(along[0] - cosine * along[1]) / sine2,
                          (along[1] - cosine * along[0]) / sine2};
        // Nearly opposite sides would take pushes far larger than the slope, with its rounding.
        if (!(use[0] && use[1] && push[0] > 0 && push[1] > 0 && sine2 > 1e-2)) {
            const int stronger = along[0] > along[1] ? 0 : 1;
            push[stronger] = positive(along[stronger]);
            push[1 - stronger] = 0.0;
        }
        double extra = 0.0;
        for (int i = 0; i < 2; ++i) {
            const double share = push[i] / radius[i];
            extra += push[i] * (radius[i] - far[i]) * (radius[i] + far[i]) / (2 * radius[i]);
            slope[0] -= share * x[i];
            slope[1] -= share * y;
            bend[0] -= share;
            bend[1] -= share;
        }
        return extra;
    }

    std::size_t count_, stages_, eavesdroppers_;
    double altitude_, distance_, price_, log_gain_;
    bool jams_;
    Array<double> ground_, places_, radii_, log_advantages_, from_start_, to_goal_, corner_, low_,
        high_;
    Array<std::int64_t> stage_;
    Array<double> weight_, shares_, slope_, bend_, tilt_, margin_, powers_;
    std::vector<double> gain_;  // Of the ground node, then of the eavesdroppers.
};

// Write the bounds of functions first..last to `known`.
void maxima(const py::dict& given, std::size_t first, std::size_t last, const py::buffer& known,
            const py::buffer& tolerance, double budget) {
    const Terms terms(given);
    const Array<double> best(known, "known", terms.size());
    const Array<double> tolerances(tolerance, "tolerance", terms.size());
    last = std::min(last, terms.size());
    const py::gil_scoped_release release;
    for (std::size_t k = first; k < last; ++k)
        best[k] = terms.maximum(k, best[k], tolerances[k], budget);
}

// Value, bound and scores of one box, for the tests.
py::tuple box(const py::dict& given, std::size_t function, const py::buffer& centre,
              const py::buffer& half) {
    const Terms terms(given);
    if (function >= terms.size()) throw std::invalid_argument("function");
    const Array<double> middle(centre, "centre", terms.dimensions());
    const Array<double> sides(half, "half", terms.dimensions());
    Box box{};
    for (int i = 0; i < terms.dimensions(); ++i) {
        box.centre[i] = middle[i];
        box.half[i] = sides[i];
    }
    const Worth found = terms.worth(function, box);
    return py::make_tuple(found.value, found.bound);
}

}  // namespace

void add_bound_boxes(py::module_& module) {
    module.def("bound_maxima", &maxima);
    module.def("bound_box", &box);
}
