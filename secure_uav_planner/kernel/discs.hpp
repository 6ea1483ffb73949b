// The largest leak over discs; see channel/disc_search.py and channel/inverse_sinr.py.
//
// The same names mean the same there, where the bounds and their rounding are derived. Here every
// slot is examined by itself.
#pragma once

#include <cstdint>
#include <functional>

#include "problem.hpp"

namespace kernel {

// Pairs of a slot and an eavesdropper, P of them; see inverse_sinr.Pairs. Arrays of the caller.
struct Pairs {
    std::size_t count;
    int uavs;
    const double *x, *y;             // (U, P).
    const double* squared_altitudes;  // (U).
    const double *noise, *radius;    // (P).
    const double* jamming;           // (U - 1, P).
};

// A place seen from the centre of its disc.
struct Found {
    double v, x, y;
};

// Find disc_search.likely_places; v, x and y are (P).
void likely_places(const Pairs& pairs, double* v, double* x, double* y);

// What DiscSearch is asked for, in arrays of the caller.
struct Proof {
    const std::int64_t* slot;   // Of every pair, not falling, from 0 to M - 1, (P).
    const double* most;         // That each pair leaks at most, in bit/s/Hz, (P).
    std::int64_t most_sectors;  // See MOST_SECTORS.
    double* leaks;              // What no place leaks more than, (M).
    std::int64_t* pair;         // Which has the worst place found, (M).
    double* place;              // Where it is, (M, 2).
};

// Find DiscSearch.proven_leaks. `wait` is called now and then, if it takes long.
void prove(const Pairs& pairs, const Proof& proof, const std::function<void()>& wait);

}  // namespace kernel
