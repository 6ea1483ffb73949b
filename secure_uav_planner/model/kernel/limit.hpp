// Limits on flights.
#pragma once

#include <algorithm>
#include <cmath>

#include "numbers.hpp"
#include "vectors.hpp"

namespace kernel {

constexpr double FRACTION_TO_BOUNDARY = 0.995;  // Largest fraction of a slack that a step takes.

// Lower a step length so that the step takes at most FRACTION_TO_BOUNDARY of a slack.
inline void limit_step(double& length, double slack, double slope) {
    const double most = FRACTION_TO_BOUNDARY * slack;
    if (-slope * length > most) length = most / -slope;
}

// The line normal . place = offset.
struct Line {
    Point normal;
    double offset;
};

// The lines of a limit's vectors, which stay the same during a Newton step.
struct LineSet {
    std::vector<Line> lines;  // (I), or none.
    Reals max_moves;          // The longest move of each vector, (I), or none.
};

// The slacks c of a limit and its vectors at one x; or the slopes of the slacks along a step and
// the moves of the vectors.
struct Slacks {
    Reals values;
    std::vector<Point> vectors;
    const LineSet* lines = nullptr;
};

// A limit c > 0 for each of I vectors d of flights. c = 1 - |d|^2 / r^2, or c = normal . d - offset
// if the limit has lines. An ignored vector has c = 1.
class Limit {
public:
    // `ignored` (I): whether to ignore a vector. `squares` (I): r^2; empty for a limit with lines.
    Limit(Vectors vectors, std::vector<char> ignored, Reals squares)
        : vectors_(std::move(vectors)), ignored_(std::move(ignored)),
          squares_(std::move(squares)) {}
    virtual ~Limit() = default;

    const Vectors& vectors() const { return vectors_; }
    std::size_t count() const { return ignored_.size(); }
    // True if the limit chooses lines before every step.
    virtual bool has_lines() const { return false; }
    virtual void choose_lines(const double* /* path */, LineSet&) const {}

    // Find the vectors d and the slacks on a path, (M, U, 2). An ignored vector has slack 1.
    void find_slacks(const double* path, Slacks& slacks) const {
        vectors_.compute_vectors(path, false, slacks.vectors);
        slacks.values.assign(count(), 1.0);
        for_limited(slacks, [&](std::size_t i, Point d, const Line* line) {
            slacks.values[i] = line ? dot(line->normal, d) - line->offset
                                    : 1.0 - dot(d, d) / squares_[i];
        });
    }

    // Add the gradient of -mu sum log c to `gradient`, (N, U, 3). The slack of vector d is
    // c = normal . d - offset with a line, and c = 1 - |d|^2 / r^2 without.
    void add_gradient(const Slacks& slacks, double mu, double* gradient) const {
        for_limited(slacks, [&](std::size_t i, Point d, const Line* line) {
            const double force = mu / slacks.values[i];
            vectors_.add_gradient(
                i, line ? -force * line->normal : force * (2.0 / squares_[i]) * d, gradient);
        });
    }

    // Find the moves of the vectors d, and the slopes of the slacks c, for moves (M, U, 2) of the
    // path's points. c is normal . d - offset with a line, 1 - |d|^2 / r^2 without, 1 if ignored.
    void find_slopes(const Slacks& slacks, const double* moves, Slacks& slopes) const {
        vectors_.compute_vectors(moves, true, slopes.vectors);
        slopes.values.assign(count(), 0.0);
        for_limited(slacks, [&](std::size_t i, Point d, const Line* line) {
            const Point move = slopes.vectors[i];
            slopes.values[i] =
                line ? dot(line->normal, move) : -2.0 / squares_[i] * dot(d, move);
        });
    }

    // Lower the step lengths of the UAVs, (U), at most 1, so that a step takes at most
    // FRACTION_TO_BOUNDARY of each slack and of each vector's longest move, if it has one. For a
    // vector of two UAVs this holds if both move by the same step length.
    void limit_steps(const Slacks& slacks, const Slacks& slopes, double* lengths) const {
        const Reals& max_moves = slacks.lines->max_moves;
        for_limited(slacks, [&](std::size_t i, Point d, const Line* line) {
            // After a step of length s the slack has fallen by a s^2 + 2 b s; a line's slack is
            // linear. So s is at most the positive root of a s^2 + 2 b s = c, without cancellation.
            const Point move = slopes.vectors[i];
            const double a = line ? 0.0 : dot(move, move) / squares_[i];
            const double b = line ? -0.5 * slopes.values[i] : dot(d, move) / squares_[i];
            const double c = FRACTION_TO_BOUNDARY * slacks.values[i];
            const double distance = max_moves.empty() ? 0.0 : std::sqrt(dot(move, move));
            const double most = max_moves.empty() ? 0.0 : FRACTION_TO_BOUNDARY * max_moves[i];
            if (a + 2.0 * b <= c && distance <= most) return;
            vectors_.for_terms(i, [&](const Vectors::Term& term) {
                double& length = lengths[term.uav];
                if ((a * length + 2.0 * b) * length > c) {
                    const double root = std::sqrt(b * b + a * c);
                    length = std::min(length, b > 0.0 ? c / std::max(root + b, TINY)
                                                      : (root - b) / std::max(a, TINY));
                }
                if (distance * length > most) length = std::min(length, most / distance);
            });
        });
    }

    // Add to the band dual / c (dc/dx)(dc/dx)^T - dual d2c/dx2 of every slack c. `duals` are (I).
    void add_curvature(const Slacks& slacks, const Reals& duals, const Band& band) const {
        for_limited(slacks, [&](std::size_t i, Point d, const Line* line) {
            const Point along = line ? line->normal : d;
            double outer = duals[i] / slacks.values[i], isotropic = 0.0;
            if (!line) {
                outer = 4.0 * duals[i] / (slacks.values[i] * squares_[i] * squares_[i]);
                isotropic = 2.0 * duals[i] / squares_[i];
            }
            vectors_.add_curvature(i, outer * along.x * along.x + isotropic,
                                   outer * along.x * along.y,
                                   outer * along.y * along.y + isotropic, band);
        });
    }

private:
    // Call function(i, d, line) for every vector d that is not ignored; line is null without lines.
    template <typename Function>
    void for_limited(const Slacks& slacks, Function function) const {
        const std::vector<Line>& lines = slacks.lines->lines;
        for (std::size_t i = 0; i < count(); ++i)
            if (!ignored_[i])
                function(i, slacks.vectors[i], lines.empty() ? nullptr : &lines[i]);
    }

    const Vectors vectors_;
    const std::vector<char> ignored_;
    const Reals squares_;
};

}  // namespace kernel
