#include "norm.hpp"

#include <cmath>

namespace kernel {

NormLimit::NormLimit(std::size_t slots, int order, const Reals& squares,
                     std::vector<char> ignored, Reals outer_moves)
    : Limit(slots, int(squares.size())), order_(order), ignored_(std::move(ignored)),
      outer_moves_(std::move(outer_moves)), still_(outer_moves_.size()) {
    for (std::size_t i = 0; i < ignored_.size(); ++i)
        squares_.push_back(squares[i % squares.size()]);
}

// The weights of a d's points.
const double* NormLimit::stencil() const {
    static const double first[] = {-1.0, 1.0}, second[] = {1.0, -2.0, 1.0};
    return order_ == 1 ? first : second;
}

// All d of a path, (N + order, U, 2), with the moves outside it.
void NormLimit::differences(const double* path, const double* outer, Reals& found) const {
    const std::size_t width = 2 * uavs_, inner = slots_ * width;
    found.resize(2 * count());
    double* d = found.data();
    if (order_ == 1) {
        for (std::size_t i = 0; i < inner + width; ++i) d[i] = path[i + width] - path[i];
        return;
    }
    for (std::size_t i = 0; i < width; ++i) d[i] = path[width + i] - path[i] - outer[i];
    d += width;
    for (std::size_t i = 0; i < inner; ++i)
        d[i] = (path[i + 2 * width] - path[i + width]) - (path[i + width] - path[i]);
    for (std::size_t i = 0; i < width; ++i)
        d[inner + i] = outer[width + i] - (path[inner + width + i] - path[inner + i]);
}

void NormLimit::find_slacks(const double* path, Terms& found) const {
    differences(path, outer_moves_.data(), found.kept);
    found.slacks.resize(count());
    const double* d = found.kept.data();
    for (std::size_t i = 0; i < count(); ++i)
        found.slacks[i] = ignored_[i] ? 1.0
            : 1.0 - (d[2 * i] * d[2 * i] + d[2 * i + 1] * d[2 * i + 1]) / squares_[i];
}

void NormLimit::add_gradient(const Terms& here, double mu, double* gradient) const {
    const double* weights = stencil();
    const std::ptrdiff_t slots = slots_;
    for (std::size_t i = 0; i < count(); ++i) {
        if (ignored_[i]) continue;
        const double* d = &here.kept[2 * i];
        const double force = mu / here.slacks[i] * (2.0 / squares_[i]);
        const std::ptrdiff_t m = i / uavs_, u = i % uavs_;
        for (int place = 0; place <= order_; ++place) {
            const std::ptrdiff_t n = m + place - order_;
            if (n < 0 || n >= slots) continue;
            double* at = gradient + 3 * (n * uavs_ + u) + 1;
            at[0] += weights[place] * force * d[0];
            at[1] += weights[place] * force * d[1];
        }
    }
}

void NormLimit::find_slopes(const Terms& here, const double* moves, Slopes& found) const {
    differences(moves, still_.data(), found.kept);
    found.slacks.resize(count());
    const double *d = here.kept.data(), *by = found.kept.data();
    for (std::size_t i = 0; i < count(); ++i)
        found.slacks[i] = ignored_[i] ? 0.0
            : -2.0 / squares_[i] * (d[2 * i] * by[2 * i] + d[2 * i + 1] * by[2 * i + 1]);
}

// To the positive root of bend s^2 + 2 half s = room, found without cancellation.
void NormLimit::shorten(const Terms& here, const Slopes& step, double share,
                        double* longest) const {
    const double *d = here.kept.data(), *by = step.kept.data();
    for (std::size_t i = 0; i < count(); ++i) {
        if (ignored_[i]) continue;
        const double bend = (by[2 * i] * by[2 * i] + by[2 * i + 1] * by[2 * i + 1]) / squares_[i];
        const double half = (d[2 * i] * by[2 * i] + d[2 * i + 1] * by[2 * i + 1]) / squares_[i];
        const double room = share * here.slacks[i];
        double& most = longest[i % uavs_];
        if ((bend * most + 2.0 * half) * most <= room) continue;
        const double root = std::sqrt(half * half + bend * room);
        const double length = half > 0.0 ? room / std::max(root + half, 1e-300)
                                         : (root - half) / std::max(bend, 1e-300);
        most = std::min(most, length);
    }
}

void NormLimit::add_curvature(const Terms& here, const Reals& duals, const Band& band) const {
    const double* weights = stencil();
    const std::ptrdiff_t slots = slots_;
    for (std::size_t i = 0; i < count(); ++i) {
        if (ignored_[i]) continue;
        const double* d = &here.kept[2 * i];
        const double dual = duals[i], square = squares_[i];
        const double outer = 4.0 * dual / (here.slacks[i] * square * square);
        const double even = 2.0 * dual / square;
        const double xx = outer * d[0] * d[0] + even, xy = outer * d[0] * d[1];
        const double yy = outer * d[1] * d[1] + even;
        const std::ptrdiff_t m = i / uavs_, u = i % uavs_;
        for (int first = 0; first <= order_; ++first) {
            const std::ptrdiff_t n = m + first - order_;
            if (n < 0) continue;
            for (int second = first; second <= order_ && n + second - first < slots; ++second) {
                const double by = weights[first] * weights[second];
                band.add(3 * ((n + second - first) * uavs_ + u) + 1, 3 * (n * uavs_ + u) + 1,
                         by * xx, by * xy, by * yy);
            }
        }
    }
}

}  // namespace kernel
