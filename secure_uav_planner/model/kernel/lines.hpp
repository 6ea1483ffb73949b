// Limits that keep pieces of curves on one side of lines; see limits/lines.py.
//
// A convex obstacle is cleared by a convex piece when a line separates them.
#pragma once

#include <cstddef>
#include <utility>

#include "limit.hpp"

namespace kernel {

// The control points of pieces of curves, T tracks of K points each, and what G subjects are made
// of: the track of one UAV, or that less the one of another; see limits/tracks.py.
struct Tracks {
    std::size_t slots = 0;             // N = M - 2.
    int uavs = 0, corners = 0;         // U, K.
    std::vector<int> uav;              // (T).
    Reals weights, all, constant;      // (M, T, K, 3), (M, T, K, 3), (M, T, K, 2).
    std::vector<int> first, second;    // Tracks of every subject, (G), or empty.
    std::vector<char> ignored;         // Control points that do not vary, (M, G, K).
};

// c = normal . p - offset of every control point p of G subjects; 1 where p does not vary.
//
// Lines are chosen anew for every step, and stay during its line search.
class LineLimit : public Limit {
public:
    explicit LineLimit(Tracks tracks)
        : Limit(tracks.slots, tracks.uavs), tracks_(std::move(tracks)) {}

    std::size_t pieces() const { return points() * subjects(); }  // M * G.

    std::size_t count() const override { return tracks_.ignored.size(); }  // M * G * K.
    int bandwidth() const override;
    bool chooses() const override { return true; }
    void choose(const double* path, Lines& lines) const override;
    void find_slacks(const double* path, Terms& found) const override;
    void add_gradient(const Terms& here, double mu, double* gradient) const override;
    // Keeps how far pieces move (M, G), where there is a room.
    void find_slopes(const Terms& here, const double* moves, Slopes& found) const override;
    void shorten(const Terms& here, const Slopes& step, double share,
                 double* longest) const override;
    void add_curvature(const Terms& here, const Reals& duals, const Band& band) const override;

protected:
    // Choose the lines around a point; places (G, K) are the subjects' control points.
    virtual void choose_at(std::size_t point, const Point* places, Lines& lines) const = 0;
    std::size_t points() const { return slots_ + 2; }
    std::size_t subjects() const { return tracks_.first.size(); }
    int corners() const { return tracks_.corners; }

private:
    // A point that a control point is made of.
    struct Part {
        std::ptrdiff_t slot, variable;
        double weight;
    };

    int parts(std::size_t number, Part* found) const;
    void control_points(const Reals& weights, std::size_t point, const double* path,
                        Point* found) const;
    void subjects_of(const Point* points, Point* found) const;
    template <typename Function>
    void around_points(bool moves, const double* path, Function function) const;

    Tracks tracks_;
};

}  // namespace kernel
