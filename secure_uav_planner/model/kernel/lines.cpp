#include "lines.hpp"

#include <algorithm>
#include <cmath>

namespace kernel {

// The points that vary in one of all subjects' control points (M, G, K), at most six.
int LineLimit::parts(std::size_t number, Part* found) const {
    const std::size_t corner = number % tracks_.corners, piece = number / tracks_.corners;
    const std::size_t point = piece / subjects(), subject = piece % subjects();
    int count = 0;
    const auto add = [&](int track, double sign) {
        const std::size_t tracks = tracks_.uav.size();
        const double* weights =
            &tracks_.weights[((point * tracks + track) * tracks_.corners + corner) * 3];
        for (int place = 0; place < 3; ++place)
            if (weights[place] != 0.0)
                found[count++] = {std::ptrdiff_t(point) + place - 2,
                                  variable(point + place - 1, tracks_.uav[track]),
                                  sign * weights[place]};
    };
    add(tracks_.first[subject], 1.0);
    if (!tracks_.second.empty()) add(tracks_.second[subject], -1.0);
    return count;
}

int LineLimit::bandwidth() const {
    Part found[6];
    std::ptrdiff_t coupling = 0;  // How many slots apart the points of a c are.
    const int variables = 3 * uavs_;
    for (std::size_t i = 0; i < tracks_.ignored.size(); ++i) {
        const int count = parts(i, found);
        for (int one = 0; one < count; ++one)
            for (int other = 0; other < one; ++other)
                coupling = std::max(coupling, std::abs(found[one].slot - found[other].slot));
    }
    if (!tracks_.second.empty()) return int(1 + coupling) * variables - 2;
    return coupling ? int(coupling) * variables + 1 : variables - 1;
}

// The control points of the tracks around a point, (T, K).
void LineLimit::control_points(const Reals& weights, std::size_t point, const double* path,
                               Point* found) const {
    const std::size_t tracks = tracks_.uav.size();
    const int uavs = uavs_;
    const bool first = point == 0, last = point + 1 == points();
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
        const Point* first = points + tracks_.first[subject] * tracks_.corners;
        const Point* second =
            tracks_.second.empty() ? nullptr : points + tracks_.second[subject] * tracks_.corners;
        for (int corner = 0; corner < tracks_.corners; ++corner)
            *found++ = second ? first[corner] - second[corner] : first[corner];
    }
}

// Call a function for every point with the places, or the moves, of its subjects (G, K).
template <typename Function>
void LineLimit::around_points(bool moves, const double* path, Function function) const {
    const std::size_t count = tracks_.uav.size() * tracks_.corners;
    std::vector<Point> points(count), found(subjects() * tracks_.corners);
    for (std::size_t n = 0; n < this->points(); ++n) {
        control_points(moves ? tracks_.weights : tracks_.all, n, path, points.data());
        if (!moves)
            for (std::size_t i = 0; i < count; ++i) {
                points[i].x += tracks_.constant[2 * (n * count + i)];
                points[i].y += tracks_.constant[2 * (n * count + i) + 1];
            }
        subjects_of(points.data(), found.data());
        function(n, found.data());
    }
}

void LineLimit::choose(const double* path, Lines& lines) const {
    lines.of.resize(pieces());
    around_points(false, path, [&](std::size_t point, const Point* places) {
        choose_at(point, places, lines);
    });
}

void LineLimit::find_slacks(const double* path, Terms& found) const {
    found.slacks.resize(count());
    around_points(false, path, [&](std::size_t point, const Point* places) {
        std::size_t i = point * subjects() * tracks_.corners;
        for (std::size_t subject = 0; subject < subjects(); ++subject) {
            const Line& line = found.lines->of[point * subjects() + subject];
            for (int corner = 0; corner < tracks_.corners; ++corner, ++i, ++places)
                found.slacks[i] =
                    tracks_.ignored[i] ? 1.0 : dot(line.normal, *places) - line.offset;
        }
    });
}

void LineLimit::find_slopes(const Terms& here, const double* moves, Slopes& found) const {
    found.slacks.resize(count());
    Reals& moved = found.kept;
    moved.assign(here.lines->room.size(), 0.0);
    around_points(true, moves, [&](std::size_t point, const Point* moves_of) {
        std::size_t i = point * subjects() * tracks_.corners;
        for (std::size_t subject = 0; subject < subjects(); ++subject) {
            const std::size_t piece = point * subjects() + subject;
            const Line& line = here.lines->of[piece];
            for (int corner = 0; corner < tracks_.corners; ++corner, ++i, ++moves_of) {
                found.slacks[i] = tracks_.ignored[i] ? 0.0 : dot(line.normal, *moves_of);
                if (!moved.empty())
                    moved[piece] = std::max(moved[piece], std::sqrt(dot(*moves_of, *moves_of)));
            }
        }
    });
}

void LineLimit::add_gradient(const Terms& here, double mu, double* gradient) const {
    Part found[6];
    for (std::size_t i = 0; i < count(); ++i) {
        if (tracks_.ignored[i]) continue;
        const Point normal = here.lines->of[i / tracks_.corners].normal;
        const double force = mu / here.slacks[i];
        const int count = parts(i, found);
        for (int part = 0; part < count; ++part) {
            double* at = gradient + found[part].variable;
            at[0] -= force * found[part].weight * normal.x;
            at[1] -= force * found[part].weight * normal.y;
        }
    }
}

void LineLimit::shorten(const Terms& here, const Slopes& step, double share,
                        double* longest) const {
    const Reals& moved = step.kept;
    for (std::size_t subject = 0; subject < subjects(); ++subject) {
        double least = 1.0;
        for (std::size_t n = 0; n < points(); ++n) {
            const std::size_t piece = n * subjects() + subject;
            for (int corner = 0; corner < tracks_.corners; ++corner) {
                const std::size_t i = piece * tracks_.corners + corner;
                stop_at_zero(least, here.slacks[i], step.slacks[i], share);
            }
            if (moved.empty()) continue;
            const double room = share * here.lines->room[piece];
            if (moved[piece] * least > room)
                least = std::min(least, room / std::max(moved[piece], 1e-300));
        }
        double& one = longest[tracks_.uav[tracks_.first[subject]]];
        one = std::min(one, least);
        if (tracks_.second.empty()) continue;
        double& other = longest[tracks_.uav[tracks_.second[subject]]];
        other = std::min(other, least);
    }
}

// The c are linear.
void LineLimit::add_curvature(const Terms& here, const Reals& duals, const Band& band) const {
    Part found[6];
    for (std::size_t i = 0; i < count(); ++i) {
        if (tracks_.ignored[i]) continue;
        const Point normal = here.lines->of[i / tracks_.corners].normal;
        const double ratio = duals[i] / here.slacks[i];
        const double xx = ratio * normal.x * normal.x, xy = ratio * normal.x * normal.y;
        const double yy = ratio * normal.y * normal.y;
        const int count = parts(i, found);
        for (int one = 0; one < count; ++one)
            for (int other = 0; other < count; ++other) {
                if (found[one].variable < found[other].variable) continue;
                const double by = found[one].weight * found[other].weight;
                band.add(found[one].variable, found[other].variable, by * xx, by * xy, by * yy);
            }
    }
}

}  // namespace kernel
