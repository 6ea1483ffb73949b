// What the kernel asks of a channel model; a new model is one subclass of Channel.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace kernel {

// The gain of a link, and its derivatives by the squared horizontal distance.
struct Gain {
    double value, first, second;
};

// The gain of every link over the noise power, as a function of the squared horizontal distance.
//
// Links are numbered k U + u, from UAV u to receiver k, the ground node being receiver 0. A gain
// must fall with the distance. All is in the units of a Grid.
class Channel {
public:
    explicit Channel(std::size_t links) : links_(links) {}
    virtual ~Channel() = default;
    std::size_t links() const { return links_; }

    virtual double gain(std::size_t link, double squared) const = 0;
    virtual Gain derivatives(std::size_t link, double squared) const = 0;

private:
    const std::size_t links_;
};

// Line of sight with free-space path loss: snr / (d^2 + H^2). The proof of the worst case, in
// discs.cpp, knows this model alone.
class FreeSpace final : public Channel {
public:
    // The SNR at unit distance and unit power, and H^2, of every link.
    FreeSpace(std::vector<double> snr, std::vector<double> squared_altitudes)
        : Channel(snr.size()), snr_(std::move(snr)),
          squared_altitudes_(std::move(squared_altitudes)) {}

    // The SNR at unit distance, divided by the gain.
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

}  // namespace kernel
