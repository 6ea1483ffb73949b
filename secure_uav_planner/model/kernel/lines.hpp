// Limits that keep pieces of curves on one side of lines: zones, fence and separation.
//
// A convex obstacle is cleared by a convex piece when a line separates them. See limits/lines.py.
#pragma once

#include <cmath>
#include <numeric>
#include <utility>

#include "limit.hpp"
#include "numbers.hpp"

namespace kernel {

// The pieces of curves of G pairs, one piece of K control points around each of M points. A pair is
// a UAV and an obstacle, a UAV and a side of the fence, or two UAVs. The curve of two UAVs is the
// difference of their positions.
struct Pieces {
    Vectors control_points;     // (M, G, K).
    std::vector<char> ignored;  // Control points that do not vary, (M, G, K).
    std::size_t pairs;
    int controls;
};

// c = normal . p - offset for every control point p. All control points of a piece share a line.
//
// Lines are chosen before every step and are kept during its line search.
class LineLimit : public Limit {
public:
    explicit LineLimit(const Pieces& pieces)
        : Limit(pieces.control_points, pieces.ignored, {}), pairs_(pieces.pairs),
          controls_(pieces.controls) {}

    int controls() const { return controls_; }
    bool has_lines() const override { return true; }

    // Choose a line for each piece of the curves on a path, (M, U, 2), which separates the piece
    // from what it must clear. lines.lines, (M, G, K), has a piece's line K times.
    void choose_lines(const double* path, LineSet& lines) const override {
        std::vector<Point> points;
        vectors().compute_vectors(path, false, points);
        lines.lines.resize(count());
        for (std::size_t first = 0; first < count(); first += pairs_ * controls_)
            choose_lines_at(first, &points[first], lines);
    }

protected:
    // Choose the lines of the G pieces around one point, whose control points are `pieces`, (G, K).
    // `first` is the index of the first of these control points among all.
    virtual void choose_lines_at(std::size_t first, const Point* pieces, LineSet& lines) const = 0;
    // Set the line of a piece. `first` is the index of the piece's first control point among all.
    void set_line(std::size_t first, const Line& line, LineSet& lines) const {
        std::fill_n(lines.lines.begin() + first, controls_, line);
    }

    const std::size_t pairs_;
    const int controls_;
};

// The largest projection of points on a direction.
inline double max_projection(const Point* points, int count, Point direction) {
    double most = dot(points[0], direction);
    for (int i = 1; i < count; ++i) most = std::max(most, dot(points[i], direction));
    return most;
}

// The distance of the nearest of several points beyond a line; negative if it is on the other side.
inline double find_clearance(const Point* points, int count, const Line& line) {
    return -max_projection(points, count, -1.0 * line.normal) - line.offset;
}

inline Point mean_point(const Point* points, int count) {
    Point sum{0.0, 0.0};
    for (int k = 0; k < count; ++k) sum = {sum.x + points[k].x, sum.y + points[k].y};
    return {sum.x / count, sum.y / count};
}

// The sides of the convex hull of the fence, the same for all points.
class FenceLimit : public LineLimit {
public:
    FenceLimit(const Pieces& pieces, std::vector<Line> sides)
        : LineLimit(pieces), sides_(std::move(sides)) {}

protected:
    // Set every pair's line to its side of the fence, which does not depend on the piece.
    void choose_lines_at(std::size_t first, const Point*, LineSet& lines) const override {
        for (std::size_t pair = 0; pair < pairs_; ++pair)
            set_line(first + pair * controls_, sides_[pair], lines);
    }

private:
    std::vector<Line> sides_;  // (G).
};

// Return the vector to a point from the nearest point of the edge begin-end.
inline Point vector_from_edge(Point begin, Point end, Point point) {
    const Point along = end - begin, offset = point - begin;
    const double square = std::max(dot(along, along), TINY);
    const double scale = std::min(std::max(dot(offset, along) / square, 0.0), 1.0);
    return offset - scale * along;
}

// Tangents of the discs that differences of UAVs stay out of.
class SeparationLimit : public LineLimit {
public:
    SeparationLimit(const Pieces& pieces, Reals radii)
        : LineLimit(pieces), radii_(std::move(radii)) {}

protected:
    // Set every pair's line to a tangent of the disc around the origin with the pair's radius. A
    // piece, the difference of two UAVs' curves, must be outside of the disc. The tangent's normal
    // points from the origin to the nearest point of the piece's edges.
    void choose_lines_at(std::size_t first, const Point* pieces, LineSet& lines) const override {
        for (std::size_t pair = 0; pair < pairs_; ++pair) {
            const Point* piece = pieces + pair * controls_;
            Point direction = find_nearest(piece, controls_);
            // If the origin is on the piece's edge, the piece's middle gives the direction.
            if (!(std::sqrt(dot(direction, direction)) > ZERO_LENGTH))
                direction = mean_point(piece, controls_);
            const double length = std::sqrt(dot(direction, direction));
            const Point normal = length > ZERO_LENGTH
                ? Point{direction.x / length, direction.y / length} : Point{1.0, 0.0};
            set_line(first + pair * controls_, {normal, radii_[pair]}, lines);
        }
    }

private:
    static constexpr double ZERO_LENGTH = 1e-12;  // A shorter vector has no direction.

    // Find the point nearest to the origin on a piece's edges: of a segment, or of a polygon.
    static Point find_nearest(const Point* piece, int count) {
        Point nearest{};
        double least = INFINITE;
        for (int k = 0; k < (count == 2 ? 1 : count); ++k) {
            const Point to_origin = vector_from_edge(piece[k], piece[(k + 1) % count], {0.0, 0.0});
            const double square = dot(to_origin, to_origin);
            if (square >= least) continue;
            least = square;
            nearest = -1.0 * to_origin;
        }
        return nearest;
    }

    Reals radii_;  // (G).
};

// Lines to the nearest of Z convex polygons for each of A UAVs.
class ZoneLimit : public LineLimit {
public:
    // `polygons` (A, Z, V) are the zones of A UAVs, counter-clockwise; the last vertex may be
    // repeated. The G pairs are sorted by UAV; G / A pairs and lines belong to each UAV.
    ZoneLimit(const Pieces& pieces, std::vector<Point> polygons, int zoned_uavs, int zones,
              int vertices)
        : LineLimit(pieces), polygons_(std::move(polygons)), zoned_uavs_(zoned_uavs),
          zones_(zones), vertices_(vertices), lines_(int(pieces.pairs) / zoned_uavs) {
        for (std::size_t i = 0; i < polygons_.size(); i += vertices_)
            centres_.push_back(mean_point(&polygons_[i], vertices_));
    }

protected:
    // Set each UAV's lines to tangents of the zones nearest to its piece, which its pairs share.
    // With more zones than lines, also set lines.max_moves to the clearance of the nearest zone
    // without a line: no step may reach it.
    void choose_lines_at(std::size_t first, const Point* pieces, LineSet& lines) const override {
        std::vector<Line> candidates(zones_);
        Reals clearances(zones_);
        std::vector<int> order(zones_);
        if (zones_ > lines_) lines.max_moves.resize(lines.lines.size());
        for (int uav = 0; uav < zoned_uavs_; ++uav) {
            const std::size_t begin = std::size_t(uav) * lines_ * controls_;
            const Point* piece = pieces + begin;
            const Point middle = mean_point(piece, controls_);
            const Point size = piece[controls_ - 1] - piece[0];
            const double near = NEAR * std::sqrt(dot(size, size)) + LEAST_NEAR;
            for (int zone = 0; zone < zones_; ++zone)
                candidates[zone] = find_line(piece, middle, near,
                                             std::size_t(uav) * zones_ + zone, clearances[zone]);
            std::iota(order.begin(), order.end(), 0);
            if (zones_ > lines_) {
                // The nearest zones are sorted by number, so that duals stay with their zones.
                std::stable_sort(order.begin(), order.end(), [&](int i, int j) {
                    return clearances[i] < clearances[j];
                });
                std::fill_n(lines.max_moves.begin() + first + begin, lines_ * controls_,
                            clearances[order[lines_]]);
                std::sort(order.begin(), order.begin() + lines_);
            }
            for (int line = 0; line < lines_; ++line)
                set_line(first + begin + line * controls_, candidates[order[line]], lines);
        }
    }

private:
    // Distance up to which a line is exact: NEAR lengths of the piece plus LEAST_NEAR.
    static constexpr double NEAR = 4.0, LEAST_NEAR = 1e-3;
    static constexpr double TOUCHING = 1e-9;  // Least distance of points that gives a direction.

    // Return a tangent of a polygon with the piece on its other side, and set `clearance` to the
    // piece's least distance beyond it, which is negative if they overlap. A cheap tangent is tried
    // first: its normal points from the polygon's centre to the piece's middle. With a clearance
    // below `near`, the tangent with the largest clearance, by `separate`, is returned instead.
    Line find_line(const Point* piece, Point middle, double near, std::size_t polygon,
                   double& clearance) const {
        const Point* vertices = &polygons_[polygon * vertices_];
        const Point way = middle - centres_[polygon];
        const double length = std::sqrt(std::max(dot(way, way), TINY));
        Line line;
        line.normal = {way.x / length, way.y / length};
        line.offset = max_projection(vertices, vertices_, line.normal);
        clearance = find_clearance(piece, controls_, line);
        if (!(clearance < near)) return line;
        line = separate(piece, vertices);
        clearance = find_clearance(piece, controls_, line);
        return line;
    }

    // Return the tangent of a convex polygon that separates it with the largest clearance from a
    // piece, the convex hull of K <= 3 control points. The tangent's normal is the shortest vector
    // from the polygon to the piece, found over all pairs of an edge of one and a vertex of the
    // other. If both overlap or touch, return the tangent that needs the least shift of the piece.
    Line separate(const Point* piece, const Point* polygon) const {
        Point nearest{};
        double least = INFINITE;
        const auto compare = [&](Point way) {
            const double square = dot(way, way);
            if (square >= least) return;
            least = square;
            nearest = way;
        };
        const int count = controls_;
        for (int v = 0; v < vertices_; ++v)
            for (int k = 0; k < count; ++k)
                compare(vector_from_edge(polygon[v], polygon[(v + 1) % vertices_], piece[k]));
        for (int k = 0; k < count; ++k)
            for (int v = 0; v < vertices_; ++v)
                compare(-1.0 * vector_from_edge(piece[k], piece[(k + 1) % count], polygon[v]));
        Line line;
        const double inverse = 1.0 / std::sqrt(std::max(least, TINY));
        line.normal = inverse * nearest;
        line.offset = max_projection(polygon, vertices_, line.normal);
        if (find_clearance(piece, count, line) > TOUCHING) return line;
        return minimise_shift(piece, polygon);
    }

    // Return the line that separates overlapping piece and polygon after the least shift: of the
    // polygon's tangents parallel to an edge of piece or polygon, the tangent with the largest
    // clearance, which is minus the shift.
    Line minimise_shift(const Point* piece, const Point* polygon) const {
        Line best{{0.0, 0.0}, 0.0};
        double most = -INFINITE;  // The clearance of `best`.
        const auto compare = [&](Point along) {
            const double length = std::sqrt(dot(along, along));
            if (length <= 1e-12) return;
            const double inverse = 1.0 / length;
            Line line{{along.y * inverse, -along.x * inverse}, 0.0};
            line.offset = max_projection(polygon, vertices_, line.normal);
            const double clearance = find_clearance(piece, controls_, line);
            if (!(clearance > most)) return;
            best = line;
            most = clearance;
        };
        const int count = controls_;
        for (int v = 0; v < vertices_; ++v) compare(polygon[(v + 1) % vertices_] - polygon[v]);
        // The piece may be clockwise, so both normals of its edges are tried.
        for (int k = 0; k < count; ++k) compare(piece[(k + 1) % count] - piece[k]);
        for (int k = 0; k < count; ++k) compare(piece[k] - piece[(k + 1) % count]);
        return best;
    }

    std::vector<Point> polygons_, centres_;  // (A, Z, V), (A, Z).
    int zoned_uavs_, zones_, vertices_, lines_;
};

}  // namespace kernel
