// Limits on the length of differences of a UAV's points: speed and acceleration.
#pragma once

#include <cmath>

#include "limit.hpp"
#include "numbers.hpp"

namespace kernel {

// c = 1 - |d|^2 / r^2; a d that is ignored has c = 1.
//
// Of order 1, d is the move from a point to the next. Of order 2, it is the difference of two
// moves that follow each other, where moves before the start and after the goal are given.
class NormLimit : public Limit {
public:
    // The squares r^2 are (U), the flags (N + order, U) and the outer moves (2, U, 2).
    NormLimit(std::size_t slots, int order, const Reals& squares, std::vector<char> ignored,
              Reals outer_moves)
        : Limit(slots, int(squares.size())), order_(order), ignored_(std::move(ignored)),
          outer_moves_(std::move(outer_moves)), zero_moves_(outer_moves_.size()) {
        for (std::size_t i = 0; i < ignored_.size(); ++i)
            squares_.push_back(squares[i % squares.size()]);
    }

    std::size_t count() const override { return ignored_.size(); }
    int bandwidth() const override { return order_ * 3 * uavs_ + 1; }

    void find_slacks(const double* path, Slacks& slacks) const override {
        find_differences(path, outer_moves_.data(), slacks.cache);
        slacks.values.resize(count());
        const double* d = slacks.cache.data();
        for (std::size_t i = 0; i < count(); ++i)
            slacks.values[i] = ignored_[i] ? 1.0
                : 1.0 - (d[2 * i] * d[2 * i] + d[2 * i + 1] * d[2 * i + 1]) / squares_[i];
    }

    void add_gradient(const Slacks& slacks, double mu, double* gradient) const override {
        const double* weights = stencil();
        const std::ptrdiff_t slots = slots_;
        for (std::size_t i = 0; i < count(); ++i) {
            if (ignored_[i]) continue;
            const double* d = &slacks.cache[2 * i];
            const double force = mu / slacks.values[i] * (2.0 / squares_[i]);
            const std::ptrdiff_t m = i / uavs_, u = i % uavs_;
            for (int k = 0; k <= order_; ++k) {
                const std::ptrdiff_t n = m + k - order_;
                if (n < 0 || n >= slots) continue;
                double* at = gradient + 3 * (n * uavs_ + u) + 1;
                at[0] += weights[k] * force * d[0];
                at[1] += weights[k] * force * d[1];
            }
        }
    }

    void find_slopes(const Slacks& slacks, const double* moves, Slopes& slopes) const override {
        find_differences(moves, zero_moves_.data(), slopes.cache);
        slopes.values.resize(count());
        const double *d = slacks.cache.data(), *e = slopes.cache.data();
        for (std::size_t i = 0; i < count(); ++i)
            slopes.values[i] = ignored_[i] ? 0.0
                : -2.0 / squares_[i] * (d[2 * i] * e[2 * i] + d[2 * i + 1] * e[2 * i + 1]);
    }

    // To the positive root of a s^2 + 2 b s = c, found without cancellation.
    void limit_steps(const Slacks& slacks, const Slopes& slopes, double fraction,
                     double* lengths) const override {
        const double *d = slacks.cache.data(), *e = slopes.cache.data();
        for (std::size_t i = 0; i < count(); ++i) {
            if (ignored_[i]) continue;
            const double a = (e[2 * i] * e[2 * i] + e[2 * i + 1] * e[2 * i + 1]) / squares_[i];
            const double b = (d[2 * i] * e[2 * i] + d[2 * i + 1] * e[2 * i + 1]) / squares_[i];
            const double c = fraction * slacks.values[i];
            double& length = lengths[i % uavs_];
            if ((a * length + 2.0 * b) * length <= c) continue;
            const double root = std::sqrt(b * b + a * c);
            length = std::min(length, b > 0.0 ? c / std::max(root + b, TINY)
                                              : (root - b) / std::max(a, TINY));
        }
    }

    void add_curvature(const Slacks& slacks, const Reals& duals,
                       const Band& band) const override {
        const double* weights = stencil();
        const std::ptrdiff_t slots = slots_;
        for (std::size_t i = 0; i < count(); ++i) {
            if (ignored_[i]) continue;
            const double* d = &slacks.cache[2 * i];
            const double dual = duals[i], square = squares_[i];
            const double outer = 4.0 * dual / (slacks.values[i] * square * square);
            const double isotropic = 2.0 * dual / square;
            const double xx = outer * d[0] * d[0] + isotropic, xy = outer * d[0] * d[1];
            const double yy = outer * d[1] * d[1] + isotropic;
            const std::ptrdiff_t m = i / uavs_, u = i % uavs_;
            for (int j = 0; j <= order_; ++j) {
                const std::ptrdiff_t n = m + j - order_;
                if (n < 0) continue;
                for (int k = j; k <= order_ && n + k - j < slots; ++k) {
                    const double weight = weights[j] * weights[k];
                    band.add(3 * ((n + k - j) * uavs_ + u) + 1, 3 * (n * uavs_ + u) + 1,
                             weight * xx, weight * xy, weight * yy);
                }
            }
        }
    }

private:
    // The weights of the points of a d.
    const double* stencil() const {
        static const double first[] = {-1.0, 1.0}, second[] = {1.0, -2.0, 1.0};
        return order_ == 1 ? first : second;
    }

    // Find all d of a path, (N + order, U, 2).
    void find_differences(const double* path, const double* outer_moves,
                          Reals& differences) const {
        const std::size_t width = 2 * uavs_, inner = slots_ * width;
        differences.resize(2 * count());
        double* d = differences.data();
        if (order_ == 1) {
            for (std::size_t i = 0; i < inner + width; ++i) d[i] = path[i + width] - path[i];
            return;
        }
        for (std::size_t i = 0; i < width; ++i) d[i] = path[width + i] - path[i] - outer_moves[i];
        d += width;
        for (std::size_t i = 0; i < inner; ++i)
            d[i] = (path[i + 2 * width] - path[i + width]) - (path[i + width] - path[i]);
        for (std::size_t i = 0; i < width; ++i)
            d[inner + i] =
                outer_moves[width + i] - (path[inner + width + i] - path[inner + i]);
    }

    const int order_;
    Reals squares_;  // Of every d, as in ignored_.
    std::vector<char> ignored_;
    Reals outer_moves_, zero_moves_;
};

}  // namespace kernel
