// Nearest points of small convex hulls and convex polygons.
#pragma once

namespace kernel {

struct Point {
    double x, y;
};

inline double dot(Point one, Point other) { return one.x * other.x + one.y * other.y; }
inline Point operator-(Point one, Point other) { return {one.x - other.x, one.y - other.y}; }
inline Point operator*(double by, Point one) { return {by * one.x, by * one.y}; }

// A line normal . place = offset.
struct Line {
    Point normal;
    double offset;
};

// How far points reach in a direction, at most and at least.
double farthest(const Point* points, int count, Point direction);
double nearest(const Point* points, int count, Point direction);

// The point of a hull, a line or a triangle, that is nearest to the origin; where a triangle
// contains the origin, the nearest of its boundary.
Point nearest_of_hull(const Point* places, int count);

// A line between a hull, a line or a triangle, and a convex polygon, whose vertices are
// counter-clockwise; the last may be repeated.
//
// It touches the polygon, and of all lines that do it leaves the hull farthest on the other side:
// the normal is that between the nearest points, away from the polygon. Where they overlap, it is
// the line beyond which the hull must be moved least.
Line separating_line(const Point* places, int count, const Point* polygon, int corners);

}  // namespace kernel
