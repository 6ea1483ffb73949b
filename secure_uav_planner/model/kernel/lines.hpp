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

// The K control points of each UAV's piece of the curve around each of M = N + 2 points.
struct ControlPoints {
    std::size_t slots;                     // N.
    int uavs, controls;                    // U, K.
    Reals weights, all_weights, constant;  // (M, U, K, 3), (M, U, K, 3), (M, U, K, 2).
};

// G pairs of a UAV and an obstacle, or of two UAVs whose difference counts.
struct ConstrainedPairs {
    std::vector<int> first, second;  // The UAVs, (G); `second` is empty for obstacles.
    std::vector<char> ignored;       // Control points that do not vary, (M, G, K).
};

// c = normal . p - offset of every control point p of G pairs; 1 where p does not vary.
//
// Lines are chosen before every step, and stay during its line search.
class LineLimit : public Limit {
public:
    LineLimit(ControlPoints control_points, ConstrainedPairs pairs)
        : Limit(control_points.slots, control_points.uavs),
          control_points_(std::move(control_points)), pairs_(std::move(pairs)) {}

    std::size_t pieces() const { return points() * pairs(); }  // M * G.

    std::size_t count() const override { return pairs_.ignored.size(); }  // M * G * K.
    bool has_lines() const override { return true; }

    int bandwidth() const override {
        Term terms[6];
        std::ptrdiff_t coupling = 0;  // The distance in slots between points of the same c.
        const int variables = 3 * uavs_;
        for (std::size_t i = 0; i < pairs_.ignored.size(); ++i) {
            const int count = find_terms(i, terms);
            for (int j = 0; j < count; ++j)
                for (int k = 0; k < j; ++k)
                    coupling = std::max(coupling, std::abs(terms[j].slot - terms[k].slot));
        }
        if (!pairs_.second.empty()) return int(1 + coupling) * variables - 2;
        return coupling ? int(coupling) * variables + 1 : variables - 1;
    }

    void choose_lines(const double* path, LineSet& lines) const override {
        lines.lines.resize(pieces());
        visit_points(false, path, [&](std::size_t point, const Point* places) {
            choose_lines_at(point, places, lines);
        });
    }

    void find_slacks(const double* path, Slacks& slacks) const override {
        slacks.values.resize(count());
        visit_points(false, path, [&](std::size_t point, const Point* places) {
            std::size_t i = point * pairs() * controls();
            for (std::size_t pair = 0; pair < pairs(); ++pair) {
                const Line& line = slacks.lines->lines[point * pairs() + pair];
                for (int k = 0; k < controls(); ++k, ++i, ++places)
                    slacks.values[i] =
                        pairs_.ignored[i] ? 1.0 : dot(line.normal, *places) - line.offset;
            }
        });
    }

    void add_gradient(const Slacks& slacks, double mu, double* gradient) const override {
        Term terms[6];
        for (std::size_t i = 0; i < count(); ++i) {
            if (pairs_.ignored[i]) continue;
            const Point normal = slacks.lines->lines[i / controls()].normal;
            const double force = mu / slacks.values[i];
            const int count = find_terms(i, terms);
            for (int j = 0; j < count; ++j) {
                double* at = gradient + terms[j].variable;
                at[0] -= force * terms[j].weight * normal.x;
                at[1] -= force * terms[j].weight * normal.y;
            }
        }
    }

    // Where moves are limited, cache how far the pieces move, (M, G).
    void find_slopes(const Slacks& slacks, const double* moves, Slopes& slopes) const override {
        slopes.values.resize(count());
        Reals& lengths = slopes.cache;
        lengths.assign(slacks.lines->max_moves.size(), 0.0);
        visit_points(true, moves, [&](std::size_t point, const Point* move) {
            std::size_t i = point * pairs() * controls();
            for (std::size_t pair = 0; pair < pairs(); ++pair) {
                const std::size_t piece = point * pairs() + pair;
                const Line& line = slacks.lines->lines[piece];
                for (int k = 0; k < controls(); ++k, ++i, ++move) {
                    slopes.values[i] = pairs_.ignored[i] ? 0.0 : dot(line.normal, *move);
                    if (!lengths.empty())
                        lengths[piece] = std::max(lengths[piece], std::sqrt(dot(*move, *move)));
                }
            }
        });
    }

    void limit_steps(const Slacks& slacks, const Slopes& slopes, double fraction,
                     double* lengths) const override {
        const Reals& moves = slopes.cache;
        for (std::size_t pair = 0; pair < pairs(); ++pair) {
            double length = 1.0;
            for (std::size_t n = 0; n < points(); ++n) {
                const std::size_t piece = n * pairs() + pair;
                for (int k = 0; k < controls(); ++k) {
                    const std::size_t i = piece * controls() + k;
                    limit_step(length, slacks.values[i], slopes.values[i], fraction);
                }
                if (moves.empty()) continue;
                const double most = fraction * slacks.lines->max_moves[piece];
                if (moves[piece] * length > most)
                    length = std::min(length, most / std::max(moves[piece], TINY));
            }
            for (const std::vector<int>* members : {&pairs_.first, &pairs_.second}) {
                if (members->empty()) continue;
                double& own = lengths[(*members)[pair]];
                own = std::min(own, length);
            }
        }
    }

    // The c are linear.
    void add_curvature(const Slacks& slacks, const Reals& duals,
                       const Band& band) const override {
        Term terms[6];
        for (std::size_t i = 0; i < count(); ++i) {
            if (pairs_.ignored[i]) continue;
            const Point normal = slacks.lines->lines[i / controls()].normal;
            const double ratio = duals[i] / slacks.values[i];
            const double xx = ratio * normal.x * normal.x, xy = ratio * normal.x * normal.y;
            const double yy = ratio * normal.y * normal.y;
            const int count = find_terms(i, terms);
            for (int j = 0; j < count; ++j)
                for (int k = 0; k < count; ++k) {
                    if (terms[j].variable < terms[k].variable) continue;
                    const double weight = terms[j].weight * terms[k].weight;
                    band.add(terms[j].variable, terms[k].variable, weight * xx, weight * xy,
                             weight * yy);
                }
        }
    }

protected:
    // Choose the lines around a point; places (G, K) are the pairs' control points.
    virtual void choose_lines_at(std::size_t point, const Point* places, LineSet& lines) const = 0;
    std::size_t points() const { return slots_ + 2; }
    std::size_t pairs() const { return pairs_.first.size(); }
    int controls() const { return control_points_.controls; }

private:
    // The weight of a point that varies in a control point.
    struct Term {
        std::ptrdiff_t slot, variable;
        double weight;
    };

    // Find the at most six terms of a pair's control point, by its index in (M, G, K).
    int find_terms(std::size_t index, Term* terms) const {
        const std::size_t control = index % controls(), piece = index / controls();
        const std::size_t point = piece / pairs(), pair = piece % pairs();
        int count = 0;
        const auto add = [&](int uav, double sign) {
            const double* weights =
                &control_points_.weights[((point * uavs_ + uav) * controls() + control) * 3];
            for (int k = 0; k < 3; ++k)
                if (weights[k] != 0.0)
                    terms[count++] = {std::ptrdiff_t(point) + k - 2,
                                      variable(point + k - 1, uav), sign * weights[k]};
        };
        add(pairs_.first[pair], 1.0);
        if (!pairs_.second.empty()) add(pairs_.second[pair], -1.0);
        return count;
    }

    // Find the control points of the UAVs around a point, (U, K).
    void find_control_points(const Reals& weights, std::size_t point, const double* path,
                             Point* places) const {
        const int uavs = uavs_;
        const bool first = point == 0, last = point + 1 == points();
        for (int uav = 0; uav < uavs; ++uav) {
            const double* at = path + 2 * (point * uavs + uav);
            const Point here{at[0], at[1]};
            const Point before = first ? Point{} : Point{at[-2 * uavs], at[-2 * uavs + 1]};
            const Point after = last ? Point{} : Point{at[2 * uavs], at[2 * uavs + 1]};
            const double* weight = &weights[(point * uavs + uav) * controls() * 3];
            for (int k = 0; k < controls(); ++k, weight += 3)
                *places++ = {weight[1] * here.x + weight[0] * before.x + weight[2] * after.x,
                             weight[1] * here.y + weight[0] * before.y + weight[2] * after.y};
        }
    }

    // Call a function for every point with the places, or the moves, of its pairs, (G, K).
    template <typename Function>
    void visit_points(bool moves, const double* path, Function function) const {
        const std::size_t count = std::size_t(uavs_) * controls();
        std::vector<Point> points(count), places(pairs() * controls());
        for (std::size_t n = 0; n < this->points(); ++n) {
            find_control_points(
                moves ? control_points_.weights : control_points_.all_weights, n, path, points.data());
            if (!moves)
                for (std::size_t i = 0; i < count; ++i) {
                    points[i].x += control_points_.constant[2 * (n * count + i)];
                    points[i].y += control_points_.constant[2 * (n * count + i) + 1];
                }
            Point* place = places.data();
            for (std::size_t pair = 0; pair < pairs(); ++pair) {
                const Point* first = &points[pairs_.first[pair] * controls()];
                const Point* second = pairs_.second.empty()
                    ? nullptr : &points[pairs_.second[pair] * controls()];
                for (int k = 0; k < controls(); ++k)
                    *place++ = second ? first[k] - second[k] : first[k];
            }
            function(n, places.data());
        }
    }

    const ControlPoints control_points_;
    const ConstrainedPairs pairs_;
};

// The largest and the smallest projection of points on a direction.
inline double max_projection(const Point* points, int count, Point direction) {
    double most = dot(points[0], direction);
    for (int i = 1; i < count; ++i) most = std::max(most, dot(points[i], direction));
    return most;
}

inline double min_projection(const Point* points, int count, Point direction) {
    double least = dot(points[0], direction);
    for (int i = 1; i < count; ++i) least = std::min(least, dot(points[i], direction));
    return least;
}

inline Point mean_point(const Point* points, int count) {
    Point sum{0.0, 0.0};
    for (int k = 0; k < count; ++k) sum = {sum.x + points[k].x, sum.y + points[k].y};
    return {sum.x / count, sum.y / count};
}

// The sides of the convex hull of the fence, the same for all points.
class FenceLimit : public LineLimit {
public:
    FenceLimit(const ControlPoints& control_points, const ConstrainedPairs& pairs,
               std::vector<Line> sides)
        : LineLimit(control_points, pairs), sides_(std::move(sides)) {}

protected:
    void choose_lines_at(std::size_t point, const Point*, LineSet& lines) const override {
        std::copy(sides_.begin(), sides_.end(), lines.lines.begin() + point * pairs());
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
    SeparationLimit(const ControlPoints& control_points, const ConstrainedPairs& pairs,
                    Reals radii)
        : LineLimit(control_points, pairs), radii_(std::move(radii)) {}

protected:
    void choose_lines_at(std::size_t point, const Point* places, LineSet& lines) const override {
        for (std::size_t pair = 0; pair < pairs(); ++pair) {
            const Point* piece = places + pair * controls();
            Point direction = find_nearest(piece, controls());
            // Where the piece contains the origin, its middle gives as good a direction as any.
            if (!(std::sqrt(dot(direction, direction)) > ZERO_LENGTH))
                direction = mean_point(piece, controls());
            const double length = std::sqrt(dot(direction, direction));
            const Point normal = length > ZERO_LENGTH
                ? Point{direction.x / length, direction.y / length} : Point{1.0, 0.0};
            lines.lines[point * pairs() + pair] = {normal, radii_[pair]};
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
    // The polygons are (A, Z, V), counter-clockwise; the last vertex may be repeated. Each piece
    // has `lines` lines.
    ZoneLimit(const ControlPoints& control_points, const ConstrainedPairs& pairs,
              std::vector<Point> polygons, int zoned_uavs, int zones, int vertices, int lines)
        : LineLimit(control_points, pairs), polygons_(std::move(polygons)), zoned_uavs_(zoned_uavs),
          zones_(zones), vertices_(vertices), lines_(lines) {
        for (std::size_t i = 0; i < polygons_.size(); i += vertices_)
            centres_.push_back(mean_point(&polygons_[i], vertices_));
    }

protected:
    void choose_lines_at(std::size_t point, const Point* places, LineSet& lines) const override {
        std::vector<Line> candidates(zones_);
        Reals clearances(zones_);
        std::vector<int> order(zones_);
        if (zones_ > lines_) lines.max_moves.resize(lines.lines.size());
        for (int uav = 0; uav < zoned_uavs_; ++uav) {
            const std::size_t pair = std::size_t(uav) * lines_;
            const Point* piece = places + pair * controls();
            const Point middle = mean_point(piece, controls());
            const Point size = piece[controls() - 1] - piece[0];
            const double near = NEAR * std::sqrt(dot(size, size)) + LEAST_NEAR;
            for (int zone = 0; zone < zones_; ++zone)
                candidates[zone] = find_line(piece, middle, near,
                                             std::size_t(uav) * zones_ + zone, clearances[zone]);
            std::iota(order.begin(), order.end(), 0);
            const std::size_t to = point * pairs() + pair;
            if (zones_ > lines_) {
                // Sorted again by number, so that duals stay with their zones.
                std::stable_sort(order.begin(), order.end(), [&](int i, int j) {
                    return clearances[i] < clearances[j];
                });
                std::fill_n(lines.max_moves.begin() + to, lines_, clearances[order[lines_]]);
                std::sort(order.begin(), order.begin() + lines_);
            }
            for (int line = 0; line < lines_; ++line)
                lines.lines[to + line] = candidates[order[line]];
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
        clearance = min_projection(piece, controls(), line.normal) - line.offset;
        if (!(clearance < near)) return line;
        line = separate(piece, vertices);
        clearance = min_projection(piece, controls(), line.normal) - line.offset;
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
        const int count = controls();
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
        if (min_projection(piece, count, line.normal) - line.offset > TOUCHING) return line;
        return minimise_shift(piece, polygon);
    }

    // Find the line along an edge of either that needs the least shift of the piece.
    Line minimise_shift(const Point* piece, const Point* polygon) const {
        Line best{{0.0, 0.0}, 0.0};
        double most = -INFINITE;
        const auto compare = [&](Point along) {
            const double length = std::sqrt(dot(along, along));
            const double inverse = 1.0 / std::max(length, TINY);
            const Point normal{along.y * inverse, -along.x * inverse};
            const double offset = max_projection(polygon, vertices_, normal);
            const double clearance = length <= 1e-12 ? -INFINITE
                : min_projection(piece, controls(), normal) - offset;
            if (!(clearance > most)) return;
            best = {normal, offset};
            most = clearance;
        };
        const int count = controls();
        for (int v = 0; v < vertices_; ++v) compare(polygon[(v + 1) % vertices_] - polygon[v]);
        for (int k = 0; k < count; ++k) compare(piece[(k + 1) % count] - piece[k]);
        for (int k = 0; k < count; ++k) compare(piece[k] - piece[(k + 1) % count]);
        return best;
    }

    std::vector<Point> polygons_, centres_;  // (A, Z, V), (A, Z).
    int zoned_uavs_, zones_, vertices_, lines_;
};

}  // namespace kernel
