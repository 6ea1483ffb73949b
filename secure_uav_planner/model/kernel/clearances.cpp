#include "clearances.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace kernel {

namespace {

// Farther than this many lengths of a piece, and this much, a line across the way will do.
constexpr double NEAR = 4.0, LEAST = 1e-3;
constexpr double SHORT = 1e-12;  // A vector that has no direction.

Point mean(const Point* places, int count) {
    Point sum{0.0, 0.0};
    for (int k = 0; k < count; ++k) sum = {sum.x + places[k].x, sum.y + places[k].y};
    return {sum.x / count, sum.y / count};
}

}  // namespace

void FenceLimit::choose_at(std::size_t point, const Point*, Lines& lines) const {
    std::copy(sides_.begin(), sides_.end(), lines.of.begin() + point * subjects());
}

void SeparationLimit::choose_at(std::size_t point, const Point* places, Lines& lines) const {
    for (std::size_t subject = 0; subject < subjects(); ++subject) {
        const Point* piece = places + subject * corners();
        Point away = nearest_of_hull(piece, corners());
        // Where the origin is within the piece, away from its middle is as good as any.
        if (!(std::sqrt(dot(away, away)) > SHORT)) away = mean(piece, corners());
        const double length = std::sqrt(dot(away, away));
        const Point normal = length > SHORT ? Point{away.x / length, away.y / length}
                                            : Point{1.0, 0.0};
        lines.of[point * subjects() + subject] = {normal, radii_[subject]};
    }
}

ZoneLimit::ZoneLimit(Tracks tracks, std::vector<Point> polygons, int concerned, int most,
                     int vertices, int lines)
    : LineLimit(std::move(tracks)), polygons_(std::move(polygons)), concerned_(concerned),
      most_(most), vertices_(vertices), lines_(lines) {
    for (std::size_t i = 0; i < polygons_.size(); i += vertices_)
        centres_.push_back(mean(&polygons_[i], vertices_));
}

// The line between a piece and a polygon: exact if it is near, else across the way from the
// polygon's centre. `least` is how far the piece is beyond it.
Line ZoneLimit::line_to(const Point* places, Point middle, double near, std::size_t polygon,
                        double& least) const {
    const Point* corners_of = &polygons_[polygon * vertices_];
    const Point to = middle - centres_[polygon];
    const double length = std::sqrt(std::max(dot(to, to), 1e-300));
    Line line;
    line.normal = {to.x / length, to.y / length};
    line.offset = farthest(corners_of, vertices_, line.normal);
    least = nearest(places, corners(), line.normal) - line.offset;
    if (!(least < near)) return line;
    line = separating_line(places, corners(), corners_of, vertices_);
    least = nearest(places, corners(), line.normal) - line.offset;
    return line;
}

void ZoneLimit::choose_at(std::size_t point, const Point* places, Lines& lines) const {
    std::vector<Line> found(most_);
    Reals least(most_);
    std::vector<int> order(most_);
    if (most_ > lines_) lines.room.resize(lines.of.size());
    for (int uav = 0; uav < concerned_; ++uav) {
        const std::size_t subject = std::size_t(uav) * lines_;
        const Point* piece = places + subject * corners();
        const Point middle = mean(piece, corners()), size = piece[corners() - 1] - piece[0];
        const double near = NEAR * std::sqrt(dot(size, size)) + LEAST;
        for (int zone = 0; zone < most_; ++zone)
            found[zone] = line_to(piece, middle, near, std::size_t(uav) * most_ + zone,
                                  least[zone]);
        std::iota(order.begin(), order.end(), 0);
        const std::size_t to = point * subjects() + subject;
        if (most_ > lines_) {
            // The nearest, in the order in which they are, so that duals stay with them.
            std::stable_sort(order.begin(), order.end(),
                             [&](int one, int other) { return least[one] < least[other]; });
            std::fill_n(lines.room.begin() + to, lines_, least[order[lines_]]);
            std::sort(order.begin(), order.begin() + lines_);
        }
        for (int line = 0; line < lines_; ++line) lines.of[to + line] = found[order[line]];
    }
}

}  // namespace kernel
