// What the Hessian of the leaks gains as places follow the UAVs.
//
// For f(x) = max_w g(x, w) it is -g_xw g_ww^-1 g_wx at the worst place w, which is on top of g_xx;
// for a place on the edge of its disc, that along the edge, whose curvature counts too. Without
// it, places and UAVs that follow each other in turn may swing ever further.
#pragma once

#include <algorithm>
#include <cmath>

#include "problem.hpp"

namespace kernel {

constexpr double ON_EDGE = 1.0 - 1e-6;  // Distance from the centre, in radii.
constexpr double FLATTEST = 0.01;  // Least curvature of a place, as a share of the largest.
constexpr double TINIEST = 1e-300;

// Find two rows (2, V) whose outer products, added up, are what a place brings. `mixed`, (V, 2),
// is the leak's derivative by variables and place, `slope` that by the place.
inline void follow(const Places& places, std::size_t index, int variables, const double* mixed,
                   const double* slope, double* rows) {
    double bend[2][2] = {};
    for (int j = 0; j < variables; ++j)
        if (j % 3)
            for (int axis = 0; axis < 2; ++axis) bend[j % 3 - 1][axis] += mixed[2 * j + axis];
    double most = 0.0;
    for (const auto& row : bend)
        for (const double entry : row) most = std::max(most, std::fabs(entry));
    const double least = FLATTEST * most + TINIEST;
    const double* offset = &places.offsets[2 * index];
    const double radius = places.radii[index % places.radii.size()];
    const double distance = std::sqrt(offset[0] * offset[0] + offset[1] * offset[1]);
    const auto add_row = [&](int number, double x, double y, double curvature) {
        const double by = 1.0 / std::sqrt(std::max(curvature, least));
        for (int j = 0; j < variables; ++j)
            rows[number * variables + j] = (mixed[2 * j] * x + mixed[2 * j + 1] * y) * by;
    };
    if (distance >= ON_EDGE * radius) {
        // Along the edge alone, whose own curvature counts too.
        const double over = 1.0 / std::max(distance, TINIEST);
        const double x = -offset[1] * over, y = offset[0] * over;
        const double along = (bend[0][0] * x + bend[0][1] * y) * x
            + (bend[1][0] * x + bend[1][1] * y) * y;
        add_row(0, x, y, along + (slope[0] * y - slope[1] * x) / std::max(radius, TINIEST));
        std::fill(rows + variables, rows + 2 * variables, 0.0);
        return;
    }
    // Along the eigenvectors.
    const double mean = 0.5 * (bend[0][0] + bend[1][1]), half = 0.5 * (bend[0][0] - bend[1][1]);
    const double spread = std::hypot(half, bend[1][0]);
    const double angle = 0.5 * std::atan2(bend[1][0], half);
    add_row(0, std::cos(angle), std::sin(angle), mean + spread);
    add_row(1, -std::sin(angle), std::cos(angle), mean - spread);
}

}  // namespace kernel
