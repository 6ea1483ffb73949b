// Vectors d that are weighted sums of a few points of flights: their moves, the changes of these,
// and control points of curves.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace kernel {

using Reals = std::vector<double>;

struct Point {
    double x, y;
};

inline double dot(Point a, Point b) { return a.x * b.x + a.y * b.y; }
inline Point operator+(Point a, Point b) { return {a.x + b.x, a.y + b.y}; }
inline Point operator-(Point a, Point b) { return {a.x - b.x, a.y - b.y}; }
inline Point operator*(double factor, Point a) { return {factor * a.x, factor * a.y}; }

// The lower triangle of a symmetric band matrix in the variables x (N, U, 3).
struct Band {
    double* entries;  // Column by column, each from the diagonal down.
    int height;       // Entries of a column.

    // Add the block (xx, xy; xy, yy) at rows `row` and row + 1 of columns `column` and column + 1,
    // which are x and y of two points with row >= column. Entries above the diagonal are left out.
    void add(std::ptrdiff_t row, std::ptrdiff_t column, double xx, double xy, double yy) const {
        double* at = entries + column * height + row - column;
        at[0] += xx;
        at[1] += xy;
        if (row > column) at[height - 1] += xy;
        at[height] += yy;
    }
};

// I vectors, computed from a path or from the moves of its points along a step. Paths and moves are
// (M, U, 2) for M = N + 2 points, in the units of a Grid. First and last points are fixed; moves of
// fixed points are zero.
class Vectors {
public:
    struct Term {
        int point, uav;           // The point's index n U + u in a path, and u.
        std::ptrdiff_t variable;  // The index in x of the point's x coordinate; -1 if it is fixed.
        double weight;
    };

    // `varies` (M, U): which points vary. `points` (I, T), as n U + u, with `weights` (I, T): first
    // points of one UAV, then, if at all, of another. `constants` (I): added to the vectors.
    // `differences`: whether weights of each UAV in a vector add up to 0. Weights 0 are left out.
    Vectors(int uavs, const std::vector<char>& varies, const std::vector<int>& points,
            const Reals& weights, std::vector<Point> constants, bool differences)
        : uavs_(uavs), slots_(varies.size() / uavs - 2), constants_(std::move(constants)),
          differences_(differences), ends_{0} {
        const std::size_t width = points.size() / count();
        for (std::size_t first = 0; first < points.size(); first += width) {
            std::size_t end = terms_.size();  // The end of the first UAV's terms.
            for (std::size_t t = first; t < first + width; ++t) {
                if (weights[t] == 0.0) continue;
                const int uav = points[t] % uavs;
                const std::ptrdiff_t variable = 3 * std::ptrdiff_t(points[t] - uavs) + 1;
                terms_.push_back({points[t], uav, varies[points[t]] ? variable : -1, weights[t]});
                if (uav == points[first] % uavs) end = terms_.size();
            }
            ends_.insert(ends_.end(), {end, terms_.size()});
        }
    }

    std::size_t count() const { return constants_.size(); }
    std::size_t slots() const { return slots_; }
    bool fits(std::size_t slots, std::size_t uavs) const {
        return slots == slots_ && uavs == std::size_t(uavs_);
    }

    // The number of rows below the diagonal that second derivatives by x fill: the largest
    // difference of the indices in x of two points of one vector, and 1 more for y.
    int bandwidth() const {
        std::ptrdiff_t farthest = 0;
        for (std::size_t i = 0; i < count(); ++i)
            for_pairs(i, [&](const Term& later, const Term& earlier) {
                farthest = std::max(farthest, later.variable - earlier.variable);
            });
        return int(farthest) + 1;
    }

    // Fill the I `vectors` of a path, (M, U, 2): constant + sum of weight * point. If `moves` is
    // set, the path has the points' moves instead, and the constants are left out. If the weights
    // of a UAV add up to 0 (differences_), its middle point is subtracted, so no digits cancel.
    void compute_vectors(const double* path, bool moves, std::vector<Point>& vectors) const {
        const auto locate = [&](std::size_t t) {
            return Point{path[2 * terms_[t].point], path[2 * terms_[t].point + 1]};
        };
        const auto add_up = [&](std::size_t begin, std::size_t end) {
            if (begin == end) return Point{0.0, 0.0};
            const Point middle = differences_ ? locate((begin + end) / 2) : Point{0.0, 0.0};
            Point sum{0.0, 0.0};
            for (std::size_t t = begin; t < end; ++t)
                sum = sum + terms_[t].weight * (locate(t) - middle);
            return sum;
        };
        vectors.resize(count());
        for (std::size_t i = 0; i < count(); ++i) {
            vectors[i] = add_up(ends_[2 * i], ends_[2 * i + 1])
                + add_up(ends_[2 * i + 1], ends_[2 * i + 2]);
            if (!moves) vectors[i] = vectors[i] + constants_[i];
        }
    }

    // Add to `gradient`, (N, U, 3), a function's gradient by x, given its gradient by vector i.
    void add_gradient(std::size_t i, Point slope, double* gradient) const {
        for_terms(i, [&](const Term& term) {
            if (term.variable < 0) return;
            gradient[term.variable] += term.weight * slope.x;
            gradient[term.variable + 1] += term.weight * slope.y;
        });
    }

    // Add to the band a function's Hessian by x, given its Hessian (xx, xy; xy, yy) by vector i.
    void add_curvature(std::size_t i, double xx, double xy, double yy, const Band& band) const {
        for_pairs(i, [&](const Term& later, const Term& earlier) {
            const double weight = later.weight * earlier.weight;
            band.add(later.variable, earlier.variable, weight * xx, weight * xy, weight * yy);
        });
    }

    // Call a function with every term of a vector.
    template <typename Function>
    void for_terms(std::size_t i, Function function) const {
        for (std::size_t t = ends_[2 * i]; t < ends_[2 * i + 2]; ++t) function(terms_[t]);
    }

private:
    // Call function(later, earlier) with every pair of vector i's terms whose points vary and whose
    // indices in x are later >= earlier. A term is paired with itself, too.
    template <typename Function>
    void for_pairs(std::size_t i, Function function) const {
        for_terms(i, [&](const Term& later) {
            for_terms(i, [&](const Term& earlier) {
                if (earlier.variable >= 0 && later.variable >= earlier.variable)
                    function(later, earlier);
            });
        });
    }

    const int uavs_;
    const std::size_t slots_;
    const std::vector<Point> constants_;  // (I).
    const bool differences_;
    std::vector<Term> terms_;
    // Ends in `terms_`: a 0, then for every vector the end of its first UAV's terms and the end of
    // all its terms, (2 I + 1).
    std::vector<std::size_t> ends_;
};

}  // namespace kernel
