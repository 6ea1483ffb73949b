#include "nearest.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace kernel {

namespace {

constexpr double TOUCHING = 1e-9;  // Nearer than this, a difference of places has no direction.

// The vector from an edge to a point.
Point from_edge(Point begin, Point end, Point to) {
    const Point along = end - begin, offset = to - begin;
    const double square = std::max(dot(along, along), 1e-300);
    const double share = std::min(std::max(dot(offset, along) / square, 0.0), 1.0);
    return offset - share * along;
}

// The best of the lines along edges of the polygon and the hull.
Line least_shift(const Point* places, int count, const Point* polygon, int corners) {
    Line best{{0.0, 0.0}, 0.0};
    double most = -std::numeric_limits<double>::infinity();
    const auto try_along = [&](Point along) {
        const double length = std::sqrt(dot(along, along));
        const double over = 1.0 / std::max(length, 1e-300);
        const Point normal{along.y * over, -along.x * over};
        const double offset = farthest(polygon, corners, normal);
        const double least = length <= 1e-12 ? -std::numeric_limits<double>::infinity()
            : nearest(places, count, normal) - offset;
        if (!(least > most)) return;
        best = {normal, offset};
        most = least;
    };
    for (int v = 0; v < corners; ++v) try_along(polygon[(v + 1) % corners] - polygon[v]);
    for (int k = 0; k < count; ++k) try_along(places[(k + 1) % count] - places[k]);
    for (int k = 0; k < count; ++k) try_along(places[k] - places[(k + 1) % count]);
    return best;
}

}  // namespace

double farthest(const Point* points, int count, Point direction) {
    double most = dot(points[0], direction);
    for (int i = 1; i < count; ++i) most = std::max(most, dot(points[i], direction));
    return most;
}

double nearest(const Point* points, int count, Point direction) {
    double least = dot(points[0], direction);
    for (int i = 1; i < count; ++i) least = std::min(least, dot(points[i], direction));
    return least;
}

Point nearest_of_hull(const Point* places, int count) {
    Point best{};
    double least = std::numeric_limits<double>::infinity();
    for (int k = 0; k < (count == 2 ? 1 : count); ++k) {
        const Point to_origin = from_edge(places[k], places[(k + 1) % count], {0.0, 0.0});
        const double square = dot(to_origin, to_origin);
        if (square >= least) continue;
        least = square;
        best = -1.0 * to_origin;
    }
    return best;
}

Line separating_line(const Point* places, int count, const Point* polygon, int corners) {
    Point best{};
    double square = std::numeric_limits<double>::infinity();
    const auto try_way = [&](Point way) {
        const double length = dot(way, way);
        if (length >= square) return;
        square = length;
        best = way;
    };
    for (int v = 0; v < corners; ++v)
        for (int k = 0; k < count; ++k)
            try_way(from_edge(polygon[v], polygon[(v + 1) % corners], places[k]));
    for (int k = 0; k < count; ++k)
        for (int v = 0; v < corners; ++v)
            try_way(-1.0 * from_edge(places[k], places[(k + 1) % count], polygon[v]));
    Line line;
    const double over = 1.0 / std::sqrt(std::max(square, 1e-300));
    line.normal = over * best;
    line.offset = farthest(polygon, corners, line.normal);
    if (nearest(places, count, line.normal) - line.offset > TOUCHING) return line;
    return least_shift(places, count, polygon, corners);
}

}  // namespace kernel
