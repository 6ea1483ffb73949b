// The largest leak over discs: a quick search for it, and the proof that no place leaks more.
//
// With the transmitter's S and the jammers' J over the noise power, v = (1 + J) / S decides the
// leak log2(1 + 1 / v): the worst place of a disc is where v is least. With the gains g_i of its
// links,
//
//     v = 1 / (g_0 p_0) + sum_j p_j / p_0 g_j / g_0.
//
// In free space, with D_i = |x - q_i|^2 + H_i^2, g_j / g_0 is D_0 / D_j = 1 + L_j / D_j times a
// constant, where L_j = D_0 - D_j is affine in x. UAVs at the same place so cancel before anything
// is bounded, and a leak that is flat over the disc is seen to be flat. With a PathLoss, all terms
// are products of gains, whose derivatives are bounded by those of their logarithms.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>

#include "channel.hpp"
#include "limit.hpp"

namespace kernel {

// How far in bit/s/Hz a proven leak may lie above the largest one found, where that is chosen.
constexpr double TOLERANCE = 8e-7;

// Pairs of a slot and an eavesdropper, P of them, with places relative to the centre of its disc,
// in m.
struct Pairs {
    std::size_t count;
    int uavs;
    Reals x, y;               // Of the UAVs, (U, P).
    Reals squared_altitudes;  // H^2, (U).
    Reals noise;              // 1 / p_0, divided by the SNR at unit distance, (P).
    Reals radius;             // Of the disc, (P).
    Reals jamming;            // p_j / p_0, times the ratio of those, (U - 1, P).
    std::shared_ptr<const PathLoss> channel;  // With an SNR of 1, or null in free space.
};

// A sector of a ring around the centre of a disc: r in [inner, outer], |angle - middle| <= half.
// A whole disc is a sector with half = pi; all others have half <= pi / 2.
struct Sector {
    std::size_t pair;
    double inner, outer, middle, half;
    double bound;  // v is not below it here.

    bool whole() const { return half > 1.5707963267948966; }
};

// A place seen from the centre of its disc.
struct Found {
    double v, x, y;
};

// Find a place of each disc where v has a local minimum, and that probably is the least; v, x and
// y are (P).
void likely_places(const Pairs& pairs, double* v, double* x, double* y);

// What is to be proven, in arrays of the caller.
struct Proof {
    const std::int64_t* slot;   // Of every pair, not falling, from 0 to M - 1, (P).
    const double* most;         // That each pair leaks at most, in bit/s/Hz, (P).
    std::int64_t most_sectors;  // That are examined in a slot, about.
    double tolerance;           // Such as TOLERANCE.
    double* leaks;              // What no place leaks more than, (M).
    std::int64_t* pair;         // Which has the worst place found, (M).
    double* place;              // Where it is, (M, 2).
};

// Find what no place of a slot's discs leaks more than. `wait` is called now and then, if it takes
// long.
//
// A branch and bound: discs are divided into sectors of rings, and sectors whose bound shows that
// the leak in them is at most `tolerance` above the largest one found are dropped. It ends when none
// is left, or in a slot after `most_sectors`; what those that are left might leak is part of the
// result, which then is further from the largest leak, and as sure.
void prove(const Pairs& pairs, const Proof& proof, const std::function<void()>& wait);

// Raise the bound of a sector to what is proven of it; return v at a place of it.
Found bound_sector(const Pairs& pairs, Sector& sector);

}  // namespace kernel
