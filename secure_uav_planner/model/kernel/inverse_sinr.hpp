// The inverse SINR of an eavesdropper over its disc, with a local search and proven bounds.
//
// Let S be the transmitter's and J the jammers' received power over the noise power. The leak is
// log2(1 + 1 / v) with v = (1 + J) / S, so the worst place of a disc is where v is least. With the
// gains g_i of the eavesdropper's links and the powers p_i,
//
//     v = 1 / (g_0 p_0) + sum_j p_j / p_0 g_j / g_0.
//
// In free space, with D_i = |x - q_i|^2 + H_i^2, g_j / g_0 is D_0 / D_j = 1 + L_j / D_j times a
// constant, where L_j = D_0 - D_j is affine in x. So UAVs at the same place cancel before anything
// is bounded, and the bounds of a leak that is flat over the disc are tight. With a PathLoss, all
// terms are products of gains, and their derivatives are bounded by way of the gains' logarithms.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "link_gains.hpp"
#include "numbers.hpp"

namespace kernel {

constexpr int RAYS = 6;  // Number of sectors of the first ring, and of starts on a circle.
constexpr double PI = 3.14159265358979323846;
// Relative rounding error, by which bounds are lowered more than rounding can raise them.
//
// A sum of up to 32 positive terms of a few operations each is right to 1e-14 of itself. Places and
// offsets are right to `place_error`, many units in the last place of the longest offset. An error
// of a sector's place widens the ball. An error of a UAV's place changes v by at most the error
// times the slopes of the terms of v. Where terms cancel, as in L_j, in the gradient and in the
// Hessian, the error is a few units in the last place of the sum of their absolute values. The
// numbers `change`, `slopes` and `hessian_error` are larger than this error.
constexpr double ULPS = 1e-14;

// P discs, one for each slot and eavesdropper. Places are relative to the centre of the disc, in m.
// The SNR of a link is the SNR at unit distance and unit power.
struct Discs {
    std::size_t count;                      // P.
    int uavs;                               // U.
    std::vector<double> x, y;               // Places of the UAVs, (U, P).
    std::vector<double> squared_altitudes;  // H^2, (U).
    std::vector<double> noise;              // 1 / (p_0 SNR_0), (P).
    std::vector<double> radius;             // (P).
    std::vector<double> jamming;            // (p_j SNR_j) / (p_0 SNR_0), (U - 1, P).
    std::shared_ptr<const PathLoss> channel;  // Gains for an SNR of 1; null in free space.
};

// A sector of a ring around the centre of a disc: r in [inner, outer], |angle - middle| <= half.
// A whole disc is a sector with half = pi; all smaller ones have half <= pi / 2.
struct Sector {
    std::size_t disc;
    double inner, outer, middle, half;
    double bound;  // A lower bound of v in the sector.

    bool is_whole() const { return half > 1.5707963267948966; }
};

// A place of a disc, relative to its centre.
struct Candidate {
    double inverse_sinr, x, y;
};

// v over one of the Discs at a time, the one selected last; a subclass for each channel.
class DiscProblem {
public:
    explicit DiscProblem(const Discs& discs) : discs_(discs), uavs_(discs.uavs) {
        for (std::vector<double>* numbers : {&x_, &y_, &jamming_}) numbers->resize(uavs_);
    }
    virtual ~DiscProblem() = default;

    // Copy a disc's numbers from Discs; all other methods then refer to this disc. Also find
    // place_error_, the rounding error of a place [m].
    void select(std::size_t disc) {
        double farthest = 0.0;
        for (int u = 0; u < uavs_; ++u) {
            const std::size_t i = u * discs_.count + disc;
            x_[u] = discs_.x[i];
            y_[u] = discs_.y[i];
            farthest = std::max(farthest, x_[u] * x_[u] + y_[u] * y_[u]);
            if (u) jamming_[u] = discs_.jamming[i - discs_.count];
        }
        noise_ = discs_.noise[disc];
        radius_ = discs_.radius[disc];
        place_error_ = ULPS * (radius_ + std::sqrt(farthest));
    }

    // Evaluate the place of the disc that is nearest to the transmitter.
    Candidate evaluate_nearest() const { return evaluate(x_[0], y_[0]); }

    // Return a local minimum of the inverse SINR v in the disc: descend from the best of 14 places.
    // They are the nearest to the transmitter, the centre, 6 at half the radius and 6 on the edge.
    Candidate find_local_minimum() const {
        Candidate best = evaluate_nearest();
        keep_better(best, evaluate(0.0, 0.0));
        for (const double ring : {0.5, 1.0})
            for (int ray = 0; ray < RAYS; ++ray) {
                const double angle = ray * (2.0 * PI / RAYS);
                keep_better(best, evaluate(ring * radius_ * std::cos(angle),
                                           ring * radius_ * std::sin(angle)));
            }
        return descend(best);
    }

    // Return a local minimum of v, by Newton steps from `here` in the disc, and on its edge where
    // v falls outwards. Steps go downhill also where v is not convex. The longest step is half the
    // radius at first, doubles after a better step, and falls to a quarter after any other step.
    Candidate descend(Candidate here) const {
        double longest = 0.5 * radius_;
        if (!(radius_ > POINT)) return here;
        for (int step = 0; step < MOST_STEPS; ++step) {
            const Candidate next = take_newton_step(here, longest);
            const double gain = here.inverse_sinr - next.inverse_sinr;
            const bool better = next.inverse_sinr < here.inverse_sinr;
            // Newton's method squares the relative gain at each step: 1e-14 follows 1e-7.
            const bool stop = better ? !(gain > 1e-7 * here.inverse_sinr)
                                     : !(0.25 * longest > 1e-4 * radius_);
            keep_better(here, next);
            longest *= better ? 2.0 : 0.25;
            if (stop) break;
        }
        return here;
    }

    // Return a lower bound of v = 1 / SINR in a sector. Set `candidate` to the sector's middle, the
    // centre for a whole disc, and v there.
    //
    // The bound is the larger of two. Both hold in the smallest ball around the candidate that
    // contains the sector. `ball_bound`, by expand, takes every distance alone at its smallest or
    // largest; it needs only gains that fall with the distance. `quadratic`, by bound_change, is
    // the least value of a quadratic below v: Taylor's quadratic with its Hessian lowered by the
    // largest change that the third derivative allows. Its error shrinks with the square of the
    // sector's size, also near a maximum of the leak on the disc's edge, or a flat maximum.
    double bound_sector(const Sector& sector, Candidate& candidate) {
        const double cosine = std::cos(sector.middle), sine = std::sin(sector.middle);
        const double radius = sector.is_whole() ? 0.0 : 0.5 * (sector.inner + sector.outer);
        const double sine2 = std::pow(std::sin(0.5 * sector.half), 2);
        const double width = sector.outer - radius;
        // The ball's radius is the distance to an outer corner of the sector.
        const double ball = std::sqrt(width * width + 4.0 * sector.outer * radius * sine2)
            * (1.0 + ULPS) + place_error_;
        candidate.x = radius * cosine;
        candidate.y = radius * sine;
        const Expansion v = expand(candidate.x, candidate.y, ball);
        candidate.inverse_sinr = v.at.value;
        const double change = bound_change(
            v.at, sector, radius, sine2, cosine, sine, ball, v.hessian_error);
        const double quadratic = v.at.value * (1.0 - ULPS) + change - v.rounding;
        return quadratic > v.ball_bound ? quadratic : v.ball_bound;
    }

protected:
    // v at a place, its gradient and its Hessian.
    struct Derivatives {
        double value, x, y, xx, xy, yy;
    };

    // Lower bounds of v in a ball around a place: `ball_bound`, and Taylor's quadratic with its
    // Hessian's eigenvalues lowered by `hessian_error`, minus `rounding`.
    struct Expansion {
        Derivatives at;
        double ball_bound;
        double hessian_error;
        double rounding;
    };

    static double square(double number) { return number * number; }

    // Return v at a place.
    virtual double inverse_sinr(double x, double y) const = 0;
    // Return v at a place, with its gradient and its Hessian.
    virtual Derivatives differentiate(double x, double y) const = 0;
    // Bound v in the ball of radius `ball` around a place; see Expansion.
    virtual Expansion expand(double x, double y, double ball) const = 0;

    const Discs& discs_;
    const int uavs_;
    // Numbers of the selected disc, as in Discs; `place_error_` is the rounding error of a place.
    double noise_ = 0.0, radius_ = 0.0, place_error_ = 0.0;
    std::vector<double> x_, y_, jamming_;

private:
    static constexpr int MOST_STEPS = 30;   // Largest number of steps of a descent; mostly it is 5.
    static constexpr double POINT = 1e-12;  // Radius [m] up to which a disc is a single place.

    static void keep_better(Candidate& best, const Candidate& candidate) {
        if (candidate.inverse_sinr < best.inverse_sinr) best = candidate;
    }

    // Return the place of the disc nearest to (x, y), and v there. (0, 0) is the disc's centre.
    Candidate evaluate(double x, double y) const {
        const double scale = std::min(1.0, radius_ / std::max(std::hypot(x, y), TINY));
        x *= scale;
        y *= scale;
        return {inverse_sinr(x, y), x, y};
    }

    // Return the place after a Newton step towards the least v = 1 / SINR, kept in the disc, and v
    // there. Along each axis the step is -slope / |curvature|, so downhill, and at most `longest`.
    Candidate take_newton_step(const Candidate& here, double longest) const {
        double x = here.x, y = here.y;
        const Derivatives v = differentiate(x, y);
        const double radial = (v.x * x + v.y * y) / radius_;
        // The axes are the eigenvectors of the Hessian. If v falls outwards on the disc's edge, the
        // only axis is the tangent, and radial / radius is subtracted for the circle's curvature.
        const bool edge = std::hypot(x, y) >= (1.0 - 1e-9) * radius_ && radial < 0.0;
        const double angle =
            edge ? std::atan2(x, -y) : 0.5 * std::atan2(2.0 * v.xy, v.xx - v.yy);
        const double cosine = std::cos(angle), sine = std::sin(angle);
        const auto move_along = [&](double dx, double dy, double edge_curvature) {
            const double slope = v.x * dx + v.y * dy;
            const double curvature = dx * dx * v.xx + 2.0 * dx * dy * v.xy + dy * dy * v.yy
                - edge_curvature;
            const double step = -slope
                / std::max({std::fabs(curvature), std::fabs(slope) / longest, TINY});
            x += step * dx;
            y += step * dy;
        };
        move_along(cosine, sine, edge ? radial / radius_ : 0.0);
        if (!edge) move_along(-sine, cosine, 0.0);
        return evaluate(x, y);
    }

    // Find a lower bound of the change of a quadratic over a sector, from the sector's candidate
    // place at `radius` on its middle ray. The quadratic is a Taylor polynomial at this place: it
    // has the gradient of `v`, and the Hessian of `v` minus `hessian_error` times the identity.
    // The bound is the larger of two: over the square around the ball of radius `ball`, along the
    // Hessian's eigenvectors; and over the sector with its curved edges, by the Hessian's least
    // eigenvalue. `cosine` and `sine` are of the middle ray; `sine2` is sin(half / 2)^2.
    static double bound_change(const Derivatives& v, const Sector& sector, double radius,
                               double sine2, double cosine, double sine, double ball,
                               double hessian_error) {
        const double mean = 0.5 * (v.xx + v.yy), half = 0.5 * (v.xx - v.yy);
        const double spread = std::hypot(half, v.xy);
        const double angle = 0.5 * std::atan2(v.xy, half);
        const double axis_cosine = std::cos(angle), axis_sine = std::sin(angle);
        double on_square = 0.0;
        const auto add_axis = [&](double dx, double dy, double curvature) {
            const double slope = std::fabs(v.x * dx + v.y * dy);
            const double step = slope < curvature * ball ? slope / curvature : ball;
            on_square += step * (0.5 * curvature * step - slope);
        };
        add_axis(axis_cosine, axis_sine, mean + spread - hessian_error);
        add_axis(-axis_sine, axis_cosine, mean - spread - hessian_error);

        // The quadratic changes at (r, middle + t) by a term that depends on r only, and by
        // r (along (cos t - 1) + across sin t). Over t the second term is least in the direction of
        // steepest descent if this lies within the sector's angle, and otherwise at an end. Over r
        // the sum is concave, so it is least on one of the sector's two arcs.
        const double concave = std::max(hessian_error + spread - mean, 0.0);
        const double outwards = v.x * cosine + v.y * sine;
        const double along = outwards + concave * radius;
        const double across = std::fabs(v.y * cosine - v.x * sine);
        const double steepest = std::hypot(along, across);
        const double sine_half = std::sin(sector.half);
        double on_angle = -2.0 * along * sine2 - across * sine_half;
        if (sector.is_whole() || across * std::cos(sector.half) <= -along * sine_half)
            on_angle = along < 0.0
                ? -across * (across / std::max(steepest + std::fabs(along), TINY))
                : -along - steepest;
        double on_arcs = INFINITE;
        for (const double edge : {sector.inner, sector.outer}) {
            const double step = edge - radius;
            on_arcs = std::min(
                on_arcs, step * (outwards - 0.5 * concave * step) + edge * on_angle);
        }
        return std::max(on_square, on_arcs);
    }
};

// v in free space: D_0 (noise + sum of jamming_j / D_j).
class FreeSpaceProblem final : public DiscProblem {
public:
    explicit FreeSpaceProblem(const Discs& discs) : DiscProblem(discs) {
        for (std::vector<double>* numbers : {&dx_, &dy_, &distance_, &loss_})
            numbers->resize(uavs_);
    }

protected:
    // Return v = D_0 (noise + sum_j jamming_j / D_j), with D_u = d_u^2 + H_u^2 of UAV u, noise =
    // 1 / (p_0 SNR_0) and jamming_j = p_j SNR_j / (p_0 SNR_0). UAV 0 transmits.
    double inverse_sinr(double x, double y) const override {
        const auto loss_at = [&](int u) { return loss(square(x - x_[u]) + square(y - y_[u]), u); };
        double sum = noise_;
        for (int j = 1; j < uavs_; ++j) sum += jamming_[j] / loss_at(j);
        return loss_at(0) * sum;
    }

    Derivatives differentiate(double x, double y) const override {
        move_to(x, y);
        return differentiate_here();
    }

    // Return v with derivatives at (x, y), and lower bounds of v in a ball of radius `ball` around
    // it: a constant, ball_bound, and Taylor's quadratic with its Hessian's eigenvalues lowered by
    // hessian_error, minus rounding. v = noise D_0 + sum_j jamming_j (1 + L_j / D_j) is bounded
    // term by term, D_j = d_j^2 + H_j^2 of UAV j and L_j = D_0 - D_j, which is affine in the place.
    // `magnitude` is the sum of the terms' sizes and `slopes` half the sum of their slopes' sizes;
    // rounding errors are a small fraction of either.
    Expansion expand(double x, double y, double ball) const override {
        const std::vector<double>& altitudes = discs_.squared_altitudes;
        move_to(x, y);
        for (int u = 0; u < uavs_; ++u)
            distance_[u] = std::sqrt(dx_[u] * dx_[u] + dy_[u] * dy_[u]);
        const double least_loss = loss(square(std::max(distance_[0] - ball, 0.0)), 0);
        double ball_bound = noise_ * least_loss, third = 0.0;
        double magnitude = noise_, weights = noise_, slopes = 0.0;
        for (int j = 1; j < uavs_; ++j) {
            const double near = loss(square(std::max(distance_[j] - ball, 0.0)), j);
            const double far = loss(square(distance_[j] + ball), j);
            // `way` is |q_0 - q_j|, `difference` L_j, and `change` the most by which L_j changes.
            const double way_x = x_[j] - x_[0], way_y = y_[j] - y_[0];
            const double way = std::sqrt(way_x * way_x + way_y * way_y) + place_error_;
            const double change =
                2.0 * way * (ball + ULPS * (distance_[0] + distance_[j]));
            const double difference = way_x * (dx_[0] + dx_[j]) + way_y * (dy_[0] + dy_[j])
                + (altitudes[0] - altitudes[j]);
            const double lowest = difference - change;
            ball_bound += jamming_[j]
                * std::max(least_loss / far, 1.0 + lowest / (lowest > 0.0 ? far : near));
            // `third` bounds v''' along any line: |(1 / D)''| <= 6 / D^2, |(1 / D)'''| <= 24 /
            // D^(5/2), and L_j is affine.
            third += jamming_[j] / (near * near)
                * (24.0 * (std::fabs(difference) + change) / std::sqrt(near) + 36.0 * way);
            const double weight = jamming_[j] / loss_[j], ratio = loss_[0] / loss_[j];
            magnitude += weight * (1.0 + ratio);
            weights += weight;
            slopes += weight * ratio * distance_[j];
        }
        ball_bound *= 1.0 - ULPS;
        slopes += weights * distance_[0];
        return {differentiate_here(), ball_bound, third * ball / 3.0 + ULPS * magnitude,
                2.0 * slopes * (place_error_ + ULPS * ball)};
    }

private:
    // D = d^2 + H^2 of a UAV, from the squared distance d^2.
    double loss(double squared, int u) const {
        return FreeSpace::loss(squared, discs_.squared_altitudes[u]);
    }

    // Set for a place the offsets (dx_, dy_) from each UAV, and loss_, D = dx^2 + dy^2 + H^2.
    void move_to(double x, double y) const {
        for (int u = 0; u < uavs_; ++u) {
            dx_[u] = x - x_[u];
            dy_[u] = y - y_[u];
            loss_[u] = loss(dx_[u] * dx_[u] + dy_[u] * dy_[u], u);
        }
    }

    // Return v = D_0 (noise + sum_j jamming_j / D_j) with gradient and Hessian, at the place of the
    // last move_to. D_j is loss[j], and (dx[j], dy[j]) the place minus UAV j's position q_j. The
    // Hessian is 2 isotropic I - 2 sum_j (along shift^T + shift along^T).
    Derivatives differentiate_here() const {
        const double *dx = dx_.data(), *dy = dy_.data(), *loss = loss_.data();
        double sum = noise_, isotropic = noise_, slope_x = 0.0, slope_y = 0.0;
        double xx = 0.0, xy = 0.0, yy = 0.0;
        for (int j = 1; j < uavs_; ++j) {
            const double weight = jamming_[j] / loss[j], ratio = loss[0] / loss[j];
            // Half the gradient of D_0 / D_j is (x - q_0 - (D_0 / D_j) (x - q_j)) / D_j.
            const double along_x = weight * (dx[0] - ratio * dx[j]);
            const double along_y = weight * (dy[0] - ratio * dy[j]);
            const double shift_x = 2.0 * dx[j] / loss[j], shift_y = 2.0 * dy[j] / loss[j];
            sum += weight;
            isotropic += weight * (1.0 - ratio);
            slope_x += along_x;
            slope_y += along_y;
            xx += along_x * shift_x;
            xy += along_x * shift_y + along_y * shift_x;
            yy += along_y * shift_y;
        }
        return {loss[0] * sum, 2.0 * (noise_ * dx[0] + slope_x), 2.0 * (noise_ * dy[0] + slope_y),
                2.0 * (isotropic - 2.0 * xx), -2.0 * xy, 2.0 * (isotropic - 2.0 * yy)};
    }

    // Offsets and distances of the place of the last move_to from each UAV, and D.
    mutable std::vector<double> dx_, dy_, distance_, loss_;
};

// v with a PathLoss. A term g_j / g_0 is differentiated by way of log g_j - log g_0.
class PathLossProblem final : public DiscProblem {
public:
    explicit PathLossProblem(const Discs& discs) : DiscProblem(discs), channel_(*discs.channel) {}

protected:
    // Return v = (noise + sum_j jamming_j g_j) / g_0, with the gains g at an SNR of 1. The SNRs are
    // in noise = 1 / (p_0 SNR_0) and jamming_j = p_j SNR_j / (p_0 SNR_0).
    double inverse_sinr(double x, double y) const override {
        const auto gain = [&](int u) {
            return channel_.gain(u, square(x - x_[u]) + square(y - y_[u]));
        };
        double sum = noise_;
        for (int j = 1; j < uavs_; ++j) sum += jamming_[j] * gain(j);
        return sum / gain(0);
    }

    // Return v = noise / g_0 + sum_j jamming_j g_j / g_0 with its gradient and Hessian, where noise
    // = 1 / (p_0 SNR_0), jamming_j = p_j SNR_j / (p_0 SNR_0) and the gains g are at an SNR of 1.
    Derivatives differentiate(double x, double y) const override {
        Derivatives sum{};
        const LogGain transmitter = log_gain(x, y, 0);
        add(sum, noise_, subtract(UNITY, transmitter));
        for (int j = 1; j < uavs_; ++j)
            add(sum, jamming_[j], subtract(log_gain(x, y, j), transmitter));
        return sum;
    }

    // Return v with derivatives at (x, y), and lower bounds of v in a ball of radius `ball` around
    // it: a constant, ball_bound, and Taylor's quadratic with its Hessian's eigenvalues lowered by
    // hessian_error, minus `rounding`. v = noise / g_0 + sum_j jamming_j g_j / g_0 is bounded term
    // by term, with noise = 1 / (p_0 SNR_0), jamming_j = p_j SNR_j / (p_0 SNR_0) and the gains g at
    // an SNR of 1. With bounds b_i of the derivatives of l = log g_j - log g_0, second and third
    // derivatives of a term w e^l are at most w e^l times b_2 + b_1^2 and b_3 + 3 b_1 b_2 + b_1^3.
    Expansion expand(double x, double y, double ball) const override {
        const LogGain transmitter = log_gain(x, y, 0);
        const Range denominator = find_range(0, transmitter, ball);
        Expansion v{};
        double third = 0.0, second = 0.0, magnitude = 0.0;
        for (int u = 0; u < uavs_; ++u) {
            const double weight = u ? jamming_[u] : noise_;
            const LogGain numerator = u ? log_gain(x, y, u) : UNITY;
            const LogGain ratio = subtract(numerator, transmitter);
            Range range{1.0, 1.0, {}};
            if (u) range = find_range(u, numerator, ball);
            const double second_bound = range.bounds.second + denominator.bounds.second;
            const double third_bound = range.bounds.third + denominator.bounds.third;
            double slope = range.bounds.first + denominator.bounds.first;
            // If UAVs are close together, most of the slope cancels, and the second bound is less.
            slope = std::min(
                slope, std::hypot(ratio.x, ratio.y) + ball * second_bound + GAIN_ULPS * slope);
            const double second_factor = second_bound + slope * slope;
            const double third_factor = third_bound + 3.0 * slope * second_bound
                + slope * slope * slope;
            v.ball_bound += weight
                * std::max(range.least / denominator.most, ratio.gain * std::exp(-ball * slope));
            const double most = weight * range.most / denominator.least;
            third += most * third_factor;
            second += most * second_factor;
            magnitude += most * (slope + ball * (second_factor + ball * third_factor));
            add(v.at, weight, ratio);
        }
        v.ball_bound *= 1.0 - GAIN_ULPS;
        v.hessian_error = third * ball / 3.0 + GAIN_ULPS * second;
        v.rounding = GAIN_ULPS * v.at.value
            + 4.0 * magnitude * (place_error_ + GAIN_ULPS * ball);
        if (!(v.hessian_error < INFINITE)) {  // Only ball_bound is valid over a kink.
            v.hessian_error = 0.0;
            v.rounding = INFINITE;
        }
        return v;
    }

private:
    // A bound of the relative rounding error of a gain, with its powers and exponentials.
    static constexpr double GAIN_ULPS = 1e-12;

    // A gain at a distance, with the gradient and the Hessian of the gain's logarithm.
    struct LogGain {
        double gain, x, y, xx, xy, yy, distance;
    };
    static constexpr LogGain UNITY{1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};

    // Bounds, in a ball, of a gain and of the derivatives of the gain's logarithm.
    struct Range {
        double least, most;
        PathLoss::LogBounds bounds;
    };

    // Return bounds of UAV u's gain g within `ball` [m] of at's place, and of log g's derivatives.
    Range find_range(int u, const LogGain& at, double ball) const {
        const double near = std::max(at.distance - ball, 0.0), far = at.distance + ball;
        return {channel_.gain(u, far * far), channel_.gain(u, near * near),
                channel_.bound_log_gain(u, near, far)};
    }

    // Return UAV u's gain g at a place, and of log g = l(d^2) the gradient 2 l' (dx, dy) and the
    // Hessian 2 l' I + 4 l'' (dx, dy) (dx, dy)^T; last the horizontal distance d.
    LogGain log_gain(double x, double y, int u) const {
        const double dx = x - x_[u], dy = y - y_[u], squared = dx * dx + dy * dy;
        const Gain gain = channel_.derivatives(u, squared);
        const double slope = gain.first / gain.value;
        const double curvature = 4.0 * (gain.second / gain.value - slope * slope);
        return {gain.value, 2.0 * slope * dx, 2.0 * slope * dy,
                2.0 * slope + curvature * dx * dx, curvature * dx * dy,
                2.0 * slope + curvature * dy * dy, std::sqrt(squared)};
    }

    // Return the ratio a / b of two gains, with the derivatives of log a - log b.
    static LogGain subtract(const LogGain& a, const LogGain& b) {
        return {a.gain / b.gain, a.x - b.x, a.y - b.y, a.xx - b.xx, a.xy - b.xy, a.yy - b.yy, 0.0};
    }

    // Add weight * g to a sum, with its gradient g l' and Hessian g (l' l'^T + l''). Of l = log g,
    // g.x and g.y are the gradient l' and g.xx, g.xy and g.yy the Hessian l''.
    static void add(Derivatives& sum, double weight, const LogGain& g) {
        const double term = weight * g.gain;
        sum.value += term;
        sum.x += term * g.x;
        sum.y += term * g.y;
        sum.xx += term * (g.x * g.x + g.xx);
        sum.xy += term * (g.x * g.y + g.xy);
        sum.yy += term * (g.y * g.y + g.yy);
    }

    const PathLoss& channel_;
};

inline std::unique_ptr<DiscProblem> make_disc_problem(const Discs& discs) {
    if (discs.channel) return std::make_unique<PathLossProblem>(discs);
    return std::make_unique<FreeSpaceProblem>(discs);
}

}  // namespace kernel
