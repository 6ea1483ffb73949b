#include "lines.hpp"

#include <algorithm>
#include <cmath>

namespace kernel {

void LineLimit::set_subjects(std::vector<int> first, std::vector<int> second,
                             std::vector<char> ignored) {
    first_ = std::move(first);
    second_ = std::move(second);
    ignored_ = std::move(ignored);
}

// The points that vary in a control point of a subject, at most six.
int LineLimit::parts(std::size_t point, std::size_t subject, int corner, Part* found) const {
    int count = 0;
    const auto add = [&](int track, double sign) {
        const std::size_t tracks = tracks_.uav.size();
        const double* weights =
            &tracks_.weights[((point * tracks + track) * tracks_.corners + corner) * 3];
        for (int place = 0; place < 3; ++place)
            if (weights[place] != 0.0)
                found[count++] = {std::ptrdiff_t(point) + place - 2, tracks_.uav[track],
                                  sign * weights[place]};
    };
    add(first_[subject], 1.0);
    if (!second_.empty()) add(second_[subject], -1.0);
    return count;
}

int LineLimit::below(int variables) const {
    Part found[6];
    std::ptrdiff_t reach = 0;
    for (std::size_t i = 0; i < ignored_.size(); ++i) {
        const std::size_t piece = i / tracks_.corners;
        const int count = parts(piece / subjects(), piece % subjects(),
                                int(i % tracks_.corners), found);
        for (int one = 0; one < count; ++one)
            for (int other = 0; other < one; ++other)
                reach = std::max(reach, std::abs(found[one].slot - found[other].slot));
    }
    if (!second_.empty()) return int(1 + reach) * variables - 2;
    return reach ? int(reach) * variables + 1 : variables - 1;
}

Point LineLimit::track_at(const Reals& weights, std::size_t point, int track, int corner,
                          const double* path, int uavs) const {
    const std::size_t i = (point * tracks_.uav.size() + track) * tracks_.corners + corner;
    const double* by = &weights[3 * i];
    const double* at = path + 2 * (point * uavs + tracks_.uav[track]);
    Point found{by[1] * at[0], by[1] * at[1]};
    if (point > 0) {
        found.x += by[0] * at[-2 * uavs];
        found.y += by[0] * at[-2 * uavs + 1];
    }
    if (point + 1 < std::size_t(tracks_.points)) {
        found.x += by[2] * at[2 * uavs];
        found.y += by[2] * at[2 * uavs + 1];
    }
    return found;
}

Point LineLimit::place(std::size_t point, std::size_t subject, int corner, const double* path,
                       int uavs) const {
    const auto at = [&](int track) {
        Point found = track_at(tracks_.all, point, track, corner, path, uavs);
        const double* constant = &tracks_.constant[
            ((point * tracks_.uav.size() + track) * tracks_.corners + corner) * 2];
        return Point{found.x + constant[0], found.y + constant[1]};
    };
    const Point found = at(first_[subject]);
    return second_.empty() ? found : found - at(second_[subject]);
}

Point LineLimit::moved_by(std::size_t point, std::size_t subject, int corner,
                          const double* path, int uavs) const {
    const Reals& weights = tracks_.weights;
    const Point found = track_at(weights, point, first_[subject], corner, path, uavs);
    return second_.empty() ? found
        : found - track_at(weights, point, second_[subject], corner, path, uavs);
}

void LineLimit::choose(const double* path, int uavs, Lines& lines) const {
    std::vector<Point> places(subjects() * tracks_.corners);
    lines.of.resize(tracks_.points * subjects());
    for (std::size_t n = 0; n < std::size_t(tracks_.points); ++n) {
        for (std::size_t i = 0; i < places.size(); ++i)
            places[i] = place(n, i / tracks_.corners, int(i % tracks_.corners), path, uavs);
        choose_at(n, places.data(), lines);
    }
}

void LineLimit::margins(const Lines& lines, const double* path, int uavs, Reals& c) const {
    c.resize(entries());
    for (std::size_t i = 0; i < c.size(); ++i) {
        const std::size_t piece = i / tracks_.corners;
        const Line& line = lines.of[piece];
        c[i] = ignored_[i] ? 1.0
            : dot(line.normal, place(piece / subjects(), piece % subjects(),
                                     int(i % tracks_.corners), path, uavs)) - line.offset;
    }
}

void LineLimit::add_gradient(const Lines& lines, const Reals& c, double mu, double* gradient,
                             int uavs) const {
    Part found[6];
    for (std::size_t i = 0; i < c.size(); ++i) {
        if (ignored_[i]) continue;
        const std::size_t piece = i / tracks_.corners;
        const Point normal = lines.of[piece].normal;
        const double force = mu / c[i];
        const int count = parts(piece / subjects(), piece % subjects(),
                                int(i % tracks_.corners), found);
        for (int part = 0; part < count; ++part) {
            double* at = gradient + 3 * (found[part].slot * uavs + found[part].uav);
            at[1] -= force * found[part].weight * normal.x;
            at[2] -= force * found[part].weight * normal.y;
        }
    }
}

void LineLimit::change(const Lines& lines, const double* path, int uavs, Reals& change,
                       Reals& moved) const {
    change.resize(entries());
    moved.assign(lines.room.size(), 0.0);
    for (std::size_t i = 0; i < change.size(); ++i) {
        const std::size_t piece = i / tracks_.corners;
        const Point by = moved_by(piece / subjects(), piece % subjects(),
                                  int(i % tracks_.corners), path, uavs);
        change[i] = ignored_[i] ? 0.0 : dot(lines.of[piece].normal, by);
        if (!moved.empty()) moved[piece] = std::max(moved[piece], std::sqrt(dot(by, by)));
    }
}

void LineLimit::longest_step(const Lines& lines, const Reals& c, const Reals& change,
                             const Reals& moved, double share, double* longest) const {
    for (std::size_t subject = 0; subject < subjects(); ++subject) {
        double least = 1.0;
        for (std::size_t n = 0; n < std::size_t(tracks_.points); ++n) {
            const std::size_t piece = n * subjects() + subject;
            for (int corner = 0; corner < tracks_.corners; ++corner) {
                const std::size_t i = piece * tracks_.corners + corner;
                const double most = share * c[i];
                if (-change[i] * least > most) least = most / -change[i];
            }
            if (moved.empty()) continue;
            const double room = share * lines.room[piece];
            if (moved[piece] * least > room)
                least = std::min(least, room / std::max(moved[piece], 1e-300));
        }
        double& one = longest[tracks_.uav[first_[subject]]];
        one = std::min(one, least);
        if (second_.empty()) continue;
        double& other = longest[tracks_.uav[second_[subject]]];
        other = std::min(other, least);
    }
}

void LineLimit::add_curvature(const Lines& lines, const Reals& c, const Reals& dual,
                              double* band, int height, int uavs) const {
    Part found[6];
    for (std::size_t i = 0; i < c.size(); ++i) {
        if (ignored_[i]) continue;
        const std::size_t piece = i / tracks_.corners;
        const Point normal = lines.of[piece].normal;
        const double ratio = dual[i] / c[i];
        const double xx = ratio * normal.x * normal.x, xy = ratio * normal.x * normal.y;
        const double yy = ratio * normal.y * normal.y;
        const int count = parts(piece / subjects(), piece % subjects(),
                                int(i % tracks_.corners), found);
        for (int one = 0; one < count; ++one)
            for (int other = 0; other < count; ++other) {
                const std::ptrdiff_t row = 3 * (found[one].slot * uavs + found[one].uav) + 1;
                const std::ptrdiff_t column =
                    3 * (found[other].slot * uavs + found[other].uav) + 1;
                if (row < column) continue;
                const double by = found[one].weight * found[other].weight;
                double* at = band + column * height + row - column;
                at[0] += by * xx;
                at[1] += by * xy;
                if (row > column) at[height - 1] += by * xy;
                at[height] += by * yy;
            }
    }
}

}  // namespace kernel
