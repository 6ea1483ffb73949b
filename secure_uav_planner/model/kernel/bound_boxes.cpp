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
// phi' = y / (1 + y) and phi'' = y / (1 + y)^2. v phi(z_e) adds v phi'' (|dpi| + G |dq|)^2, G being
// the largest gradient of z_e, 2 x / (x^2 + H^2), and v phi' times the eigenvalue above, with the
// largest phi' where that is positive and the smallest where it is not. -w0 phi(z0) adds at most
// w0 phi'(z0) 2 / q and takes away the least w0 phi'' times (dpi + g . dq)^2, |g| <= G, which for
// any 0 < t <= 1 is at least (1 - t) dpi^2 - (1 / t - 1) G^2 |dq|^2: t = G rho / width leaves the
// most, where that is below 1. -lam e^pi adds no more than -lam times its least value. Every factor
// is taken at the end of its range over the box where it is largest.
//
// The potential's q . S q / 2 is bounded as it is, and for its |g + S dq| with g = u + S m both
// |g| + g . S dq / |g| + |S dq|^2 / (2 |g|) and |g| + g . S dq / |g| + 2 |S dq| are bounds. What is
// linear is at most the box's maximum, and the reachable set's (support); on the rim `pressed`
// takes the slope across it away. Second order matters: near a maximum inside the reachable set,
// or on its rim, the number of boxes does not grow as they shrink.
//
// All of that but the reachable set's part is linear in the weights w0 and v, which are not
// negative. So the functions of a stage are searched together: a box has one expansion for each
// weight and one that none multiplies, and every function that still asks for it adds them up.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "array.hpp"
#include "bound_detours.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::expect;
using kernel::size_of;

namespace {

constexpr double kBoxRounding = 1e-14;  // Share by which the halves of a box are widened.
constexpr double kTiny = 1e-300;
constexpr double kHuge = std::numeric_limits<double>::infinity();

// The value and slopes of a function at a box's centre, numbers such that
// ka da^2 + kb db^2 + kp dpi^2 is at least its second derivative along (da, db, dpi) anywhere in the
// box, and what else may be added.
struct Expansion {
    double value, ga, gb, gp, ka, kb, kp, rest;
};

struct Box {
    double centre[3], half[3];
    bool meets, inside;  // The reachable set; whether its centre is in it.
    bool out[2];         // Whether it sticks out of the discs about start and goal.
};

// The largest slope x + bend x^2 / 2 for low <= x <= high.
double largest(double slope, double bend, double low, double high) {
    const auto value = [&](double x) { return (slope + bend * x / 2) * x; };
    if (bend < 0 && -slope < low * bend && -slope > high * bend)
        return slope * slope / (-2 * bend);
    return std::max(value(low), value(high));
}

// The largest second derivative of -log(x^2 + H^2) for low <= x <= high:
// 2 (x^2 - H^2) / (x^2 + H^2)^2 rises up to x = sqrt(3) H and falls beyond.
double radial(double low, double high, double altitude) {
    const double x = std::min(std::max(low, std::sqrt(3.0) * altitude), high), x2 = x * x;
    const double square = altitude * altitude, q = x2 + square;
    return 2 * (x2 - square) / (q * q);
}

// The largest gradient 2 x / (x^2 + H^2) of log(x^2 + H^2) for low <= x <= high.
double steepest(double low, double high, double altitude) {
    const double x = std::min(std::max(altitude, low), high);
    return 2 * x / (x * x + altitude * altitude);
}

// The second derivative of log(1 + e^z) where e^z is y; it is largest at y = 1.
double phi2(double y) { return y / ((1 + y) * (1 + y)); }

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
          high_(given, "high", 2 * stages_), slope_(given, "slope", 2 * stages_),
          bend_(given, "bend", 3 * stages_), tilt_(given, "tilt", 6 * stages_),
          margin_(given, "margin", stages_), stage_(given, "stage", count_),
          weight_(given, "weight", count_), shares_(given, "shares", count_ * eavesdroppers_),
          powers_(given, "powers", 2), detours_(given) {
        for (std::size_t k = 0; k < count_; ++k)
            expect(stage_[k] >= 0 && std::size_t(stage_[k]) < stages_, "stage");
    }

    std::size_t size() const { return count_; }
    std::size_t stage(std::size_t k) const { return std::size_t(stage_[k]); }
    std::size_t parts() const { return eavesdroppers_ + 2; }
    int dimensions() const { return jams_ ? 3 : 2; }

    // What function k multiplies the expansions of a box by.
    double factor(std::size_t k, std::size_t part) const {
        return part == 0 ? weight_[k] : part > eavesdroppers_ ? 1.0
                         : shares_[k * eavesdroppers_ + part - 1];
    }

    // The box that holds the reachable set of a stage and all powers.
    Box whole(std::size_t stage) const {
        const double low[3] = {low_[2 * stage], low_[2 * stage + 1], powers_[0]};
        const double high[3] = {high_[2 * stage], high_[2 * stage + 1], powers_[1]};
        Box box{};
        for (int i = 0; i < dimensions(); ++i) {
            box.centre[i] = (low[i] + high[i]) / 2;
            // The centre is off by a few eps of the corners, so the box reaches farther.
            box.half[i] = (high[i] - low[i]) / 2 * (1 + kBoxRounding)
                          + 4e-16 * (std::abs(low[i]) + std::abs(high[i]));
        }
        return box;
    }

    // Find a box's place in the reachable set, and its expansions: that of the ground node, those
    // of the eavesdroppers, and what does not depend on weights.
    void expand(std::size_t stage, Box& box, Expansion* parts) const {
        box.meets = meets(box, stage);
        box.inside = inside(box.centre, stage);
        box.out[0] = outside(box, 0.0, from_start_[stage]);
        box.out[1] = outside(box, distance_, to_goal_[stage]);
        const double ha = box.half[0], hb = box.half[1], rho = std::sqrt(ha * ha + hb * hb);
        for (std::size_t part = 0; part < this->parts(); ++part) parts[part] = Expansion{};
        if (jams_) {
            jammer(box, rho, parts);
        } else {
            transmitter(box, rho, parts);
        }
        potential(stage, box, rho, parts[eavesdroppers_ + 1]);
    }

    // The expansion of function k in a box.
    Expansion sum(std::size_t k, const Expansion* parts) const {
        Expansion f = parts[eavesdroppers_ + 1];
        for (std::size_t part = 0; part <= eavesdroppers_; ++part) {
            const double factor = this->factor(k, part);
            const Expansion& one = parts[part];
            f.value += factor * one.value;
            f.ga += factor * one.ga;
            f.gb += factor * one.gb;
            f.gp += factor * one.gp;
            f.ka += factor * one.ka;
            f.kb += factor * one.kb;
            f.kp += factor * one.kp;
        }
        return f;
    }

    // The most that function f is in a box, as closely as it takes to see whether that is `enough`.
    double bound(std::size_t stage, const Box& box, const Expansion& f, double enough) const {
        const double ha = box.half[0], hb = box.half[1], width = box.half[2];
        const double base = f.value + f.rest + (jams_ ? largest(f.gp, f.kp, -width, width) : 0.0);
        double plane = largest(f.ga, f.ka, -ha, ha) + largest(f.gb, f.kb, -hb, hb);
        // Inside, the reachable set says no more than the box.
        if ((box.out[0] || box.out[1]) && !(base + plane <= enough)) {
            const double whole = support(f.ga, f.gb, stage)
                - (f.ga * box.centre[0] + f.gb * box.centre[1])
                + (positive(f.ka) * ha * ha + positive(f.kb) * hb * hb) / 2;
            double g[2] = {f.ga, f.gb}, bend[2] = {f.ka, f.kb};
            const double extra = pressed(box, g, bend, stage);
            const double rim = extra + largest(g[0], bend[0], -ha, ha)
                + largest(g[1], bend[1], -hb, hb);
            plane = std::min(plane, std::min(whole, rim));
        }
        return base + plane;
    }

private:
    void transmitter(const Box& box, double rho, Expansion* parts) const {
        const double square = altitude_ * altitude_;
        const double da = box.centre[0] - ground_[0], db = box.centre[1] - ground_[1];
        const double d = std::sqrt(da * da + db * db), q = d * d + square;
        Expansion& f = parts[0];
        f.value = log_gain_ - std::log(q);
        f.ga = -2 / q * da;
        f.gb = -2 / q * db;
        f.ka = f.kb = radial(positive(d - rho), d + rho, altitude_);
        for (std::size_t e = 0; e < eavesdroppers_; ++e) {
            const double ea = box.centre[0] - places_[2 * e];
            const double eb = box.centre[1] - places_[2 * e + 1];
            const double d = std::sqrt(ea * ea + eb * eb), x = positive(d - radii_[e]);
            const double q = x * x + square, factor = 2 * x / (q * std::max(d, kTiny));
            Expansion& f = parts[e + 1];
            f.value = std::log(q) - (log_gain_ + log_advantages_[e]);
            f.ga = factor * ea;
            f.gb = factor * eb;
            f.ka = f.kb = 2 / q;
        }
    }

    void jammer(const Box& box, double rho, Expansion* parts) const {
        const double square = altitude_ * altitude_, width = box.half[2];
        const double watts = std::exp(box.centre[2]), more = std::exp(width);
        const double da = box.centre[0] - ground_[0], db = box.centre[1] - ground_[1];
        const double d2 = da * da + db * db, q = d2 + square;
        const double received = std::exp(log_gain_) * watts, y = received / q, use = y / (1 + y);
        Expansion& f = parts[0];
        f.value = -std::log(1 + y);
        f.ga = 2 * use / q * da;
        f.gb = 2 * use / q * db;
        f.gp = -use;
        const double d = std::sqrt(d2), nearest = positive(d - rho), farthest = d + rho;
        const double near = nearest * nearest + square, far = farthest * farthest + square;
        const double top = received * more / near, least = received / more / far;
        f.ka = top / (1 + top) * 2 / near;
        const double steep = steepest(nearest, farthest, altitude_);
        if (steep * rho < width) {
            const double bent = std::min(phi2(top), phi2(least));
            f.kp = -bent * (1 - steep * rho / width);
            f.ka += bent * steep * (width / std::max(rho, kTiny) - steep);
        }
        f.kb = f.ka;
        for (std::size_t e = 0; e < eavesdroppers_; ++e) {
            const double gain = std::exp(log_gain_ + log_advantages_[e]) * watts;
            const double ea = box.centre[0] - places_[2 * e];
            const double eb = box.centre[1] - places_[2 * e + 1];
            const double d = std::sqrt(ea * ea + eb * eb), x = d + radii_[e];
            const double q = x * x + square, y = gain / q, use = y / (1 + y);
            const double factor = -use * 2 * x / (q * std::max(d, kTiny));
            Expansion& f = parts[e + 1];
            f.value = std::log(1 + y);
            f.ga = factor * ea;
            f.gb = factor * eb;
            f.gp = use;
            const double low = positive(d - rho) + radii_[e], high = x + rho;
            const double top = gain * more / (low * low + square);
            const double least = gain / more / (high * high + square);
            const double twice = phi2(std::min(std::max(least, 1.0), top));
            const double steep = steepest(low, high, altitude_);
            // (|dpi| + G |dq|)^2: the two squares and the product are shared out.
            const double plane = twice * steep * (steep + width / std::max(rho, kTiny));
            const double round = radial(low, high, altitude_);
            const double at = round > 0 ? top : least;
            f.ka = f.kb = plane + at / (1 + at) * round;
            f.kp = twice * (1 + steep * rho / std::max(width, kTiny));
        }
        const double cost = price_ * watts;
        Expansion& paid = parts[eavesdroppers_ + 1];
        paid.value = paid.gp = -cost;
        paid.kp = -cost / more;
    }

    // Add the potential and the margin.
    void potential(std::size_t stage, const Box& box, double rho, Expansion& f) const {
        const double a = box.centre[0], b = box.centre[1];
        const double *u = &slope_[2 * stage], *s = &bend_[3 * stage], *t = &tilt_[6 * stage];
        const double sa = s[0] * a + s[1] * b, sb = s[1] * a + s[2] * b;
        f.value += u[0] * a + u[1] * b + (sa * a + sb * b) / 2;
        f.ga += u[0] + sa;
        f.gb += u[1] + sb;
        f.ka += s[0];
        f.kb += s[2];
        f.rest += margin_[stage] + std::abs(s[1]) * box.half[0] * box.half[1];
        if (t[0] == 0) return;
        const double ta = t[1] + t[3] * a + t[4] * b, tb = t[2] + t[4] * a + t[5] * b;
        const double safe = std::max(std::sqrt(ta * ta + tb * tb), 1e-150);
        f.value += t[0] * safe;
        f.ga += t[0] * (t[3] * ta + t[4] * tb) / safe;
        f.gb += t[0] * (t[4] * ta + t[5] * tb) / safe;
        const double norm = std::sqrt(t[3] * t[3] + 2 * t[4] * t[4] + t[5] * t[5]);
        if (norm * rho > 4 * safe) {
            f.rest += 2 * t[0] * norm * rho;
        } else {
            const double more = t[0] * norm * norm / safe;
            f.ka += more;
            f.kb += more;
        }
    }

    // Whether a box meets both discs.
    bool meets(const Box& box, std::size_t stage) const {
        const auto apart = [](double x, double half) {
            const double far = positive(std::abs(x) - half);
            return far * far;
        };
        const double across = apart(box.centre[1], box.half[1]);
        const double near = from_start_[stage], far = to_goal_[stage];
        double low[2], high[2];
        for (int i = 0; i < 2; ++i) {
            low[i] = box.centre[i] - box.half[i];
            high[i] = box.centre[i] + box.half[i];
        }
        return apart(box.centre[0], box.half[0]) + across <= near * near
               && apart(box.centre[0] - distance_, box.half[0]) + across <= far * far
               && detours_.reaches(low, high, near, far);
    }

    bool inside(const double* place, std::size_t stage) const {
        const double x = place[0], along = x - distance_, across = place[1] * place[1];
        const double near = from_start_[stage], far = to_goal_[stage];
        return x * x + across <= near * near && along * along + across <= far * far
               && detours_.reaches(place, place, near, far);
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
            best = std::min(best, near * std::sqrt((ga - sa) * (ga - sa) + (gb - sb) * (gb - sb))
                                      + far * std::sqrt(sa * sa + sb * sb) + sa * distance_);
        }
        return best;
    }

    // What slope and second derivatives become on the rim, and what is added to the value.
    //
    // In a disc about c the function (R^2 - |q - c|^2) / (2 R) is not negative, and for any a >= 0
    // so many times it may be added to a function before it is bounded. With a the slope's part
    // along q - c that slope is gone, and a / R is taken from the second derivative: what is left
    // is second order near a maximum on the rim, too.
    double pressed(const Box& box, double* slope, double* bend, std::size_t stage) const {
        const double radius[2] = {from_start_[stage], to_goal_[stage]}, y = box.centre[1];
        const double x[2] = {box.centre[0], box.centre[0] - distance_};
        double far[2], na[2], nb[2], along[2];
        bool use[2];
        for (int i = 0; i < 2; ++i) {
            far[i] = std::sqrt(x[i] * x[i] + y * y);
            // A place in the middle of a disc has no side to speak of.
            use[i] = box.out[i] && far[i] > radius[i] / 2;
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
    Array<const double> ground_, places_, radii_, log_advantages_, from_start_, to_goal_, corner_,
        low_, high_, slope_, bend_, tilt_, margin_;
    Array<const std::int64_t> stage_;
    Array<const double> weight_, shares_, powers_;
    kernel::Detours detours_;
};

// The search for the largest values of some functions of one stage, level of boxes by level.
class Search {
public:
    Search(const Terms& terms, std::size_t stage, double budget)
        : terms_(terms), stage_(stage), budget_(budget), parts_(terms.parts()) {}

    // Add function k: its bound will be no more than a value that it reaches, or the known one,
    // and the tolerance, unless the budget ends.
    void add(std::size_t k, double known, double tolerance) {
        asked_.push_back({functions_.size(), kHuge});
        functions_.push_back({k, known + tolerance, tolerance, -kHuge, 0.0});
    }

    // Write upper bounds of the largest values.
    void run(Array<double>& best) {
        std::vector<Node> level{{terms_.whole(stage_), 0, asked_.size()}};
        while (!level.empty()) {
            below_.clear();
            still_.clear();
            for (Node& node : level) visit(node);
            std::swap(level, below_);
            std::swap(asked_, still_);
        }
        for (const Function& one : functions_) best[one.number] = one.found;
    }

private:
    struct Function {
        std::size_t number;
        double enough, tolerance, found, boxes;
    };

    // A function that asks for a box, and its bound over the box that this is a half of.
    struct Item {
        std::size_t function;
        double bound;
    };

    // A box, and which of the items ask for it.
    struct Node {
        Box box;
        std::size_t begin, end;
    };

    // Bound the functions that ask for a box, and cut it for those whose bound is not enough.
    void visit(Node& node) {
        Box& box = node.box;
        terms_.expand(stage_, box, parts_.data());
        if (!box.meets) return;
        const std::size_t begin = still_.size();
        double most = -kHuge;
        Expansion loosest{};
        std::size_t cut = 0;
        for (std::size_t i = node.begin; i < node.end; ++i) {
            Function& one = functions_[asked_[i].function];
            double bound = asked_[i].bound;
            const bool ended = one.boxes++ >= budget_;
            // Written so that a NaN is never dropped.
            if (!(bound <= one.enough) && !(ended && std::isfinite(bound))) {
                const Expansion f = terms_.sum(one.number, parts_.data());
                if (box.inside)
                    one.enough = std::max(one.enough, f.value + one.tolerance);
                bound = terms_.bound(stage_, box, f, one.enough);
                if (!ended && !(bound <= one.enough)) {
                    still_.push_back({asked_[i].function, bound});
                    if (!(bound - one.enough <= most)) {
                        most = bound - one.enough;
                        loosest = f;
                        cut = one.number;
                    }
                    continue;
                }
            }
            one.found = std::isnan(bound) ? bound : std::max(one.found, bound);
        }
        if (still_.size() > begin) halve(box, cut, loosest, begin);
    }

    // Halve a box along the side that makes the bound of function k, f there, largest.
    void halve(const Box& box, std::size_t k, const Expansion& f, std::size_t begin) {
        // Where terms cancel, or a box sticks out of the set, it is their sizes that count.
        double size[3] = {};
        for (std::size_t part = 0; part < terms_.parts(); ++part) {
            const Expansion& one = parts_[part];
            const double factor = terms_.factor(k, part), bends[3] = {one.ka, one.kb, one.kp};
            for (int i = 0; i < 3; ++i) size[i] += factor * std::abs(bends[i]);
        }
        const double slope[3] = {f.ga, f.gb, f.gp};
        int side = 0;
        double most = -1.0;
        for (int i = 0; i < terms_.dimensions(); ++i) {
            const double score = (std::abs(slope[i]) + size[i] * box.half[i] / 2) * box.half[i];
            if (score > most) {
                most = score;
                side = i;
            }
        }
        Node node{box, begin, still_.size()};
        const double width = box.half[side] / 2, middle = box.centre[side];
        // A box twice as small as the spacing of floats is widened to it.
        node.box.half[side] = width * (1 + kBoxRounding) + 2e-16 * std::abs(middle);
        for (const int sign : {-1, 1}) {
            node.box.centre[side] = middle + sign * width;
            below_.push_back(node);
        }
    }

    const Terms& terms_;
    std::size_t stage_;
    double budget_;
    std::vector<Expansion> parts_;
    std::vector<Function> functions_;
    std::vector<Item> asked_, still_;  // Of this level of boxes, and of the next.
    std::vector<Node> below_;
};

// Write the bounds of some functions, all of one stage, to `known`.
void maxima(const py::dict& given, const py::buffer& functions, const py::buffer& known,
            const py::buffer& tolerance, double budget) {
    const Terms terms(given);
    const Array<const std::int64_t> some(functions, "functions");
    Array<double> best(known, "known", terms.size());
    const Array<const double> tolerances(tolerance, "tolerance", terms.size());
    expect(some.size() > 0, "functions");
    for (std::size_t i = 0; i < some.size(); ++i)
        expect(some[i] >= 0 && std::size_t(some[i]) < terms.size()
                   && terms.stage(std::size_t(some[i])) == terms.stage(std::size_t(some[0])),
               "functions");
    const py::gil_scoped_release release;
    Search search(terms, terms.stage(std::size_t(some[0])), budget);
    for (std::size_t i = 0; i < some.size(); ++i) {
        const std::size_t k = std::size_t(some[i]);
        search.add(k, best[k], tolerances[k]);
    }
    search.run(best);
}

// Value at the centre of a box and bound over it, for the tests.
py::tuple box(const py::dict& given, std::size_t function, const py::buffer& centre,
              const py::buffer& half) {
    const Terms terms(given);
    expect(function < terms.size(), "function");
    const Array<const double> middle(centre, "centre", terms.dimensions());
    const Array<const double> sides(half, "half", terms.dimensions());
    Box box{};
    for (int i = 0; i < terms.dimensions(); ++i) {
        box.centre[i] = middle[i];
        box.half[i] = sides[i];
    }
    std::vector<Expansion> parts(terms.parts());
    const std::size_t stage = terms.stage(function);
    terms.expand(stage, box, parts.data());
    const Expansion f = terms.sum(function, parts.data());
    return py::make_tuple(f.value, terms.bound(stage, box, f, -kHuge));
}

}  // namespace

void add_bound_boxes(py::module_& module) {
    module.def("bound_maxima", &maxima);
    module.def("bound_box", &box);
}
