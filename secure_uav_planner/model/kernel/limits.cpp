// The limits that Python makes; limits/motion.py and limits/lines.py have their other half.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>

#include "array.hpp"
#include "lines.hpp"
#include "norm.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::copy_flags;
using kernel::copy_reals;
using kernel::count_entries;
using kernel::expect;
using kernel::Limit;
using kernel::LineLimit;
using kernel::Reals;

namespace {

std::vector<int> copy_indices(const py::dict& args, const char* name, std::size_t size,
                              int end) {
    const Reals numbers = copy_reals(args, name, size);
    for (const double number : numbers) expect(number >= 0.0 && number < end, name);
    return std::vector<int>(numbers.begin(), numbers.end());
}

std::vector<kernel::Point> copy_points(const py::dict& args, const char* name,
                                       std::size_t size) {
    const Reals numbers = copy_reals(args, name, 2 * size);
    std::vector<kernel::Point> points;
    for (std::size_t i = 0; i < size; ++i)
        points.push_back({numbers[2 * i], numbers[2 * i + 1]});
    return points;
}

std::shared_ptr<kernel::NormLimit> make_norm_limit(const py::dict& args) {
    const std::size_t uavs = count_entries(args, "square");
    const std::size_t slots = args["slots"].cast<std::size_t>();
    const int order = args["order"].cast<int>();
    expect((order == 1 || order == 2) && uavs && slots, "order, square, slots");
    return std::make_shared<kernel::NormLimit>(
        slots, order, copy_reals(args, "square", uavs),
        copy_flags(args, "ignored", (slots + order) * uavs),
        copy_reals(args, "end_moves", 4 * uavs));
}

kernel::Tracks make_tracks(const py::dict& args) {
    kernel::Tracks made;
    made.slots = args["slots"].cast<std::size_t>();
    made.uavs = args["uavs"].cast<int>();
    made.controls = args["controls"].cast<int>();
    expect(made.uavs >= 1 && made.controls >= 1 && made.controls <= 3, "uavs, controls");
    const std::size_t subjects = count_entries(args, "first");
    const std::size_t points = made.slots + 2, size = points * made.uavs * made.controls;
    made.weights = copy_reals(args, "weights", 3 * size);
    made.all_weights = copy_reals(args, "all_weights", 3 * size);
    made.constant = copy_reals(args, "constant", 2 * size);
    for (std::size_t i = 0; i < made.weights.size(); ++i) {
        const std::ptrdiff_t slot =
            std::ptrdiff_t(i / (3 * made.uavs * made.controls)) + std::ptrdiff_t(i % 3) - 2;
        expect(made.weights[i] == 0.0 || (slot >= 0 && slot < std::ptrdiff_t(made.slots)),
               "weights");
    }
    made.first = copy_indices(args, "first", subjects, made.uavs);
    if (!args["second"].is_none())
        made.second = copy_indices(args, "second", subjects, made.uavs);
    made.ignored = copy_flags(args, "ignored", points * subjects * made.controls);
    return made;
}

std::shared_ptr<kernel::ZoneLimit> make_zone_limit(const py::dict& args) {
    kernel::Tracks tracks = make_tracks(args);
    const Array<const double> polygons(args["polygons"].cast<py::buffer>(), "polygons");
    expect(polygons.axes() == 4 && polygons.shape(3) == 2 && tracks.controls >= 2, "polygons");
    const std::size_t uavs = polygons.shape(0), zones = polygons.shape(1);
    const std::size_t vertices = polygons.shape(2), subjects = tracks.first.size();
    const std::size_t lines = uavs ? subjects / uavs : 0;
    expect(vertices >= 1 && lines >= 1 && lines <= zones && uavs * lines == subjects, "polygons");
    return std::make_shared<kernel::ZoneLimit>(
        std::move(tracks), copy_points(args, "polygons", uavs * zones * vertices), int(uavs),
        int(zones), int(vertices), int(lines));
}

std::shared_ptr<kernel::SeparationLimit> make_separation_limit(const py::dict& args) {
    kernel::Tracks tracks = make_tracks(args);
    const std::size_t subjects = tracks.first.size();
    expect(tracks.controls >= 2 && tracks.second.size() == subjects, "second");
    return std::make_shared<kernel::SeparationLimit>(
        std::move(tracks), copy_reals(args, "radii", subjects));
}

std::shared_ptr<kernel::FenceLimit> make_fence_limit(const py::dict& args) {
    kernel::Tracks tracks = make_tracks(args);
    const std::size_t subjects = tracks.first.size();
    const std::vector<kernel::Point> normals = copy_points(args, "normals", subjects);
    const Reals offsets = copy_reals(args, "offsets", subjects);
    std::vector<kernel::Line> sides;
    for (std::size_t i = 0; i < subjects; ++i) sides.push_back({normals[i], offsets[i]});
    return std::make_shared<kernel::FenceLimit>(std::move(tracks), std::move(sides));
}

void choose_lines(const LineLimit& limit, const py::buffer& path, const py::buffer& normals,
                  const py::buffer& offsets) {
    const Array<const double> points(path, "path");
    expect(points.axes() == 3 && points.shape(2) == 2
               && limit.fits(points.shape(0) - 2, int(points.shape(1))), "path");
    const Array<double> normal(normals, "normals", 2 * limit.pieces());
    const Array<double> offset(offsets, "offsets", limit.pieces());
    kernel::LineSet set;
    limit.choose_lines(points.data(), set);
    for (std::size_t i = 0; i < set.lines.size(); ++i) {
        normal[2 * i] = set.lines[i].normal.x;
        normal[2 * i + 1] = set.lines[i].normal.y;
        offset[i] = set.lines[i].offset;
    }
}

// Evaluate all methods of a limit for a path and moves of its points: for tests.
py::dict evaluate_limit(const Limit& limit, const py::buffer& path, const py::buffer& moves,
                        double fraction) {
    const Array<const double> point(path, "path"), move(moves, "moves");
    expect(point.axes() == 3 && point.shape(2) == 2, "path");
    const std::size_t slots = point.shape(0) - 2, uavs = point.shape(1), size = 3 * uavs * slots;
    expect(limit.fits(slots, int(uavs)) && move.size() == point.size(), "path, moves");
    kernel::LineSet lines;
    kernel::Slacks slacks;
    kernel::Slopes slopes;
    limit.choose_lines(point.data(), lines);
    slacks.lines = &lines;
    limit.find_slacks(point.data(), slacks);
    limit.find_slopes(slacks, move.data(), slopes);
    Reals lengths(uavs, 1.0), gradient(size), duals(slacks.values);
    limit.limit_steps(slacks, slopes, fraction, lengths.data());
    limit.add_gradient(slacks, 1.0, gradient.data());
    for (double& dual : duals) dual = 1.0 / dual;
    const int height = limit.bandwidth() + 1;
    Reals band((size + height) * height);
    limit.add_curvature(slacks, duals, {band.data(), height});
    double slope = 0.0, curvature = 0.0;
    Reals x(size + height);
    for (std::size_t i = 0; i < slots * uavs; ++i)
        for (int axis = 0; axis < 2; ++axis)
            x[3 * i + 1 + axis] = move[2 * (i + uavs) + axis];
    for (std::size_t column = 0; column < size; ++column) {
        slope += gradient[column] * x[column];
        for (int down = 0; down < height; ++down)
            curvature += (down ? 2.0 : 1.0) * band[column * height + down] * x[column]
                * x[column + down];
    }
    py::dict answer;
    answer["slacks"] = slacks.values;
    answer["slopes"] = slopes.values;
    answer["lengths"] = lengths;
    answer["slope"] = slope;
    answer["curvature"] = curvature;
    answer["limits_moves"] = !lines.max_moves.empty();
    return answer;
}

}  // namespace

void add_limits(py::module_& module) {
    py::class_<Limit, std::shared_ptr<Limit>>(module, "Limit").def("evaluate", &evaluate_limit);
    py::class_<kernel::NormLimit, Limit, std::shared_ptr<kernel::NormLimit>>(
        module, "NormLimit").def(py::init(&make_norm_limit));
    py::class_<LineLimit, Limit, std::shared_ptr<LineLimit>>(module, "LineLimit")
        .def("choose_lines", &choose_lines);
    py::class_<kernel::ZoneLimit, LineLimit, std::shared_ptr<kernel::ZoneLimit>>(
        module, "ZoneLimit").def(py::init(&make_zone_limit));
    py::class_<kernel::SeparationLimit, LineLimit, std::shared_ptr<kernel::SeparationLimit>>(
        module, "SeparationLimit").def(py::init(&make_separation_limit));
    py::class_<kernel::FenceLimit, LineLimit, std::shared_ptr<kernel::FenceLimit>>(
        module, "FenceLimit").def(py::init(&make_fence_limit));
}
