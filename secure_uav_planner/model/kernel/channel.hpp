// What the kernel asks of a channel model; a new model is one subclass of Channel.
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
// Links are numbered k U + u, from UAV u to receiver k, the ground node being receiver 0. A gain
// must fall with the distance.
class Channel {
public:
    // Whether the gain may have a kink at distance 0, which the barrier function then rounds.
    static constexpr bool KINKED = false;

    explicit Channel(std::size_t links) : links_(links) {}
    virtual ~Channel() = default;
    std::size_t links() const { return links_; }

    virtual double gain(std::size_t link, double squared) const = 0;
    virtual Gain derivatives(std::size_t link, double squared) const = 0;

private:
    const std::size_t links_;
};

// Line of sight with free-space path loss: snr / (d^2 + H^2).
class FreeSpace final : public Channel {
public:
    // SNR at unit distance and unit power, and H^2, of every link.
    FreeSpace(std::vector<double> snr, std::vector<double> squared_altitudes)
        : Channel(snr.size()), snr_(std::move(snr)),
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

// Path loss with an exponent and a probability of line of sight:
// snr (d^2 + H^2)^(-exponent / 2) M with M = kappa + (1 - kappa) P and
// P = 1 / (1 + a exp(-b (theta - a))) at the elevation theta in degrees. It has a kink at d = 0,
// below the UAV.
class PathLoss final : public Channel {
public:
    static constexpr bool KINKED = true;

    // Bounds of the absolute values of the first three derivatives of log gain along any straight
    // line on the ground.
    struct LogBounds {
        double first, second, third;
    };

    // SNR, H^2 and kappa of every link; kappa is 1 where a link has a line of sight.
    PathLoss(std::vector<double> snr, std::vector<double> squared_altitudes,
             std::vector<double> losses, double exponent, double a, double b)
        : Channel(snr.size()), snr_(std::move(snr)),
          squared_altitudes_(std::move(squared_altitudes)), losses_(std::move(losses)),
          exponent_(exponent), steepness_(b), shift_(b * a + std::log(a)) {
        for (const double squared : squared_altitudes_) altitudes_.push_back(std::sqrt(squared));
    }

    double gain(std::size_t link, double squared) const override {
        const double in_sight = snr_[link] * power(squared + squared_altitudes_[link]);
        const double loss = losses_[link];
        return loss < 1.0 ? in_sight * (loss + (1.0 - loss) * probability(link, squared))
                          : in_sight;
    }

    Gain derivatives(std::size_t link, double squared) const override {
        const double inverse = 1.0 / (squared + squared_altitudes_[link]);
        const double value = snr_[link] * power(squared + squared_altitudes_[link]);
        const double half = 0.5 * exponent_;
        const double first = -half * value * inverse;
        const double second = -(half + 1.0) * first * inverse;
        const double loss = losses_[link];
        if (!(loss < 1.0)) return {value, first, second};
        squared = std::max(squared, LEAST);
        // The mean over both cases, with its derivatives; the logit of P has the slope `logit`.
        const double sight = probability(link, squared);
        const double logit =
            -0.5 * DEGREES * altitudes_[link] * inverse / std::sqrt(squared) * steepness_;
        const double mean = loss + (1.0 - loss) * sight;
        const double mean_first = (1.0 - loss) * sight * (1.0 - sight) * logit;
        const double mean_second =
            mean_first * ((1.0 - 2.0 * sight) * logit - (0.5 / squared + inverse));
        return {value * mean, first * mean + value * mean_first,
                second * mean + 2.0 * first * mean_first + value * mean_second};
    }

    // Bound the derivatives of log gain between two distances; infinite if a kink is between them.
    //
    // Along a line, with D = d^2 + H^2 and the cosine c between line and offset, (log D)' =
    // 2 d c / D, |(log D)''| <= 2 / D and |(log D)'''| <= 4 / D^(3/2). Of theta = arctan(H / d),
    // |theta'| <= H / D, |theta''| <= H / D max(2 d / D, 1 / d), and |theta'''| <=
    // H (6 / D^2 + 1.155 (2 / D^2 + 1 / (D d^2))), as 3 c (1 - c^2) <= 1.155. P' = b P (1 - P)
    // theta', and by P, every further derivative has at most a factor of b more.
    LogBounds bound_log_gain(std::size_t link, double near, double far) const {
        const double squared = squared_altitudes_[link], altitude = altitudes_[link];
        const double lowest = near * near + squared;
        const double along = near < altitude && altitude < far
            ? 0.5 / altitude
            : std::max(near / lowest, far / (far * far + squared));
        LogBounds bounds{exponent_ * along, exponent_ / lowest,
                         2.0 * exponent_ / (lowest * std::sqrt(lowest))};
        const double loss = losses_[link];
        if (!(loss < 1.0)) return bounds;
        const double most = probability(link, near * near);
        const double least = probability(link, far * far);
        const double share = (1.0 - loss) * most / (loss + (1.0 - loss) * most) * (1.0 - least);
        const double unit = DEGREES * altitude / lowest * steepness_;
        const double second = unit / near * std::max(1.0, 2.0 * far * far / (far * far + squared));
        const double third = unit * (8.31 / lowest + 1.155 / (near * near));
        const double r1 = share * unit, r2 = share * (unit * unit + second);
        const double r3 = share * (unit * unit * unit + 3.0 * unit * second + third);
        bounds.first += r1;
        bounds.second += r2 + r1 * r1;
        bounds.third += r3 + 3.0 * r1 * r2 + 2.0 * r1 * r1 * r1;
        return bounds;
    }

private:
    static constexpr double DEGREES = 57.295779513082320877;  // In a radian.
    static constexpr double LEAST = 1e-60;  // Squared distance above which derivatives are finite.

    double power(double squared) const {
        return exponent_ == 2.0 ? 1.0 / squared : std::pow(squared, -0.5 * exponent_);
    }
    double probability(std::size_t link, double squared) const {
        const double elevation = DEGREES * std::atan2(altitudes_[link], std::sqrt(squared));
        return 1.0 / (1.0 + std::exp(shift_ - steepness_ * elevation));
    }

    std::vector<double> snr_, squared_altitudes_, losses_, altitudes_;
    double exponent_, steepness_, shift_;
};

}  // namespace kernel
