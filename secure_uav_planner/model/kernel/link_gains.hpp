// The interface of a channel model in the kernel. A new model is one subclass of LinkGains.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

namespace kernel {

// The gain of a link, and its first and second derivative by the squared horizontal distance.
struct Gain {
    double value, first, second;
};

// The gain of every link over the noise power, as a function of the squared horizontal distance.
//
// Link k U + u is from UAV u to receiver k. A gain must fall with the distance.
class LinkGains {
public:
    // Whether the gain may have a kink at distance 0, which the barrier function then rounds.
    static constexpr bool KINKED = false;

    explicit LinkGains(std::size_t links) : links_(links) {}
    virtual ~LinkGains() = default;
    std::size_t links() const { return links_; }

    // Return the gain at a squared distance.
    virtual double gain(std::size_t link, double squared) const = 0;
    // Return the gain at a squared distance, with its derivatives.
    virtual Gain derivatives(std::size_t link, double squared) const = 0;

private:
    const std::size_t links_;
};

// Line of sight with free-space path loss: snr / (d^2 + H^2).
class FreeSpace final : public LinkGains {
public:
    // `snr`: SNR at unit distance and unit power. `squared_altitudes`: H^2. One for each link.
    FreeSpace(std::vector<double> snr, std::vector<double> squared_altitudes)
        : LinkGains(snr.size()), snr_(std::move(snr)),
          squared_altitudes_(std::move(squared_altitudes)) {}

    static double loss(double squared, double squared_altitude) {
        return squared + squared_altitude;
    }

    double gain(std::size_t link, double squared) const override {
        return snr_[link] / loss(squared, squared_altitudes_[link]);
    }
    Gain derivatives(std::size_t link, double squared) const override {
        const double inverse = 1.0 / loss(squared, squared_altitudes_[link]);
        const double gain = snr_[link] * inverse, first = -gain * inverse;
        return {gain, first, -2.0 * first * inverse};
    }

private:
    std::vector<double> snr_, squared_altitudes_;
};

// Path loss with an exponent and lines of sight: snr (d^2 + H^2)^(-exponent / 2) M. With
// z = steepness theta - shift, theta being the elevation in degrees, M is either the mean
// kappa + (1 - kappa) P with the probability P = 1 / (1 + exp(-z)) of a line of sight, or the
// smoothed quantile kappa^(1 - S), where S = z^3 (6 z^2 - 15 z + 10) rises from 0 at z = 0 to 1 at
// z = 1. The gain has a kink at d = 0, below the UAV.
class PathLoss final : public LinkGains {
public:
    static constexpr bool KINKED = true;

    // Bounds of the absolute values of the first three derivatives of log gain along any straight
    // line on the ground.
    struct LogBounds {
        double first, second, third;
    };

    // `snr`, `squared_altitudes` (H^2), `losses` (kappa), `steepness` and `shift`, one for each
    // link. A link that always has a line of sight has kappa = 1. `exponent`: of the path loss.
    // `quantile`: whether the line-of-sight factor is the smoothed quantile and not the mean.
    PathLoss(std::vector<double> snr, std::vector<double> squared_altitudes,
             std::vector<double> losses, std::vector<double> steepness, std::vector<double> shift,
             double exponent, bool quantile)
        : LinkGains(snr.size()), snr_(std::move(snr)),
          squared_altitudes_(std::move(squared_altitudes)), losses_(std::move(losses)),
          steepness_(std::move(steepness)), shift_(std::move(shift)), exponent_(exponent),
          quantile_(quantile) {
        for (const double squared : squared_altitudes_) altitudes_.push_back(std::sqrt(squared));
    }

    double gain(std::size_t link, double squared) const override {
        const double clear = snr_[link] * power(squared + squared_altitudes_[link]);
        return losses_[link] < 1.0 ? clear * sight(link, squared).factor : clear;
    }

    // Return gain and derivatives by s = d^2, by way of log gain = const - exponent / 2
    // log(s + H^2) + log M(z). The line-of-sight factor M is 1 on links that always have a line of
    // sight, and z is affine in the elevation arctan(H / d). `turn` is dz/ds.
    Gain derivatives(std::size_t link, double squared) const override {
        const double inverse = 1.0 / (squared + squared_altitudes_[link]);
        double value = snr_[link] * power(squared + squared_altitudes_[link]);
        // The derivatives of log gain by the squared distance.
        double first = -0.5 * exponent_ * inverse, second = -first * inverse;
        if (losses_[link] < 1.0) {
            squared = std::max(squared, LEAST);
            const Sight at = sight(link, squared);
            const double turn =
                -0.5 * DEGREES * altitudes_[link] * inverse / std::sqrt(squared) * steepness_[link];
            value *= at.factor;
            first += at.first * turn;
            second += at.second * turn * turn - at.first * turn * (0.5 / squared + inverse);
        }
        return {value, value * first, value * (second + first * first)};
    }

    // Bound |f'|, |f''| and |f'''| of f = log gain along any line on the ground, at horizontal
    // distances from `near` to `far`; infinite if near = 0 and the line-of-sight factor varies.
    //
    // Along a line, with D = d^2 + H^2 and the cosine c between line and offset, (log D)' =
    // 2 d c / D, |(log D)''| <= 2 / D and |(log D)'''| <= 4 / D^(3/2). Of theta = arctan(H / d),
    // |theta'| <= H / D, |theta''| <= H / D max(2 d / D, 1 / d), and |theta'''| <=
    // H (6 / D^2 + 1.155 (2 / D^2 + 1 / (D d^2))), as 3 c (1 - c^2) <= 1.155.
    LogBounds bound_log_gain(std::size_t link, double near, double far) const {
        const double squared = squared_altitudes_[link], altitude = altitudes_[link];
        const double lowest = near * near + squared;
        const double along = near < altitude && altitude < far
            ? 0.5 / altitude
            : std::max(near / lowest, far / (far * far + squared));
        LogBounds bounds{exponent_ * along, exponent_ / lowest,
                         2.0 * exponent_ / (lowest * std::sqrt(lowest))};
        if (!(losses_[link] < 1.0)) return bounds;
        const LogBounds by_z = quantile_ ? bound_quantile(link, near, far)
                                         : bound_mean(link, near, far);
        if (by_z.third == 0.0) return bounds;
        const double first = DEGREES * altitude / lowest * steepness_[link];
        const double second =
            first / near * std::max(1.0, 2.0 * far * far / (far * far + squared));
        const double third = first * (8.31 / lowest + 1.155 / (near * near));
        bounds.first += by_z.first * first;
        bounds.second += by_z.second * first * first + by_z.first * second;
        bounds.third += by_z.third * first * first * first + 3.0 * by_z.second * first * second
            + by_z.first * third;
        return bounds;
    }

private:
    static constexpr double DEGREES = 57.295779513082320877;  // Degrees of one radian.
    static constexpr double LEAST = 1e-60;  // Least squared distance with finite derivatives.

    // M, and the derivatives of log M by z.
    struct Sight {
        double factor, first, second;
    };

    double power(double squared) const {
        return exponent_ == 2.0 ? 1.0 / squared : std::pow(squared, -0.5 * exponent_);
    }

    double z(std::size_t link, double squared) const {
        return steepness_[link] * DEGREES * std::atan2(altitudes_[link], std::sqrt(squared))
            - shift_[link];
    }

    double probability(std::size_t link, double squared) const {
        return 1.0 / (1.0 + std::exp(-z(link, squared)));
    }

    // Return the line-of-sight factor M of a gain at a squared distance, with the first two
    // derivatives of log M by z. The mean is M = kappa + (1 - kappa) P, P = 1 / (1 + exp(-z)). The
    // quantile is M = kappa^(1 - S), S = z^3 (6 z^2 - 15 z + 10) with z clamped to [0, 1].
    Sight sight(std::size_t link, double squared) const {
        const double loss = losses_[link];
        if (quantile_) {
            const double clamped = std::clamp(z(link, squared), 0.0, 1.0), rest = 1.0 - clamped;
            const double scale = -std::log(loss), product = clamped * rest;
            // 1 - S by its own formula, which loses no digit where 1 - S is small.
            const double missing =
                rest * rest * rest * (1.0 + 3.0 * clamped + 6.0 * clamped * clamped);
            return {std::exp(-scale * missing), scale * 30.0 * product * product,
                    scale * 60.0 * product * (rest - clamped)};
        }
        const double likely = probability(link, squared);
        const double factor = loss + (1.0 - loss) * likely;
        const double first = (1.0 - loss) * likely * (1.0 - likely) / factor;
        return {factor, first, first * (1.0 - 2.0 * likely - first)};
    }

    // Bound |f'|, |f''| and |f'''| of f(z) = log M at distances from `near` to `far`, for the mean
    // line-of-sight factor M = kappa + (1 - kappa) P. P' = P (1 - P) bounds P'' and P''', too.
    LogBounds bound_mean(std::size_t link, double near, double far) const {
        const double loss = losses_[link];
        const double most = probability(link, near * near);
        const double least = probability(link, far * far);
        const double first = (1.0 - loss) * most / (loss + (1.0 - loss) * most) * (1.0 - least);
        return {first, first * (1.0 + first), first * (1.0 + first * (3.0 + 2.0 * first))};
    }

    // Bound |f'|, |f''| and |f'''| of f(z) = log M at distances from `near` to `far`, for the
    // quantile M = kappa^(1 - S). S = z^3 (6 z^2 - 15 z + 10) for 0 < z < 1 is constant outside. A
    // derivative of S is largest at an end or where the next one is 0.
    LogBounds bound_quantile(std::size_t link, double near, double far) const {
        const double low = std::max(z(link, far * far), 0.0);
        const double high = std::min(z(link, near * near), 1.0);
        LogBounds bounds{};
        if (high <= 0.0 || low >= 1.0) return bounds;
        const double scale = -std::log(losses_[link]);
        for (const double extreme : {low, 0.21132486540518712, 0.5, 0.78867513459481288, high}) {
            const double at = std::clamp(extreme, low, high), product = at * (1.0 - at);
            bounds.first = std::max(bounds.first, scale * 30.0 * product * product);
            bounds.second =
                std::max(bounds.second, scale * 60.0 * product * std::fabs(1.0 - 2.0 * at));
            bounds.third = std::max(bounds.third, scale * 60.0 * std::fabs(1.0 - 6.0 * product));
        }
        return bounds;
    }

    std::vector<double> snr_, squared_altitudes_, losses_, altitudes_, steepness_, shift_;
    double exponent_;
    bool quantile_;
};

}  // namespace kernel
