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

    void find_slacks(const double* path, kernel::Terms& found) const override {
        found.slacks.resize(count());
        found.kept.resize(2 * count());
        for (std::size_t i = 0; i < count(); ++i) {
            double* d = &found.kept[2 * i];
            for (int axis = 0; axis < 2; ++axis)
                d[axis] = path[2 * (i + uavs_) + axis] - base_[axis];
            found.slacks[i] = 1.0 - (d[0] * d[0] + d[1] * d[1]) / square_;
        }
    }
    void add_gradient(const kernel::Terms& here, double mu, double* gradient) const override {
        for (std::size_t i = 0; i < count(); ++i)
            for (int axis = 0; axis < 2; ++axis)
                gradient[3 * i + 1 + axis] +=
                    mu / here.slacks[i] * 2.0 / square_ * here.kept[2 * i + axis];
    }
    void find_slopes(const kernel::Terms& here, const double* moves,
                     kernel::Slopes& found) const override {
        found.slacks.assign(count(), 0.0);
        found.kept.assign(moves + 2 * uavs_, moves + 2 * (count() + uavs_));
        for (std::size_t i = 0; i < 2 * count(); ++i)
            found.slacks[i / 2] -= 2.0 / square_ * here.kept[i] * found.kept[i];
    }
    // To the positive root of bend s^2 - slope s = share c.
    void shorten(const kernel::Terms& here, const kernel::Slopes& step, double share,
                 double* longest) const override {
        for (std::size_t i = 0; i < count(); ++i) {
            const double* by = &step.kept[2 * i];
            const double bend = (by[0] * by[0] + by[1] * by[1]) / square_;
            const double half = -0.5 * step.slacks[i], room = share * here.slacks[i];
            const double root = std::sqrt(half * half + bend * room);
            double& most = longest[i % uavs_];
            if ((bend * most + 2.0 * half) * most > room) most = room / (root + half);
        }
    }
    void add_curvature(const kernel::Terms& here, const kernel::Reals& duals,
                       const kernel::Band& band) const override {
        for (std::size_t i = 0; i < count(); ++i) {
            const double* d = &here.kept[2 * i];
            const double outer = 4.0 * duals[i] / (here.slacks[i] * square_ * square_);
            const double even = 2.0 * duals[i] / square_;
            band.add(3 * i + 1, 3 * i + 1, outer * d[0] * d[0] + even, outer * d[0] * d[1],
                     outer * d[1] * d[1] + even);
        }
    }

private:
    double base_[2], square_;
};

PYBIND11_MODULE(range_limit, module) {
    py::class_<RangeLimit, kernel::Limit, std::shared_ptr<RangeLimit>>(module, "RangeLimit")
        .def(py::init<std::size_t, int, double, double, double>());
}
