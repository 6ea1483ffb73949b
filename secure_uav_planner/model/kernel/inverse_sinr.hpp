// The inverse SINR of an eavesdropper over its disc, with a local search and proven bounds.
//
// With the transmitter's S and the jammers' J over the noise power, v = (1 + J) / S decides the
// leak log2(1 + 1 / v): the worst place of a disc is where v is least. With the gains g_i of its
// links,
//
//     v = 1 / (g_0 p_0) + sum_j p_j / p_0 g_j / g_0.
//
// In free space, with D_i = |x - q_i|^2 + H_i^2, g_j / g_0 is D_0 / D_j = 1 + L_j / D_j times a
// constant, where L_j = D_0 - D_j is affine in x. UAVs at the same place so cancel before anything
// is bounded, and a leak that is flat over the disc is seen to be flat. With a PathLoss, all terms
// are products of gains, whose derivatives are bounded by those of their logarithms.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "link_gains.hpp"
#include "numbers.hpp"

namespace kernel {

constexpr int RAYS = 6;  // Sectors of the first ring, and starts of a search on a circle.
constexpr double PI = 3.14159265358979323846;
// Rounding. A sum of up to 32 positive terms of a few operations each is right to 1e-14 of itself.
// Places and offsets are right to `place_error`, many units in the last place of the longest
// offset. For places of a sector that widens the ball; for places of UAVs it changes v by no more
// than the slopes of its terms allow. Where terms cancel, as in L_j, in the gradient and in the
// Hessian, the error is a few units in the last place of their absolute values added up: `change`,
// `slopes` and `hessian_error` hold more than that. In sum, a bound is lowered by more than
// rounding can raise it.
constexpr double ULPS = 1e-14;

// A disc for each slot and eavesdropper, P of them; places are relative to its centre, in m.
struct Discs {
    std::size_t count;
    int uavs;
    std::vector<double> x, y;               // Of the UAVs, (U, P).
    std::vector<double> squared_altitudes;  // H^2, (U).
    std::vector<double> noise;              // 1 / p_0, divided by the SNR at unit distance, (P).
    std::vector<double> radius;             // (P).
    std::vector<double> jamming;            // p_j / p_0, times the ratio of those, (U - 1, P).
    std::shared_ptr<const PathLoss> channel;  // With an SNR of 1, or null in free space.
};

// A sector of a ring around the centre of a disc: r in [inner, outer], |angle - middle| <= half.
// A whole disc is a sector with half = pi; all smaller ones have half <= pi / 2.
struct Sector {
    std::size_t disc;
    double inner, outer, middle, half;
    double bound;  // v is not below it here.

    bool is_whole() const { return half > 1.5707963267948966; }
};

// A place of a disc, relative to its centre.
struct Candidate {
    double inverse_sinr, x, y;
};

// One of the Discs at a time, for any channel.
class DiscProblem {
public:
    explicit DiscProblem(const Discs& discs) : discs_(discs), uavs_(discs.uavs) {
        for (std::vector<double>* numbers : {&x_, &y_, &jamming_}) numbers->resize(uavs_);
    }
    virtual ~DiscProblem() = default;

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

    Candidate evaluate_nearest() const { return evaluate(x_[0], y_[0]); }

    // Descend from the best of the place nearest to the transmitter, the centre, six places on a
    // circle half as wide and six on the edge.
    Candidate find_local_minimum() const {
        Candidate best = evaluate_nearest();
        keep_better(best, evaluate(0.0, 0.0));
        for (const double share : {0.5, 1.0})
            for (int ray = 0; ray < RAYS; ++ray) {
                const double angle = ray * (2.0 * PI / RAYS);
                keep_better(best, evaluate(share * radius_ * std::cos(angle),
                                           share * radius_ * std::sin(angle)));
            }
        return descend(best);
    }

    // Take Newton steps in the disc, and along its edge where v falls outwards. Their length is
    // limited, and they go downhill also where v is not convex.
    Candidate descend(Candidate here) const {
        double longest = 0.5 * radius_;
        if (!(radius_ > POINT)) return here;
        for (int step = 0; step < MOST_STEPS; ++step) {
            const Candidate next = take_newton_step(here, longest);
            const double gain = here.inverse_sinr - next.inverse_sinr;
            const bool better = next.inverse_sinr < here.inverse_sinr;
            // Newton's next gain is of the order of the square of this one.
            const bool stop = better ? !(gain > 1e-7 * here.inverse_sinr)
                                     : !(0.25 * longest > 1e-4 * radius_);
            keep_better(here, next);
            longest *= better ? 2.0 : 0.25;
            if (stop) break;
        }
        return here;
    }

    // Find a lower bound of v in a sector, and a candidate in it.
    //
    // The bound is the largest of three, all for the smallest ball around the candidate that holds
    // the sector. The first takes every distance by itself at its smallest or largest, and only
    // needs gains that fall with the distance. The others minimise a quadratic below v, Taylor's
    // with its Hessian lowered by what the third derivative can change: over the sector with its
    // curved edges, by the Hessian's least eigenvalue alone, and over the square around the ball
    // along the eigenvectors. So the part left to divide shrinks with the square of the sectors'
    // size, both near a maximum of the leak on the edge of the disc and near one inside, even if
    // it is flat in a direction.
    double bound_sector(const Sector& sector, Candidate& candidate) {
        const double cosine = std::cos(sector.middle), sine = std::sin(sector.middle);
        const double radius = sector.is_whole() ? 0.0 : 0.5 * (sector.inner + sector.outer);
        const double sine2 = std::pow(std::sin(0.5 * sector.half), 2);
        const double width = sector.outer - radius;
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

    // v around a place.
    struct Expansion {
        Derivatives at;
        double ball_bound;     // v is not below it in the ball around the place,
        double hessian_error;  // nor below Taylor's quadratic with a Hessian lowered by this,
        double rounding;       // less this.
    };

    static double square(double number) { return number * number; }

    virtual double inverse_sinr(double x, double y) const = 0;
    virtual Derivatives differentiate(double x, double y) const = 0;
    virtual Expansion expand(double x, double y, double ball) const = 0;

    const Discs& discs_;
    const int uavs_;
    double noise_ = 0.0, radius_ = 0.0, place_error_ = 0.0;  // Of the disc.
    std::vector<double> x_, y_, jamming_;                    // Likewise.

private:
    static constexpr int MOST_STEPS = 30;    // Of a search, which mostly ends after 5.
    static constexpr double POINT = 1e-12;  // Radius in m up to which a disc is a single place.

    static void keep_better(Candidate& best, const Candidate& candidate) {
        if (candidate.inverse_sinr < best.inverse_sinr) best = candidate;
    }

    // Evaluate the place of the disc that is nearest to (x, y).
    Candidate evaluate(double x, double y) const {
        const double share = std::min(1.0, radius_ / std::max(std::hypot(x, y), TINY));
        x *= share;
        y *= share;
        return {inverse_sinr(x, y), x, y};
    }

    Candidate take_newton_step(const Candidate& here, double longest) const {
        double x = here.x, y = here.y;
        const Derivatives v = differentiate(x, y);
        const double radial = (v.x * x + v.y * y) / radius_;
        // Along the eigenvectors of the Hessian, or along the edge, whose curvature counts too.
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

    // Find a lower bound, over a sector, of the quadratic less its value at the place.
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

        // On the arc at r, at (r, middle + t), the quadratic changes by a term of r, and by
        // r (along (cos t - 1) + across sin t). This is least where its steepest descent points,
        // if that is within the angle, or else at an end; over r the whole is concave, and so
        // least on one of the two arcs.
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

class FreeSpaceProblem final : public DiscProblem {
public:
    explicit FreeSpaceProblem(const Discs& discs) : DiscProblem(discs) {
        for (std::vector<double>* numbers : {&dx_, &dy_, &distance_, &loss_})
            numbers->resize(uavs_);
    }

protected:
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

    Expansion expand(double x, double y, double ball) const override {
        const std::vector<double>& altitudes = discs_.squared_altitudes;
        move_to(x, y);
        for (int u = 0; u < uavs_; ++u)
            distance_[u] = std::sqrt(dx_[u] * dx_[u] + dy_[u] * dy_[u]);
        const double best = loss(square(std::max(distance_[0] - ball, 0.0)), 0);
        double ball_bound = noise_ * best, third = 0.0;
        double magnitude = noise_, weights = noise_, slopes = 0.0;
        for (int j = 1; j < uavs_; ++j) {
            const double near = loss(square(std::max(distance_[j] - ball, 0.0)), j);
            const double far = loss(square(distance_[j] + ball), j);
            // From q_0 to q_j, and L_j with how much it changes in the ball.
            const double way_x = x_[j] - x_[0], way_y = y_[j] - y_[0];
            const double way = std::sqrt(way_x * way_x + way_y * way_y) + place_error_;
            const double change =
                2.0 * way * (ball + ULPS * (distance_[0] + distance_[j]));
            const double difference = way_x * (dx_[0] + dx_[j]) + way_y * (dy_[0] + dy_[j])
                + (altitudes[0] - altitudes[j]);
            const double lowest = difference - change;
            ball_bound += jamming_[j]
                * std::max(best / far, 1.0 + lowest / (lowest > 0.0 ? far : near));
            // Along a line, |(1 / D)''| <= 6 / D^2, |(1 / D)'''| <= 24 / D^(5/2); L_j is affine.
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
    // D of a UAV, at a squared distance.
    double loss(double squared, int u) const {
        return FreeSpace::loss(squared, discs_.squared_altitudes[u]);
    }

    void move_to(double x, double y) const {
        for (int u = 0; u < uavs_; ++u) {
            dx_[u] = x - x_[u];
            dy_[u] = y - y_[u];
            loss_[u] = loss(dx_[u] * dx_[u] + dy_[u] * dy_[u], u);
        }
    }

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

    mutable std::vector<double> dx_, dy_, distance_, loss_;  // Of the place moved to.
};

// With a PathLoss. The derivatives of a term g_j / g_0 are its products with those of the
// difference of log g_j and log g_0.
class PathLossProblem final : public DiscProblem {
public:
    explicit PathLossProblem(const Discs& discs) : DiscProblem(discs), channel_(*discs.channel) {}

protected:
    double inverse_sinr(double x, double y) const override {
        const auto gain = [&](int u) {
            return channel_.gain(u, square(x - x_[u]) + square(y - y_[u]));
        };
        double sum = noise_;
        for (int j = 1; j < uavs_; ++j) sum += jamming_[j] * gain(j);
        return sum / gain(0);
    }

    Derivatives differentiate(double x, double y) const override {
        Derivatives sum{};
        const LogGain transmitter = log_gain(x, y, 0);
        add(sum, noise_, subtract(UNITY, transmitter));
        for (int j = 1; j < uavs_; ++j)
            add(sum, jamming_[j], subtract(log_gain(x, y, j), transmitter));
        return sum;
    }

    Expansion expand(double x, double y, double ball) const override {
        const LogGain transmitter = log_gain(x, y, 0);
        const Range below = find_range(0, transmitter, ball);
        Expansion v{};
        double third = 0.0, second = 0.0, magnitude = 0.0;
        for (int u = 0; u < uavs_; ++u) {
            const double weight = u ? jamming_[u] : noise_;
            const LogGain numerator = u ? log_gain(x, y, u) : UNITY;
            const LogGain ratio = subtract(numerator, transmitter);
            Range range{1.0, 1.0, {}};
            if (u) range = find_range(u, numerator, ball);
            const double second_bound = range.bounds.second + below.bounds.second;
            const double third_bound = range.bounds.third + below.bounds.third;
            double slope = range.bounds.first + below.bounds.first;
            // Of UAVs that are close together most of the slope cancels.
            slope = std::min(
                slope, std::hypot(ratio.x, ratio.y) + ball * second_bound + GAIN_ULPS * slope);
            const double second_factor = second_bound + slope * slope;
            const double third_factor = third_bound + 3.0 * slope * second_bound
                + slope * slope * slope;
            v.ball_bound += weight
                * std::max(range.least / below.most, ratio.gain * std::exp(-ball * slope));
            const double most = weight * range.most / below.least;
            third += most * third_factor;
            second += most * second_factor;
            magnitude += most * (slope + ball * (second_factor + ball * third_factor));
            add(v.at, weight, ratio);
        }
        v.ball_bound *= 1.0 - GAIN_ULPS;
        v.hessian_error = third * ball / 3.0 + GAIN_ULPS * second;
        v.rounding = GAIN_ULPS * v.at.value
            + 4.0 * magnitude * (place_error_ + GAIN_ULPS * ball);
        if (!(v.hessian_error < INFINITE)) {  // Above a kink only the ball's bound is left.
            v.hessian_error = 0.0;
            v.rounding = INFINITE;
        }
        return v;
    }

private:
    // More than the rounding of a gain, of its powers and exponentials.
    static constexpr double GAIN_ULPS = 1e-12;

    // A gain at a distance, and gradient and Hessian of its logarithm.
    struct LogGain {
        double gain, x, y, xx, xy, yy, distance;
    };
    static constexpr LogGain UNITY{1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};

    // Bounds in a ball of a gain, and of the derivatives of its logarithm.
    struct Range {
        double least, most;
        PathLoss::LogBounds bounds;
    };

    Range find_range(int u, const LogGain& at, double ball) const {
        const double near = std::max(at.distance - ball, 0.0), far = at.distance + ball;
        return {channel_.gain(u, far * far), channel_.gain(u, near * near),
                channel_.bound_log_gain(u, near, far)};
    }

    LogGain log_gain(double x, double y, int u) const {
        const double dx = x - x_[u], dy = y - y_[u], squared = dx * dx + dy * dy;
        const Gain gain = channel_.derivatives(u, squared);
        const double slope = gain.first / gain.value;
        const double curvature = 4.0 * (gain.second / gain.value - slope * slope);
        return {gain.value, 2.0 * slope * dx, 2.0 * slope * dy,
                2.0 * slope + curvature * dx * dx, curvature * dx * dy,
                2.0 * slope + curvature * dy * dy, std::sqrt(squared)};
    }

    static LogGain subtract(const LogGain& a, const LogGain& b) {
        return {a.gain / b.gain, a.x - b.x, a.y - b.y, a.xx - b.xx, a.xy - b.xy, a.yy - b.yy, 0.0};
    }

    static void add(Derivatives& sum, double weight, const LogGain& log) {
        const double term = weight * log.gain;
        sum.value += term;
        sum.x += term * log.x;
        sum.y += term * log.y;
        sum.xx += term * (log.x * log.x + log.xx);
        sum.xy += term * (log.x * log.y + log.xy);
        sum.yy += term * (log.y * log.y + log.yy);
    }

    const PathLoss& channel_;
};

inline std::unique_ptr<DiscProblem> make_disc_problem(const Discs& discs) {
    if (discs.channel) return std::make_unique<PathLossProblem>(discs);
    return std::make_unique<FreeSpaceProblem>(discs);
}

}  // namespace kernel
