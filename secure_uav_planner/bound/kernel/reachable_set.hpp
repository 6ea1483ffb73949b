// The places that a UAV can reach in a group of slots; see bound/proof/reachable_set.py.
//
// A reachable set is the intersection of two discs, about the start (0, 0) and about the goal,
// minus the places that detours exclude. A cell is a part of a reachable set.
#pragma once

#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <utility>

#include "array.hpp"
#include "numbers.hpp"

namespace kernel {

constexpr double BOX_ROUNDING = 1e-14;  // Fraction by which the halves of a box are widened.

struct Box {
    double centre[3], half[3];
    bool meets_set;        // False only if the box misses the reachable set.
    bool centre_in_set;
    bool leaves_disc[2];   // Whether the box reaches beyond the discs about start and goal.
};

inline double positive_part(double x) { return x > 0 ? x : 0; }

// Lemma 9: the places that a UAV can reach in time around zones and fence; see detours.py.
class Detours {
public:
    Detours(const py::buffer& low, const py::buffer& size, const py::buffer& lengths)
        : low_(low, "low", 2), size_(size, "size", 2), lengths_(lengths, "lengths"),
          side_(lengths_.axes() == 3 ? lengths_.shape(2) : 0) {
        expect(side_ && lengths_.size() == 2 * side_ * side_, "lengths");
    }

    // True if a grid cell that the rectangle low..high touches has a path of at most `r1` from
    // the start and one of at most `r2` to the goal. False only if a UAV cannot be there.
    bool reaches(const double* low, const double* high, double r1, double r2) const {
        double first[2], last[2];
        for (int i = 0; i < 2; ++i) {
            const double corner = low_[i], size = size_[i];
            first[i] = std::max(0.0, std::floor((low[i] - corner) / size - 1e-7));
            last[i] = std::min(double(side_) - 1, std::floor((high[i] - corner) / size + 1e-7));
        }
        const double* from_start = lengths_.data();
        const double* to_goal = from_start + side_ * side_;
        for (double i = first[0]; i <= last[0]; ++i)
            for (double j = first[1]; j <= last[1]; ++j) {
                const std::size_t index = std::size_t(i) * side_ + std::size_t(j);
                if (from_start[index] <= r1 && to_goal[index] <= r2) return true;
            }
        return false;
    }

private:
    Array<const double> low_, size_, lengths_;
    std::size_t side_;
};

// The reachable sets of a UAV for C cells; cells of one group have the same discs.
class ReachableSet {
public:
    // `distance` from start to goal; `from_start` and `to_goal` (C): radii of the discs; `corner`
    // (C, 2): upper crossing of the circles, or (0, 0); `low` and `high` (C, 2): cells' corners.
    ReachableSet(double distance, const py::buffer& from_start, const py::buffer& to_goal,
                 const py::buffer& corner, const py::buffer& low, const py::buffer& high,
                 std::shared_ptr<const Detours> detours)
        : count_(count_entries(from_start)), distance_(distance),
          from_start_(from_start, "from_start"), to_goal_(to_goal, "to_goal", count_),
          corner_(corner, "corner", 2 * count_), low_(low, "low", 2 * count_),
          high_(high, "high", 2 * count_), detours_(std::move(detours)) {}

    std::size_t cells() const { return count_; }

    // The smallest and the largest coordinate of a cell along an axis, 0 for x or 1 for y.
    double low(std::size_t cell, int axis) const { return low_[2 * cell + axis]; }
    double high(std::size_t cell, int axis) const { return high_[2 * cell + axis]; }

    // Set a box's flags: whether it may meet the set, has its centre there, leaves either disc.
    void locate(std::size_t cell, Box& box) const {
        box.meets_set = meets_set(box, cell);
        box.centre_in_set = contains(box.centre, cell);
        box.leaves_disc[0] = leaves_disc(box, 0.0, from_start_[cell]);
        box.leaves_disc[1] = leaves_disc(box, distance_, to_goal_[cell]);
    }

    // An upper bound of g . q over places q in both discs, g = (ga, gb); lemma 6 is derived in
    // reachable_set.py. The disc about the start has the radius `r1`, the disc about the goal
    // (D, 0) the radius `r2`.
    //
    // The bound is the least of r1 |g|, r2 |g| + ga D, and, if the circles cross at a corner,
    // r1 |g - s| + r2 |s| + s . (D, 0). Here s is a multiple of the goal disc's normal at the
    // corner, chosen so that g - s is a multiple of the start disc's normal there.
    double support(double ga, double gb, std::size_t cell) const {
        const double r1 = from_start_[cell], r2 = to_goal_[cell];
        const double along = corner_[2 * cell], across = corner_[2 * cell + 1];
        const double norm = std::sqrt(ga * ga + gb * gb);
        double best = std::min(r1 * norm, r2 * norm + ga * distance_);
        if (across > 0) {
            const double multiple =
                positive_part((along * std::abs(gb) / across - ga) / distance_);
            const double sa = multiple * (along - distance_);
            const double sb = multiple * (gb > 0 ? across : gb < 0 ? -across : 0.0);
            best = std::min(best, r1 * std::sqrt((ga - sa) * (ga - sa) + (gb - sb) * (gb - sb))
                                      + r2 * std::sqrt(sa * sa + sb * sb) + sa * distance_);
        }
        return best;
    }

    // Add multiples of the discs' functions to a function over a box on the rim. Change its slope
    // (2) and its second derivatives (2); return the change of its value at the box's centre.
    //
    // In a disc of radius R about c the function (R^2 - |q - c|^2) / (2 R) is not negative, so any
    // multiple a >= 0 may be added to a function before it is bounded. If a is the slope's part
    // along q - c, the slope across the rim vanishes, and a / R is subtracted from the second
    // derivatives. Near a maximum on the rim the remaining terms are of second order.
    double add_disc_multiplier(const Box& box, double* slope, double* curvature,
                               std::size_t cell) const {
        const double radius[2] = {from_start_[cell], to_goal_[cell]}, y = box.centre[1];
        const double x[2] = {box.centre[0], box.centre[0] - distance_};
        // For each disc, `length` is the distance from the disc's centre to the box's centre,
        // (na, nb) is the unit vector there, and `along` is the slope's part along this vector.
        double length[2], na[2], nb[2], along[2];
        bool active[2];
        for (int i = 0; i < 2; ++i) {
            length[i] = std::sqrt(x[i] * x[i] + y * y);
            // Near the centre of a disc the direction from the centre says nothing about the rim.
            active[i] = box.leaves_disc[i] && length[i] > radius[i] / 2;
            na[i] = x[i] / std::max(length[i], TINY);
            nb[i] = y / std::max(length[i], TINY);
            along[i] = active[i] ? na[i] * slope[0] + nb[i] * slope[1] : 0.0;
        }
        const double cosine = na[0] * na[1] + nb[0] * nb[1], sine2 = 1 - cosine * cosine;
        // These two multipliers leave the slope no part along either unit vector.
        double multiplier[2] = {(along[0] - cosine * along[1]) / sine2,
                                (along[1] - cosine * along[0]) / sine2};
        // Only one disc gets a multiplier if not both are active or positive, or if both unit
        // vectors are nearly parallel: both multipliers would be far larger than the slope.
        if (!(active[0] && active[1] && multiplier[0] > 0 && multiplier[1] > 0 && sine2 > 1e-2)) {
            const int stronger = along[0] > along[1] ? 0 : 1;
            multiplier[stronger] = positive_part(along[stronger]);
            multiplier[1 - stronger] = 0.0;
        }
        double extra = 0.0;
        for (int i = 0; i < 2; ++i) {
            const double share = multiplier[i] / radius[i];
            extra += multiplier[i] * (radius[i] - length[i]) * (radius[i] + length[i])
                / (2 * radius[i]);
            slope[0] -= share * x[i];
            slope[1] -= share * y;
            curvature[0] -= share;
            curvature[1] -= share;
        }
        return extra;
    }

private:
    // False only if a box misses the reachable set, because it misses one of the discs or because
    // detours exclude it. square_gap(x, half) is the squared distance of 0 from x - half..x + half.
    bool meets_set(const Box& box, std::size_t cell) const {
        const auto square_gap = [](double x, double half) {
            const double gap = positive_part(std::abs(x) - half);
            return gap * gap;
        };
        const double across = square_gap(box.centre[1], box.half[1]);
        const double r1 = from_start_[cell], r2 = to_goal_[cell];
        double low[2], high[2];
        for (int i = 0; i < 2; ++i) {
            low[i] = box.centre[i] - box.half[i];
            high[i] = box.centre[i] + box.half[i];
        }
        return square_gap(box.centre[0], box.half[0]) + across <= r1 * r1
               && square_gap(box.centre[0] - distance_, box.half[0]) + across <= r2 * r2
               && (!detours_ || detours_->reaches(low, high, r1, r2));
    }

    // Whether a place is in both discs of a cell and not excluded by detours.
    bool contains(const double* place, std::size_t cell) const {
        const double x = place[0], along = x - distance_, across = place[1] * place[1];
        const double r1 = from_start_[cell], r2 = to_goal_[cell];
        return x * x + across <= r1 * r1 && along * along + across <= r2 * r2
               && (!detours_ || detours_->reaches(place, place, r1, r2));
    }

    // Whether a box reaches beyond the disc about (middle, 0).
    static bool leaves_disc(const Box& box, double middle, double radius) {
        const double x = std::abs(box.centre[0] - middle) + box.half[0];
        const double y = std::abs(box.centre[1]) + box.half[1];
        return x * x + y * y > radius * radius;
    }

    std::size_t count_;
    double distance_;
    Array<const double> from_start_, to_goal_, corner_, low_, high_;
    std::shared_ptr<const Detours> detours_;
};

}  // namespace kernel
