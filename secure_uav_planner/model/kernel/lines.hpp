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

// The pieces of the curves of G pairs, each of a UAV and an obstacle, or of two UAVs whose
// difference counts: K control points around each of M points.
struct Pieces {
    Vectors control_points;     // (M, G, K).
    std::vector<char> ignored;  // Control points that do not vary, (M, G, K).
    std::size_t pairs;
    int controls;
};

// c = normal . p - offset of every control point p, with the same line for all of a piece.
//
// Lines are chosen before every step, and stay during its line search.
class LineLimit : public Limit {
public:
    explicit LineLimit(const Pieces& pieces)
        : Limit(pieces.control_points, pieces.ignored, {}), pairs_(pieces.pairs),
          controls_(pieces.controls) {}

    int controls() const { return controls_; }
    bool has_lines() const override { return true; }

    void choose_lines(const double* path, LineSet& lines) const override {
        std::vector<Point> points;
        vectors().find(path, false, points);
        lines.lines.resize(count());
        for (std::size_t first = 0; first < count(); first += pairs_ * controls_)
            choose_lines_at(first, &points[first], lines);
    }

protected:
    // Choose the lines of the pieces around a point, (G, K), of which the first vector is given.
    virtual void choose_lines_at(std::size_t first, const Point* pieces, LineSet& lines) const = 0;
    // Set the line of a piece, of which the first vector is given.
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

// How far points are beyond a line.
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
    void choose_lines_at(std::size_t first, const Point*, LineSet& lines) const override {
        for (std::size_t pair = 0; pair < pairs_; ++pair)
            set_line(first + pair * controls_, sides_[pair], lines);
    }

private:
    std::vector<Line> sides_;  // (G).
};

// The vector from the nearest point of an edge to a point.
inline Point subtract_edge(Point begin, Point end, Point point) {
    const Point along = end - begin, offset = point - begin;
    const double square = std::max(dot(along, along), TINY);
    const double share = std::min(std::max(dot(offset, along) / square, 0.0), 1.0);
    return offset - share * along;
}

// Tangents of the discs that differences of UAVs stay out of.
class SeparationLimit : public LineLimit {
public:
    SeparationLimit(const Pieces& pieces, Reals radii)
        : LineLimit(pieces), radii_(std::move(radii)) {}

protected:
    void choose_lines_at(std::size_t first, const Point* pieces, LineSet& lines) const override {
        for (std::size_t pair = 0; pair < pairs_; ++pair) {
            const Point* piece = pieces + pair * controls_;
            Point direction = find_nearest(piece, controls_);
            // Where the piece contains the origin, its middle gives as good a direction as any.
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

    // Find the point of the boundary of a line or triangle that is nearest to the origin.
    static Point find_nearest(const Point* piece, int count) {
        Point nearest{};
        double least = INFINITE;
        for (int k = 0; k < (count == 2 ? 1 : count); ++k) {
            const Point to_origin = subtract_edge(piece[k], piece[(k + 1) % count], {0.0, 0.0});
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
    // The polygons are (A, Z, V), counter-clockwise; the last vertex may be repeated. Of each of
    // the A UAVs there are as many pairs, one for a line, that follow each other.
    ZoneLimit(const Pieces& pieces, std::vector<Point> polygons, int zoned_uavs, int zones,
              int vertices)
        : LineLimit(pieces), polygons_(std::move(polygons)), zoned_uavs_(zoned_uavs),
          zones_(zones), vertices_(vertices), lines_(int(pieces.pairs) / zoned_uavs) {
        for (std::size_t i = 0; i < polygons_.size(); i += vertices_)
            centres_.push_back(mean_point(&polygons_[i], vertices_));
    }

protected:
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
                // Sorted again by number, so that duals stay with their zones.
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
    // Beyond this many lengths of a piece, and this distance, the line need not be exact.
    static constexpr double NEAR = 4.0, LEAST_NEAR = 1e-3;
    static constexpr double TOUCHING = 1e-9;  // Nearer points have no direction between them.

    // Find the line between a piece and a polygon, and the piece's distance beyond it. It is exact
    // if the piece is near, else perpendicular to the way from the polygon's centre.
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

    // Find the tangent of a polygon that leaves a piece farthest on the other side: its normal is
    // the vector between the nearest points. Where they overlap, find the one beyond which the
    // piece must be moved least.
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
                compare(subtract_edge(polygon[v], polygon[(v + 1) % vertices_], piece[k]));
        for (int k = 0; k < count; ++k)
            for (int v = 0; v < vertices_; ++v)
                compare(-1.0 * subtract_edge(piece[k], piece[(k + 1) % count], polygon[v]));
        Line line;
        const double inverse = 1.0 / std::sqrt(std::max(least, TINY));
        line.normal = inverse * nearest;
        line.offset = max_projection(polygon, vertices_, line.normal);
        if (find_clearance(piece, count, line) > TOUCHING) return line;
        return minimise_shift(piece, polygon);
    }

    // Find the line along an edge of either that needs the least shift of the piece.
    Line minimise_shift(const Point* piece, const Point* polygon) const {
        Line best{{0.0, 0.0}, 0.0};
        double most = -INFINITE;
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
        for (int k = 0; k < count; ++k) compare(piece[(k + 1) % count] - piece[k]);
        for (int k = 0; k < count; ++k) compare(piece[k] - piece[(k + 1) % count]);
        return best;
    }

    std::vector<Point> polygons_, centres_;  // (A, Z, V), (A, Z).
    int zoned_uavs_, zones_, vertices_, lines_;
};

}  // namespace kernel
