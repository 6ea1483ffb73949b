// Nearest points of small convex hulls and convex polygons; see limits/nearest.py.
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

// The point of the boundary of a hull, a line or a triangle, that is nearest to the origin.
Point nearest_of_hull(const Point* places, int count);

// The line between a hull, a line or a triangle, and a convex polygon.
Line separating_line(const Point* places, int count, const Point* polygon, int corners);

}  // namespace kernel
