#include <cmath>

#include <pybind11/pybind11.h>

#include "limit.hpp"

namespace py = pybind11;

// c = 1 - |d|^2 / r^2 for the offset d of every point that varies from a base.
class RangeLimit : public kernel::Limit {
public:
    RangeLimit(std::size_t slots, int uavs, double x, double y, double reach)
        : Limit(slots, uavs), base_{x, y}, square_(reach * reach) {}

    std::size_t count() const override { return slots_ * uavs_; }
    // The two coordinates of a point are coupled.
    int bandwidth() const override { return 1; }

    void find_slacks(const double* path, kernel::Slacks& slacks) const override {
        slacks.values.resize(count());
        slacks.cache.resize(2 * count());
        for (std::size_t i = 0; i < count(); ++i) {
            double* d = &slacks.cache[2 * i];
            for (int axis = 0; axis < 2; ++axis)
                d[axis] = path[2 * (i + uavs_) + axis] - base_[axis];
            slacks.values[i] = 1.0 - (d[0] * d[0] + d[1] * d[1]) / square_;
        }
    }
    void add_gradient(const kernel::Slacks& slacks, double mu, double* gradient) const override {
        for (std::size_t i = 0; i < count(); ++i)
            for (int axis = 0; axis < 2; ++axis)
                gradient[3 * i + 1 + axis] +=
                    mu / slacks.values[i] * 2.0 / square_ * slacks.cache[2 * i + axis];
    }
    void find_slopes(const kernel::Slacks& slacks, const double* moves,
                     kernel::Slopes& slopes) const override {
        slopes.values.assign(count(), 0.0);
        slopes.cache.assign(moves + 2 * uavs_, moves + 2 * (count() + uavs_));
        for (std::size_t i = 0; i < 2 * count(); ++i)
            slopes.values[i / 2] -= 2.0 / square_ * slacks.cache[i] * slopes.cache[i];
    }
    // To the positive root of a s^2 + 2 b s = c.
    void limit_steps(const kernel::Slacks& slacks, const kernel::Slopes& slopes, double fraction,
                     double* lengths) const override {
        for (std::size_t i = 0; i < count(); ++i) {
            const double* e = &slopes.cache[2 * i];
            const double a = (e[0] * e[0] + e[1] * e[1]) / square_;
            const double b = -0.5 * slopes.values[i], c = fraction * slacks.values[i];
            double& length = lengths[i % uavs_];
            if ((a * length + 2.0 * b) * length > c) length = c / (std::sqrt(b * b + a * c) + b);
        }
    }
    void add_curvature(const kernel::Slacks& slacks, const kernel::Reals& duals,
                       const kernel::Band& band) const override {
        for (std::size_t i = 0; i < count(); ++i) {
            const double* d = &slacks.cache[2 * i];
            const double outer = 4.0 * duals[i] / (slacks.values[i] * square_ * square_);
            const double isotropic = 2.0 * duals[i] / square_;
            band.add(3 * i + 1, 3 * i + 1, outer * d[0] * d[0] + isotropic, outer * d[0] * d[1],
                     outer * d[1] * d[1] + isotropic);
        }
    }

private:
    double base_[2], square_;
};

PYBIND11_MODULE(range_limit, module) {
    py::class_<RangeLimit, kernel::Limit, std::shared_ptr<RangeLimit>>(module, "RangeLimit")
        .def(py::init<std::size_t, int, double, double, double>());
}
