// What the kernel asks of a limit of flights; a new limit is one subclass of Limit.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

#include "nearest.hpp"

namespace kernel {

using Reals = std::vector<double>;

// Lines that a limit chooses where a step begins; see LineLimit.
struct Lines {
    std::vector<Line> of;  // (M, G).
    Reals room;            // How far a piece may move at most, (M, G), or empty.
};

// The slacks c of a limit at one x; `kept` is for its own use.
struct Terms {
    Reals slacks, kept;
    const Lines* lines = nullptr;
};

// The directional derivatives of its slacks along a step; `kept` likewise.
struct Slopes {
    Reals slacks, kept;
};

// The lower triangle of a symmetric band matrix in the variables x (N, U, 3).
struct Band {
    double* entries;  // Column by column, each from the diagonal down.
    int height;       // Entries of a column.

    // Add a symmetric block to the rows and columns of two points, given by their `x`; only what
    // is in the lower triangle counts.
    void add(std::ptrdiff_t row, std::ptrdiff_t column, double xx, double xy, double yy) const {
        double* at = entries + column * height + row - column;
        at[0] += xx;
        at[1] += xy;
        if (row > column) at[height - 1] += xy;
        at[height] += yy;
    }
};

// A limit c(x) > 0 of flights through M = N + 2 points, of which the first and last are given.
//
// Paths are (M, U, 2), in the units of a Grid; so are the moves of their points along a step,
// which are zero for what does not vary.
class Limit {
public:
    Limit(std::size_t slots, int uavs) : slots_(slots), uavs_(uavs) {}
    virtual ~Limit() = default;
    bool fits(std::size_t slots, int uavs) const { return slots == slots_ && uavs == uavs_; }

    // How many slacks there are.
    virtual std::size_t count() const = 0;
    // How many rows below the diagonal its curvature reaches.
    virtual int bandwidth() const = 0;
    // Whether it chooses lines where a step begins, and choose them for a path.
    virtual bool chooses() const { return false; }
    virtual void choose(const double*, Lines&) const {}
    // Find the slacks of a path.
    virtual void find_slacks(const double* path, Terms& found) const = 0;
    // Add the gradient of -mu sum log c to one by x, (N, U, 3).
    virtual void add_gradient(const Terms& here, double mu, double* gradient) const = 0;
    // Find the directional derivatives of the slacks along moves.
    virtual void find_slopes(const Terms& here, const double* moves, Slopes& found) const = 0;
    // Lower how far every UAV may go along the moves, (U): a share of the way to the boundary.
    virtual void shorten(const Terms& here, const Slopes& step, double share,
                         double* longest) const = 0;
    // Add dual / c (dc/dx)(dc/dx)^T - dual d2c/dx2 of every slack.
    virtual void add_curvature(const Terms& here, const Reals& duals, const Band& band) const = 0;

protected:
    // Where the coordinates of a point that varies are in x.
    std::ptrdiff_t variable(std::size_t point, int uav) const {
        return 3 * (std::ptrdiff_t(point - 1) * uavs_ + uav) + 1;
    }

    const std::size_t slots_;
    const int uavs_;
};

// Lower a number of steps to those that take a share of a positive amount away.
inline void stop_at_zero(double& steps, double amount, double change, double share) {
    const double most = share * amount;
    if (-change * steps > most) steps = most / -change;
}

}  // namespace kernel
