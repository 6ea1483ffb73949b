// What the kernel asks of a limit on flights; a new limit is one subclass of Limit.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace kernel {

using Reals = std::vector<double>;

constexpr double FRACTION_TO_BOUNDARY = 0.995;  // How far towards a limit a step may go.

struct Point {
    double x, y;
};

inline double dot(Point a, Point b) { return a.x * b.x + a.y * b.y; }
inline Point operator-(Point a, Point b) { return {a.x - b.x, a.y - b.y}; }
inline Point operator*(double factor, Point a) { return {factor * a.x, factor * a.y}; }

// The line normal . place = offset.
struct Line {
    Point normal;
    double offset;
};

// The lines of a LineLimit, which stay the same during a Newton step.
struct LineSet {
    std::vector<Line> lines;  // (M, G).
    Reals max_moves;          // The longest move of each piece, (M, G), or empty.
};

// The slacks c of a limit at one x; `cache` is for the limit's own use.
struct Slacks {
    Reals values, cache;
    const LineSet* lines = nullptr;
};

// The directional derivatives of the slacks along a step; `cache` likewise.
struct Slopes {
    Reals values, cache;
};

// The lower triangle of a symmetric band matrix in the variables x (N, U, 3).
struct Band {
    double* entries;  // Column by column, each from the diagonal down.
    int height;       // Entries of a column.

    // Add a symmetric block to the rows and columns of two points, given by the index of their x
    // coordinate. What lies above the diagonal is left out.
    void add(std::ptrdiff_t row, std::ptrdiff_t column, double xx, double xy, double yy) const {
        double* at = entries + column * height + row - column;
        at[0] += xx;
        at[1] += xy;
        if (row > column) at[height - 1] += xy;
        at[height] += yy;
    }
};

// A limit c(x) > 0 on flights through M = N + 2 points, of which the first and last are fixed.
//
// Paths are (M, U, 2), in the units of a Grid. So are moves of their points along a step, which
// are zero where a point does not vary.
class Limit {
public:
    Limit(std::size_t slots, int uavs) : slots_(slots), uavs_(uavs) {}
    virtual ~Limit() = default;
    bool fits(std::size_t slots, int uavs) const { return slots == slots_ && uavs == uavs_; }

    // The number of slacks.
    virtual std::size_t count() const = 0;
    // The number of rows below the diagonal that the curvature fills.
    virtual int bandwidth() const = 0;
    // True if the limit chooses lines before every step.
    virtual bool has_lines() const { return false; }
    virtual void choose_lines(const double* /* path */, LineSet&) const {}
    virtual void find_slacks(const double* path, Slacks& slacks) const = 0;
    // Add the gradient of -mu sum log c to `gradient`, (N, U, 3).
    virtual void add_gradient(const Slacks& slacks, double mu, double* gradient) const = 0;
    virtual void find_slopes(const Slacks& slacks, const double* moves, Slopes& slopes) const = 0;
    // Lower the step lengths of the UAVs, (U), to a fraction of the way to the boundary.
    virtual void limit_steps(const Slacks& slacks, const Slopes& slopes, double fraction,
                             double* lengths) const = 0;
    // Add dual / c (dc/dx)(dc/dx)^T - dual d2c/dx2 of every slack.
    virtual void add_curvature(const Slacks& slacks, const Reals& duals,
                               const Band& band) const = 0;

protected:
    // The index in x of the x coordinate of a point that varies.
    std::ptrdiff_t variable(std::size_t point, int uav) const {
        return 3 * (std::ptrdiff_t(point - 1) * uavs_ + uav) + 1;
    }

    const std::size_t slots_;
    const int uavs_;
};

// Lower a step length until the step takes at most a fraction of a slack away.
inline void limit_step(double& length, double slack, double slope,
                       double fraction = FRACTION_TO_BOUNDARY) {
    const double most = fraction * slack;
    if (-slope * length > most) length = most / -slope;
}

}  // namespace kernel
