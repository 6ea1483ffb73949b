// What is to be solved, in the units of a Grid; see barrier.py for the method itself.
#pragma once

#include <algorithm>
#include <memory>

#include "lines.hpp"

namespace kernel {

// The numbers of the Schedule that a Newton step needs.
struct Numbers {
    double boundary, power_factor, sufficient_decrease, softening, patience, dual_range;
    double mu_factor, mu_power, centred, still, negligible;
    int clipped_trials, uniform_trials;
};

// A NormLimit: c = 1 - |d|^2 / r^2 on differences d of a UAV's points.
struct NormLimit {
    int order;                   // 1: from one point to the next; 2: of these differences.
    Reals square;                // r^2, (U).
    std::vector<char> ignored;   // Differences that have no c, (M, U), M = N + order.
    Reals end_moves;             // Before the start and after the goal, (2, U, 2).
};

// Who receives: the ground node first, K in all.
struct Receivers {
    int count;
    int stride;       // From the positions of a slot to those of the next; 0 if all are the same.
    Reals positions;  // ([N,] K, 2).
    Reals edge, snr;  // (K, U).
};

// Places that stand for the discs of the eavesdroppers, E PER_DISC of them; see WorstPlaces.
struct Places {
    std::vector<char> followed;  // Which follow the UAVs, (N, E PER_DISC).
    Reals offsets;               // From the centres of their discs, (N, E PER_DISC, 2).
    Reals radii;                 // Of their discs, (E PER_DISC).
};

// A problem on a grid: (P1) with places, or (P2) without.
struct Problem {
    int slots, uavs;
    Reals starts, goals;          // (U, 2).
    std::vector<char> fixed;      // UAVs whose positions are no variables, (U).
    Reals squared_altitudes, peaks;  // (U).
    std::vector<NormLimit> norms;
    std::vector<std::shared_ptr<const LineLimit>> lines;
    Receivers receivers;
    Places places;
    Numbers numbers;

    // How many rows of the Hessian's band are below its diagonal; see Limit.height.
    int below() const {
        const int size = 3 * uavs;
        int found = size - 1;
        for (const NormLimit& limit : norms) found = std::max(found, limit.order * size + 1);
        for (const auto& limit : lines) found = std::max(found, limit->below(size));
        return found;
    }
};

}  // namespace kernel
