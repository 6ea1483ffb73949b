// Lemma 5 of bound/proof: the largest value of one UAV's term, by branch and bound.
//
// proof/terms.py says what is bounded and describes the arrays. proof/relaxation.py derives the
// margins.
//
// On a box with centre m a function F is at most F(m) + grad F(m) . dq + K |dq|^2 / 2, where K is
// at least every second derivative in the box; K may be negative. With q = d^2 + H^2 at a distance
// d from a receiver, the eigenvalues of the second derivatives are
//
//     of -log q:                   -2 / q across and 2 (d^2 - H^2) / q^2 along the radius; the
//                                  second is larger,
//     of log q:                    the same with the other sign, at most 2 / q,
//     of -log((d + eps)^2 + H^2):  at most 2 (x^2 - H^2) / (x^2 + H^2)^2, x = d + eps; its kink
//                                  at d = 0 points upwards, so any supergradient serves there.
//
// log([d - eps]+^2 + H^2) needs no such bound: the square of the distance from a disc changes by
// at most its gradient times dq plus |dq|^2, and log(q + x) <= log q + x / q. So 2 / q at the
// centre, with [d - eps]+ for d, serves for K over every box.
//
// A jammer's term is taken in pi = log p, with y = p b(q) and z = log y, so that
// phi' = y / (1 + y) and phi'' = y / (1 + y)^2. The second derivatives of the terms are:
//
//     v phi(z_e):   v phi'' (|dpi| + G |dq|)^2, where G = 2 x / (x^2 + H^2) is the largest slope
//                   of z_e, plus v phi' times the eigenvalue above. phi' is the largest if the
//                   eigenvalue is positive, and otherwise the smallest.
//     -w0 phi(z0):  at most w0 phi'(z0) 2 / q, minus the least w0 phi'' times (dpi + g . dq)^2
//                   with |g| <= G. For any 0 < t <= 1 this square is at least
//                   (1 - t) dpi^2 - (1 / t - 1) G^2 |dq|^2. If t = G rho / width is below 1, it
//                   gives the best bound.
//     -lam e^pi:    at most -lam times the least e^pi.
//
// Every factor is taken at the end of its range over the box where it is largest.
//
// The potential's q . S q / 2 is bounded as it is, and for its |g + S dq| with g = u + S m both
// |g| + g . S dq / |g| + |S dq|^2 / (2 |g|) and |g| + g . S dq / |g| + 2 |S dq| are bounds. Linear
// parts are at most the box's maximum, and the reachable set's (support); on the rim
// `add_disc_multiplier` removes the slope across it. Second order matters: near a maximum inside
// the reachable set, or on its rim, the number of boxes does not grow as they shrink.
//
// All of that but the reachable set's part is linear in the weights w0 and v, which are not
// negative. So the functions of a cell are bounded together: a box has an expansion for each
// weight and a last one without a weight, and every function that needs the box adds them up.
#pragma once

#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>

#include "array.hpp"
#include "numbers.hpp"
#include "reachable_set.hpp"

namespace kernel {

// A function F of the place (a, b) and pi = log p in a box, expanded at the centre: F is at most
// value + ga da + gb db + gp dpi + (ka da^2 + kb db^2 + kp dpi^2) / 2 + rest anywhere in the box.
struct Expansion {
    double value, ga, gb, gp, ka, kb, kp, rest;
};

// The largest value of slope x + curvature x^2 / 2 for low <= x <= high.
inline double max_quadratic(double slope, double curvature, double low, double high) {
    const auto value = [&](double x) { return (slope + curvature * x / 2) * x; };
    if (curvature < 0 && -slope < low * curvature && -slope > high * curvature)
        return slope * slope / (-2 * curvature);
    return std::max(value(low), value(high));
}

// The largest second derivative of -log(x^2 + H^2) for low <= x <= high:
// 2 (x^2 - H^2) / (x^2 + H^2)^2 rises up to x = sqrt(3) H and falls beyond.
inline double max_radial_curvature(double low, double high, double altitude) {
    const double x = std::min(std::max(low, std::sqrt(3.0) * altitude), high), x2 = x * x;
    const double square = altitude * altitude, q = x2 + square;
    return 2 * (x2 - square) / (q * q);
}

// The largest slope 2 x / (x^2 + H^2) of log(x^2 + H^2) for low <= x <= high.
inline double max_gradient(double low, double high, double altitude) {
    const double x = std::min(std::max(altitude, low), high);
    return 2 * x / (x * x + altitude * altitude);
}

// The second derivative of log(1 + e^z) where e^z is y; it is largest at y = 1.
inline double softplus_curvature(double y) { return y / ((1 + y) * (1 + y)); }

// A UAV's links in free space to the ground node and to E eavesdroppers in discs.
struct Links {
    // `altitude` H, `ground` (2), `eavesdroppers` (E, 2) and `radii` (E) are in units, `log_gain`
    // and `log_advantages` (E) in nats. The log SNR at 1 W and a distance d is
    // log_gain - log(d^2 + H^2), plus log_advantages[e] for eavesdropper e.
    Links(double altitude, double log_gain, const py::buffer& ground,
          const py::buffer& eavesdroppers, const py::buffer& radii,
          const py::buffer& log_advantages)
        : count(count_entries(radii)), altitude(altitude), log_gain(log_gain),
          ground(ground, "ground", 2), places(eavesdroppers, "eavesdroppers", 2 * count),
          radii(radii, "radii", count),
          log_advantages(log_advantages, "log_advantages", count) {}

    const std::size_t count;  // E.
    const double altitude, log_gain;
    const Array<const double> ground, places, radii, log_advantages;
};

// Functions of one UAV's place and power over cells of its reachable set; see proof/terms.py.
class Terms {
public:
    // Read the arrays of M functions over C cells; proof/terms.py describes them. `cell` (M),
    // the index of each function's cell, `weight` (M), which is w0, and `v` (M, E) belong to the
    // functions; `slope` (C, 2), `curvature` (C, 3), `speed_cost` (C, 6), `margin` (C) to cells.
    // `powers` is the range of a jammer's log p, absent for functions of the place only.
    Terms(std::shared_ptr<const ReachableSet> region, std::shared_ptr<const Links> links,
          const py::buffer& cell, const py::buffer& weight, const py::buffer& v,
          const py::buffer& slope, const py::buffer& curvature, const py::buffer& speed_cost,
          const py::buffer& margin, double price,
          std::optional<std::pair<double, double>> powers)
        : region_(std::move(region)), links_(std::move(links)), count_(count_entries(weight)),
          eavesdroppers_(links_->count), cell_(cell, "cell", count_),
          weight_(weight, "weight"), v_(v, "v", count_ * eavesdroppers_),
          slope_(slope, "slope", 2 * region_->cells()),
          curvature_(curvature, "curvature", 3 * region_->cells()),
          speed_cost_(speed_cost, "speed_cost", 6 * region_->cells()),
          margin_(margin, "margin", region_->cells()), price_(price), powers_(powers) {
        for (std::size_t k = 0; k < count_; ++k)
            expect(cell_[k] >= 0 && std::size_t(cell_[k]) < region_->cells(), "cell");
    }

    std::size_t size() const { return count_; }
    std::size_t cell(std::size_t k) const { return std::size_t(cell_[k]); }
    std::size_t parts() const { return eavesdroppers_ + 2; }
    int dimensions() const { return powers_ ? 3 : 2; }

    // The weight in function k of expansion `part`: w0 for 0, v_e for 1 + e, 1 for E + 1.
    double factor(std::size_t k, std::size_t part) const {
        return part == 0 ? weight_[k] : part > eavesdroppers_ ? 1.0
                         : v_[k * eavesdroppers_ + part - 1];
    }

    // The box around a cell in the plane and, for a jammer, around the range of log p.
    Box bounding_box(std::size_t cell) const {
        const auto [least, most] = powers_.value_or(std::pair(0.0, 0.0));
        const double low[3] = {region_->low(cell, 0), region_->low(cell, 1), least};
        const double high[3] = {region_->high(cell, 0), region_->high(cell, 1), most};
        Box box{};
        for (int i = 0; i < dimensions(); ++i) {
            box.centre[i] = (low[i] + high[i]) / 2;
            // The centre is rounded to a few eps of the corners, so the box reaches farther.
            box.half[i] = (high[i] - low[i]) / 2 * (1 + BOX_ROUNDING)
                          + 4e-16 * (std::abs(low[i]) + std::abs(high[i]));
        }
        return box;
    }

    // Set the flags of a box, and fill its E + 2 expansions (quadratic upper bounds): of the ground
    // node, of each eavesdropper, and of the terms without a weight.
    void expand(std::size_t cell, Box& box, Expansion* parts) const {
        region_->locate(cell, box);
        const double ha = box.half[0], hb = box.half[1], rho = std::sqrt(ha * ha + hb * hb);
        for (std::size_t part = 0; part < this->parts(); ++part) parts[part] = Expansion{};
        if (powers_) {
            expand_jammer(box, rho, parts);
        } else {
            expand_transmitter(box, rho, parts);
        }
        add_potential(cell, box, rho, parts[eavesdroppers_ + 1]);
    }

    // The expansion of function k in a box: the sum over ground node and eavesdroppers of factor
    // times their expansions, plus the last one, which holds the terms without a factor.
    Expansion sum(std::size_t k, const Expansion* parts) const {
        Expansion f = parts[eavesdroppers_ + 1];
        for (std::size_t part = 0; part <= eavesdroppers_; ++part) {
            const double factor = this->factor(k, part);
            const Expansion& own = parts[part];
            f.value += factor * own.value;
            f.ga += factor * own.ga;
            f.gb += factor * own.gb;
            f.gp += factor * own.gp;
            f.ka += factor * own.ka;
            f.kb += factor * own.kb;
            f.kp += factor * own.kp;
        }
        return f;
    }

    // An upper bound in a box of the function whose expansion is f. The bound by `plane`, over the
    // whole box, is returned if it is at most `enough` or if the box leaves no disc. Otherwise the
    // part in the plane is the least of three bounds: `plane`, `whole` with the linear part bounded
    // over the two discs, and `rim` with multiples of the discs' functions added.
    double bound(std::size_t cell, const Box& box, const Expansion& f, double enough) const {
        const double ha = box.half[0], hb = box.half[1], width = box.half[2];
        const double base =
            f.value + f.rest + (powers_ ? max_quadratic(f.gp, f.kp, -width, width) : 0.0);
        double plane = max_quadratic(f.ga, f.ka, -ha, ha) + max_quadratic(f.gb, f.kb, -hb, hb);
        // A box inside both discs cannot be bounded better by the discs.
        if ((box.leaves_disc[0] || box.leaves_disc[1]) && !(base + plane <= enough)) {
            const double whole = region_->support(f.ga, f.gb, cell)
                - (f.ga * box.centre[0] + f.gb * box.centre[1])
                + (positive_part(f.ka) * ha * ha + positive_part(f.kb) * hb * hb) / 2;
            double g[2] = {f.ga, f.gb}, k[2] = {f.ka, f.kb};
            const double extra = region_->add_disc_multiplier(box, g, k, cell);
            const double rim = extra + max_quadratic(g[0], k[0], -ha, ha)
                + max_quadratic(g[1], k[1], -hb, hb);
            plane = std::min(plane, std::min(whole, rim));
        }
        return base + plane;
    }

private:
    // Fill the transmitter's quadratic upper bounds in a box: parts[0] of the log gain of the link
    // to the ground node, parts[e + 1] of minus the log gain of the link to eavesdropper e. `rho`
    // is half the diagonal of the box.
    void expand_transmitter(const Box& box, double rho, Expansion* parts) const {
        const double square = links_->altitude * links_->altitude;
        const double da = box.centre[0] - links_->ground[0];
        const double db = box.centre[1] - links_->ground[1];
        const double d = std::sqrt(da * da + db * db), q = d * d + square;
        Expansion& f = parts[0];
        f.value = links_->log_gain - std::log(q);
        f.ga = -2 / q * da;
        f.gb = -2 / q * db;
        f.ka = f.kb = max_radial_curvature(positive_part(d - rho), d + rho, links_->altitude);
        for (std::size_t e = 0; e < eavesdroppers_; ++e)
            expand_transmitter_leak(box, e, parts[e + 1]);
    }

    // Fill f, the quadratic upper bound in a box of minus the log gain of the transmitter's link to
    // the nearest place in the disc of eavesdropper e.
    void expand_transmitter_leak(const Box& box, std::size_t e, Expansion& f) const {
        const double square = links_->altitude * links_->altitude;
        const double da = box.centre[0] - links_->places[2 * e];
        const double db = box.centre[1] - links_->places[2 * e + 1];
        const double d = std::sqrt(da * da + db * db), x = positive_part(d - links_->radii[e]);
        const double q = x * x + square, factor = 2 * x / (q * std::max(d, TINY));
        f.value = std::log(q) - (links_->log_gain + links_->log_advantages[e]);
        f.ga = factor * da;
        f.gb = factor * db;
        f.ka = f.kb = 2 / q;
    }

    // Fill a jammer's E + 2 quadratic upper bounds in a box, by its place and pi = log p. They are
    // of -phi(z0) at the ground node, phi(z_e) at every eavesdropper, and -lam p. phi(z) =
    // log(1 + e^z) is what jamming takes from the log SINR of a receiver, with the log z of the
    // jammer's SNR there. lam is the price of power. `rho` is half the box's diagonal in the plane.
    void expand_jammer(const Box& box, double rho, Expansion* parts) const {
        // Powers in the box are from watts / more to watts * more.
        const double watts = std::exp(box.centre[2]), more = std::exp(box.half[2]);
        expand_jammed_ground(box, rho, watts, more, parts[0]);
        for (std::size_t e = 0; e < eavesdroppers_; ++e)
            expand_leak_reduction(box, rho, watts, more, e, parts[e + 1]);
        const double cost = price_ * watts;
        Expansion& power_cost = parts[eavesdroppers_ + 1];
        power_cost.value = power_cost.gp = -cost;
        power_cost.kp = -cost / more;  // -lam times the least power in the box.
    }

    // Fill f, the quadratic upper bound in a box of a jammer's -phi(z0) = -log(1 + y) at the ground
    // node, with the received SNR y = p e^log_gain / q and q = d^2 + H^2; y is in least..top in the
    // box. The power p is `watts` at the centre, and from watts / more to watts * more in the box.
    void expand_jammed_ground(const Box& box, double rho, double watts, double more,
                              Expansion& f) const {
        const double square = links_->altitude * links_->altitude, width = box.half[2];
        const double da = box.centre[0] - links_->ground[0];
        const double db = box.centre[1] - links_->ground[1];
        const double d2 = da * da + db * db, q = d2 + square;
        const double received = std::exp(links_->log_gain) * watts, y = received / q;
        const double phi1 = y / (1 + y);
        f.value = -std::log(1 + y);
        f.ga = 2 * phi1 / q * da;
        f.gb = 2 * phi1 / q * db;
        f.gp = -phi1;
        const double d = std::sqrt(d2), nearest = positive_part(d - rho), farthest = d + rho;
        const double q_min = nearest * nearest + square, q_max = farthest * farthest + square;
        const double top = received * more / q_min, least = received / more / q_max;
        f.ka = top / (1 + top) * 2 / q_min;
        const double grad_max = max_gradient(nearest, farthest, links_->altitude);
        if (grad_max * rho < width) {
            const double phi2_min = std::min(softplus_curvature(top), softplus_curvature(least));
            f.kp = -phi2_min * (1 - grad_max * rho / width);
            f.ka += phi2_min * grad_max * (width / std::max(rho, TINY) - grad_max);
        }
        f.kb = f.ka;
    }

    // Fill f, the quadratic upper bound in a box of phi(z_e) = log(1 + y), by which jamming lowers
    // the log SINR at the farthest place in the disc of eavesdropper e. The jammer's SNR y there is
    // in least..top in the box. The power is `watts` at the centre of the box, and in the box from
    // watts / more to watts * more.
    void expand_leak_reduction(const Box& box, double rho, double watts, double more,
                               std::size_t e, Expansion& f) const {
        const double square = links_->altitude * links_->altitude, width = box.half[2];
        const double received = std::exp(links_->log_gain + links_->log_advantages[e]) * watts;
        const double da = box.centre[0] - links_->places[2 * e];
        const double db = box.centre[1] - links_->places[2 * e + 1];
        const double d = std::sqrt(da * da + db * db), x = d + links_->radii[e];
        const double q = x * x + square, y = received / q, phi1 = y / (1 + y);
        const double factor = -phi1 * 2 * x / (q * std::max(d, TINY));
        f.value = std::log(1 + y);
        f.ga = factor * da;
        f.gb = factor * db;
        f.gp = phi1;
        const double low = positive_part(d - rho) + links_->radii[e], high = x + rho;
        const double top = received * more / (low * low + square);
        const double least = received / more / (high * high + square);
        const double phi2_max = softplus_curvature(std::min(std::max(least, 1.0), top));
        const double grad_max = max_gradient(low, high, links_->altitude);
        // The product 2 G |dpi| |dq| of (|dpi| + G |dq|)^2 is bounded by multiples of |dpi|^2
        // and |dq|^2.
        const double plane = phi2_max * grad_max * (grad_max + width / std::max(rho, TINY));
        const double curvature_max = max_radial_curvature(low, high, links_->altitude);
        const double at = curvature_max > 0 ? top : least;
        f.ka = f.kb = plane + at / (1 + at) * curvature_max;
        f.kp = phi2_max * (1 + grad_max * rho / std::max(width, TINY));
    }

    // Add to `f` the expansion of u . q + q . S q / 2 + t0 |t + T q|, and the margin for rounding.
    // u is the cell's row of `slope_`, S its row of `curvature_`, and (t0, t, T) its row of
    // `speed_cost_`. `rho` is half the diagonal of the box in the plane.
    void add_potential(std::size_t cell, const Box& box, double rho, Expansion& f) const {
        const double a = box.centre[0], b = box.centre[1];
        const double *u = &slope_[2 * cell], *s = &curvature_[3 * cell];
        const double* t = &speed_cost_[6 * cell];
        const double sa = s[0] * a + s[1] * b, sb = s[1] * a + s[2] * b;
        f.value += u[0] * a + u[1] * b + (sa * a + sb * b) / 2;
        f.ga += u[0] + sa;
        f.gb += u[1] + sb;
        f.ka += s[0];
        f.kb += s[2];
        f.rest += margin_[cell] + std::abs(s[1]) * box.half[0] * box.half[1];
        if (t[0] == 0) return;
        const double ta = t[1] + t[3] * a + t[4] * b, tb = t[2] + t[4] * a + t[5] * b;
        const double safe = std::max(std::sqrt(ta * ta + tb * tb), 1e-150);
        f.value += t[0] * safe;
        f.ga += t[0] * (t[3] * ta + t[4] * tb) / safe;
        f.gb += t[0] * (t[4] * ta + t[5] * tb) / safe;
        // The Frobenius norm of T bounds |T dq| / |dq|; the head of this file has both bounds.
        const double norm = std::sqrt(t[3] * t[3] + 2 * t[4] * t[4] + t[5] * t[5]);
        if (norm * rho > 4 * safe) {
            f.rest += 2 * t[0] * norm * rho;
        } else {
            const double more = t[0] * norm * norm / safe;
            f.ka += more;
            f.kb += more;
        }
    }

    std::shared_ptr<const ReachableSet> region_;
    std::shared_ptr<const Links> links_;
    std::size_t count_, eavesdroppers_;
    Array<const std::int64_t> cell_;
    Array<const double> weight_, v_, slope_, curvature_, speed_cost_, margin_;
    double price_;
    std::optional<std::pair<double, double>> powers_;
};

}  // namespace kernel
