// Limits that keep pieces of curves on one side of lines; see limits/lines.py.
#pragma once

#include <cstddef>
#include <utility>

#include "nearest.hpp"
#include "reals.hpp"

namespace kernel {

// Lines of G subjects around M = N + 2 points.
struct Lines {
    std::vector<Line> of;  // (M, G).
    Reals room;            // How far a piece may move at most, (M, G), or empty.
};

// The control points of pieces of curves, T tracks of K points each; see limits/tracks.py.
struct Tracks {
    int points = 0, corners = 0;    // M, K.
    std::vector<int> uav;           // (T).
    Reals weights, all, constant;   // (M, T, K, 3), (M, T, K, 3), (M, T, K, 2).
};

// c = normal . p - offset of every control point p of G subjects.
class LineLimit {
public:
    explicit LineLimit(Tracks tracks) : tracks_(std::move(tracks)) {}
    virtual ~LineLimit() = default;

    // Of what each subject is made: the track of one UAV, or that less the one of another.
    void set_subjects(std::vector<int> first, std::vector<int> second,
                      std::vector<char> ignored);
    // How many rows below the diagonal its terms reach, with 3 U variables in a slot.
    int below(int variables) const;
    std::size_t entries() const { return ignored_.size(); }  // M * G * K.

    // Choose lines for a path (M, U, 2).
    void choose(const double* path, int uavs, Lines& lines) const;
    // Find c (M, G, K) of a path.
    void margins(const Lines& lines, const double* path, int uavs, Reals& c) const;
    // Subtract mu / c dc/dx from a gradient (N, U, 3).
    void add_gradient(const Lines& lines, const Reals& c, double mu, double* gradient,
                      int uavs) const;
    // Find the change of c by a step whose path (M, U, 2) is given, and how far pieces move
    // (M, G), where there is a room.
    void change(const Lines& lines, const double* path, int uavs, Reals& change,
                Reals& moved) const;
    // Lower how far every UAV may go along the step, (U).
    void longest_step(const Lines& lines, const Reals& c, const Reals& change,
                      const Reals& moved, double share, double* longest) const;
    // Add dual / c (dc/dx)(dc/dx)^T to a band; see newton.BandMatrix.
    void add_curvature(const Lines& lines, const Reals& c, const Reals& dual, double* band,
                       int height, int uavs) const;

protected:
    // Choose the lines around a point; places (G, K) are the subjects' control points.
    virtual void choose_at(std::size_t point, const Point* places, Lines& lines) const = 0;
    std::size_t subjects() const { return first_.size(); }
    int corners() const { return tracks_.corners; }

private:
    // A point that a control point is made of, by its slot and UAV.
    struct Part {
        std::ptrdiff_t slot;
        int uav;
        double weight;
    };

    int parts(std::size_t point, std::size_t subject, int corner, Part* found) const;
    void control_points(const Reals& weights, std::size_t point, const double* path, int uavs,
                        Point* found) const;
    void subjects_of(const Point* points, Point* found) const;
    template <typename Function>
    void around_points(bool moves, const double* path, int uavs, Function function) const;

    Tracks tracks_;
    std::vector<int> first_, second_;  // (G), or empty.
    std::vector<char> ignored_;        // (M, G, K).
};

}  // namespace kernel
