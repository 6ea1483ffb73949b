#include <cmath>

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "link_gains.hpp"

namespace py = pybind11;
using Reals = std::vector<double>;

// The gain is snr exp(-d^2 / range^2) / (d^2 + H^2).
class Absorbed : public kernel::LinkGains {
public:
    Absorbed(Reals snr, Reals squared_altitudes, double range)
        : LinkGains(snr.size()), snr_(std::move(snr)),
          squared_altitudes_(std::move(squared_altitudes)), squared_(range * range) {}

    double gain(std::size_t link, double squared) const override {
        return snr_[link] * std::exp(-squared / squared_) / (squared + squared_altitudes_[link]);
    }
    kernel::Gain derivatives(std::size_t link, double squared) const override {
        const double value = gain(link, squared);
        const double inverse = 1.0 / (squared + squared_altitudes_[link]);
        const double slope = -1.0 / squared_ - inverse;
        return {value, value * slope, value * (slope * slope + inverse * inverse)};
    }

private:
    Reals snr_, squared_altitudes_;
    double squared_;
};

PYBIND11_MODULE(absorbed, module) {
    py::class_<Absorbed, kernel::LinkGains, std::shared_ptr<Absorbed>>(module, "Absorbed")
        .def(py::init<Reals, Reals, double>());
}
