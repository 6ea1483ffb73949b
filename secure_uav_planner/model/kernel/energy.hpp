// The energy of flights with a limit of acceleration, by Simpson's rule in each slot, at a price.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "limit.hpp"

namespace kernel {

// The terms of a rotary wing's power by the square s of a length of moves, times price and slot:
// blade_slope s + induced / sqrt(sqrt(1 + r^2) + r) + drag s^1.5 with r = induced_slope s.
struct PowerTerms {
    double blade_slope, induced, induced_slope, drag;

    double value(double s) const {
        const double r = induced_slope * s;
        return blade_slope * s + induced / std::sqrt(std::sqrt(1.0 + r * r) + r)
            + drag * s * std::sqrt(s);
    }
    double first(double s) const {
        const double r = induced_slope * s, root = std::sqrt(1.0 + r * r);
        return blade_slope - 0.5 * induced * induced_slope / (root * std::sqrt(root + r))
            + 1.5 * drag * std::sqrt(s);
    }
    // The second derivative times s.
    double second(double s) const {
        const double r = induced_slope * s, square = 1.0 + r * r, root = std::sqrt(square);
        return induced * induced_slope * r / std::sqrt(root + r)
            * (0.25 / square + 0.5 * r / (square * root)) + 0.75 * drag * std::sqrt(s);
    }
};

class EnergyCost {
public:
    // `end_moves` (2, U, 2) before the start and after the goal are NaN where they are free.
    EnergyCost(std::size_t slots, std::vector<PowerTerms> terms, Reals end_moves)
        : slots_(slots), terms_(std::move(terms)), end_moves_(std::move(end_moves)) {}

    // But for a constant.
    double find_value(const double* path) const {
        double sum = 0.0;
        for (std::size_t u = 0; u < terms_.size(); ++u)
            visit(path, u, [&](const Sample& at, Point move) {
                sum += at.weight * terms_[u].value(dot(move, move));
            });
        return sum;
    }

    void add_gradient(const double* path, double* gradient) const {
        for (std::size_t u = 0; u < terms_.size(); ++u)
            visit(path, u, [&](const Sample& at, Point move) {
                const double slope =
                    2.0 * at.weight * at.scale * terms_[u].first(dot(move, move));
                for (const bool last : {false, true}) {
                    const std::size_t point = last ? at.to : at.from;
                    if (point == 0 || point == slots_ + 1) continue;
                    double* entry = gradient + variable(point, u);
                    entry[0] += (last ? slope : -slope) * move.x;
                    entry[1] += (last ? slope : -slope) * move.y;
                }
            });
    }

    // Add the convex part of the Hessian.
    void add_curvature(const double* path, const Band& band) const {
        for (std::size_t u = 0; u < terms_.size(); ++u)
            visit(path, u, [&](const Sample& at, Point move) {
                const double s = dot(move, move), factor = at.weight * at.scale * at.scale;
                const double across = std::max(0.0, 2.0 * terms_[u].first(s));
                const double along =
                    std::max(0.0, 2.0 * terms_[u].first(s) + 4.0 * terms_[u].second(s));
                const double excess = s > 0.0 ? factor * (along - across) / s : 0.0;
                const double xx = factor * across + excess * move.x * move.x;
                const double xy = excess * move.x * move.y;
                const double yy = factor * across + excess * move.y * move.y;
                const bool varies = at.from > 0, also = at.to < slots_ + 1;
                if (varies) band.add(variable(at.from, u), variable(at.from, u), xx, xy, yy);
                if (also) band.add(variable(at.to, u), variable(at.to, u), xx, xy, yy);
                if (varies && also)
                    band.add(variable(at.to, u), variable(at.from, u), -xx, -xy, -yy);
            });
    }

private:
    // A move scale (q[to] - q[from]) + offset, which counts with a weight.
    struct Sample {
        std::size_t from, to;
        double scale, weight;
        Point offset;
    };

    std::ptrdiff_t variable(std::size_t point, std::size_t u) const {
        return 3 * (std::ptrdiff_t(point - 1) * terms_.size() + u) + 1;
    }

    // Call a function with the samples of a UAV and their moves: slots begin and end with moves
    // of the path, and in their middle have the mean of both.
    template <typename Function>
    void visit(const double* path, std::size_t u, Function function) const {
        const std::size_t U = terms_.size();
        const auto call = [&](const Sample& at) {
            const double* from = path + 2 * (at.from * U + u);
            const double* to = path + 2 * (at.to * U + u);
            function(at, Point{at.scale * (to[0] - from[0]) + at.offset.x,
                               at.scale * (to[1] - from[1]) + at.offset.y});
        };
        for (std::size_t n = 0; n <= slots_; ++n)
            call({n, n + 1, 1.0, 1.0 / 3.0, {0.0, 0.0}});
        for (std::size_t n = 1; n <= slots_; ++n)
            call({n - 1, n + 1, 0.5, 2.0 / 3.0, {0.0, 0.0}});
        for (const bool last : {false, true}) {
            const std::size_t from = last ? slots_ : 0;
            const double* given = &end_moves_[2 * (last * U + u)];
            if (std::isnan(given[0]))
                call({from, from + 1, 1.0, 5.0 / 6.0, {0.0, 0.0}});
            else
                call({from, from + 1, 0.5, 2.0 / 3.0, {0.5 * given[0], 0.5 * given[1]}});
        }
    }

    const std::size_t slots_;
    const std::vector<PowerTerms> terms_;
    const Reals end_moves_;
};

}  // namespace kernel
