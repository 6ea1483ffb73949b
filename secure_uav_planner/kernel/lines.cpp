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

// The control points of the tracks around a point, (T, K).
void LineLimit::control_points(const Reals& weights, std::size_t point, const double* path,
                               int uavs, Point* found) const {
    const std::size_t tracks = tracks_.uav.size();
    const bool first = point == 0, last = point + 1 == std::size_t(tracks_.points);
    for (std::size_t track = 0; track < tracks; ++track) {
        const double* at = path + 2 * (point * uavs + tracks_.uav[track]);
        const Point here{at[0], at[1]};
        const Point before = first ? Point{} : Point{at[-2 * uavs], at[-2 * uavs + 1]};
        const Point after = last ? Point{} : Point{at[2 * uavs], at[2 * uavs + 1]};
        const double* by = &weights[(point * tracks + track) * tracks_.corners * 3];
        for (int corner = 0; corner < tracks_.corners; ++corner, by += 3)
            *found++ = {by[1] * here.x + by[0] * before.x + by[2] * after.x,
                        by[1] * here.y + by[0] * before.y + by[2] * after.y};
    }
}

// What lines are about around a point, (G, K), of the tracks' control points.
void LineLimit::subjects_of(const Point* points, Point* found) const {
    for (std::size_t subject = 0; subject < subjects(); ++subject) {
        const Point* first = points + first_[subject] * tracks_.corners;
        const Point* second =
            second_.empty() ? nullptr : points + second_[subject] * tracks_.corners;
        for (int corner = 0; corner < tracks_.corners; ++corner)
            *found++ = second ? first[corner] - second[corner] : first[corner];
    }
}

// Call a function for every point with the places, or the moves, of its subjects (G, K).
template <typename Function>
void LineLimit::around_points(bool moves, const double* path, int uavs,
                              Function function) const {
    const std::size_t count = tracks_.uav.size() * tracks_.corners;
    std::vector<Point> points(count), found(subjects() * tracks_.corners);
    for (std::size_t n = 0; n < std::size_t(tracks_.points); ++n) {
        control_points(moves ? tracks_.weights : tracks_.all, n, path, uavs, points.data());
        if (!moves)
            for (std::size_t i = 0; i < count; ++i) {
                points[i].x += tracks_.constant[2 * (n * count + i)];
                points[i].y += tracks_.constant[2 * (n * count + i) + 1];
            }
        subjects_of(points.data(), found.data());
        function(n, found.data());
    }
}

void LineLimit::choose(const double* path, int uavs, Lines& lines) const {
    lines.of.resize(tracks_.points * subjects());
    around_points(false, path, uavs, [&](std::size_t point, const Point* places) {
        choose_at(point, places, lines);
    });
}

void LineLimit::margins(const Lines& lines, const double* path, int uavs, Reals& c) const {
    c.resize(entries());
    around_points(false, path, uavs, [&](std::size_t point, const Point* places) {
        std::size_t i = point * subjects() * tracks_.corners;
        for (std::size_t subject = 0; subject < subjects(); ++subject) {
            const Line& line = lines.of[point * subjects() + subject];
            for (int corner = 0; corner < tracks_.corners; ++corner, ++i, ++places)
                c[i] = ignored_[i] ? 1.0 : dot(line.normal, *places) - line.offset;
        }
    });
}

void LineLimit::change(const Lines& lines, const double* path, int uavs, Reals& change,
                       Reals& moved) const {
    change.resize(entries());
    moved.assign(lines.room.size(), 0.0);
    around_points(true, path, uavs, [&](std::size_t point, const Point* moves) {
        std::size_t i = point * subjects() * tracks_.corners;
        for (std::size_t subject = 0; subject < subjects(); ++subject) {
            const std::size_t piece = point * subjects() + subject;
            const Line& line = lines.of[piece];
            for (int corner = 0; corner < tracks_.corners; ++corner, ++i, ++moves) {
                change[i] = ignored_[i] ? 0.0 : dot(line.normal, *moves);
                if (!moved.empty())
                    moved[piece] = std::max(moved[piece], std::sqrt(dot(*moves, *moves)));
            }
        }
    });
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
