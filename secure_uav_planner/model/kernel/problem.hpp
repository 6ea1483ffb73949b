// What is to be solved, in the units of a Grid.
#pragma once

#include <memory>

#include "channel.hpp"
#include "limit.hpp"

namespace kernel {

constexpr double BOUNDARY = 0.995;  // The fraction to the boundary that a step may go.

// Who receives: the ground node first, K in all.
struct Receivers {
    int count;
    int stride;       // From the positions of a slot to those of the next; 0 if all are the same.
    Reals positions;  // ([N,] K, 2).
    Reals edge;       // What the guarantee adds to a distance, (K, U).
};

// Places that stand for the discs of the eavesdroppers, P for each; see WorstPlaces.
struct Places {
    std::vector<char> followed;  // Which follow the UAVs, (N, E P).
    Reals offsets;               // From the centres of their discs, (N, E P, 2).
    Reals radii;                 // Of their discs, (E P).
};

// A problem on a grid: (P1) with places, or (P2) without.
struct Problem {
    std::size_t slots;
    int uavs;
    Reals starts, goals;      // (U, 2).
    std::vector<char> fixed;  // UAVs whose positions are no variables, (U).
    Reals peaks;              // (U).
    std::vector<std::shared_ptr<const Limit>> limits;
    Receivers receivers;
    std::shared_ptr<const Channel> channel;
    Places places;
    bool colluding = false;  // Whether the SINRs of eavesdroppers, or of places, add up.

    // How many rows of the Hessian's band are below its diagonal.
    int bandwidth() const {
        int found = 3 * uavs - 1;
        for (const auto& limit : limits) found = std::max(found, limit->bandwidth());
        return found;
    }
};

}  // namespace kernel
