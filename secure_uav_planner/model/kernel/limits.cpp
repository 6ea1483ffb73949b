// The limits that Python makes; limits/motion.py and limits/lines.py have their other half.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstdint>
#include <memory>
#include <optional>

#include "array.hpp"
#include "lines.hpp"
#include "norm.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::ConstrainedPairs;
using kernel::ControlPoints;
using kernel::copy_flags;
using kernel::copy_reals;
using kernel::count_entries;
using kernel::expect;
using kernel::Limit;
using kernel::LineLimit;
using kernel::Reals;

namespace {

std::vector<int> copy_indices(const py::buffer& source, const char* name) {
    const Array<const std::int64_t> numbers(source, name);
    return std::vector<int>(numbers.data(), numbers.data() + numbers.size());
}

std::vector<kernel::Point> copy_points(const py::buffer& source, const char* name,
                                       std::size_t size) {
    const Array<const double> numbers(source, name, 2 * size);
    std::vector<kernel::Point> points;
    for (std::size_t i = 0; i < size; ++i)
        points.push_back({numbers[2 * i], numbers[2 * i + 1]});
    return points;
}

std::shared_ptr<kernel::NormLimit> make_norm_limit(
    std::size_t slots, int order, const py::buffer& square, const py::buffer& ignored,
    const py::buffer& end_moves) {
    const std::size_t uavs = count_entries(square);
    expect((order == 1 || order == 2) && uavs && slots, "order, square, slots");
    return std::make_shared<kernel::NormLimit>(
        slots, order, copy_reals(square, "square", uavs),
        copy_flags(ignored, "ignored", (slots + order) * uavs),
        copy_reals(end_moves, "end_moves", 4 * uavs));
}

ControlPoints make_control_points(const py::buffer& weights, const py::buffer& all_weights,
                                  const py::buffer& constant) {
    const Array<const double> varying(weights, "weights");
    expect(varying.axes() == 4 && varying.shape(0) >= 3 && varying.shape(1) >= 1
               && varying.shape(2) >= 1 && varying.shape(2) <= 3 && varying.shape(3) == 3,
           "weights");
    const std::size_t slots = varying.shape(0) - 2, size = varying.size();
    for (std::size_t i = 0; i < size; ++i) {
        const std::ptrdiff_t slot =
            std::ptrdiff_t(i / (size / varying.shape(0))) + std::ptrdiff_t(i % 3) - 2;
        expect(varying[i] == 0.0 || (slot >= 0 && slot < std::ptrdiff_t(slots)), "weights");
    }
    return {slots, int(varying.shape(1)), int(varying.shape(2)),
            copy_reals(weights, "weights", size), copy_reals(all_weights, "all_weights", size),
            copy_reals(constant, "constant", size / 3 * 2)};
}

ConstrainedPairs make_pairs(const ControlPoints& control_points, const py::buffer& first,
                            const std::optional<py::buffer>& second, const py::buffer& ignored) {
    ConstrainedPairs pairs{copy_indices(first, "first"), {}, {}};
    if (second) pairs.second = copy_indices(*second, "second");
    expect(!second || pairs.second.size() == pairs.first.size(), "second");
    for (const std::vector<int>* uavs : {&pairs.first, &pairs.second})
        for (const int uav : *uavs)
            expect(uav >= 0 && uav < control_points.uavs, "first, second");
    pairs.ignored = copy_flags(
        ignored, "ignored",
        (control_points.slots + 2) * pairs.first.size() * control_points.controls);
    return pairs;
}

std::shared_ptr<kernel::ZoneLimit> make_zone_limit(
    const ControlPoints& control_points, const py::buffer& first, const py::buffer& ignored,
    const py::buffer& polygons) {
    ConstrainedPairs pairs = make_pairs(control_points, first, std::nullopt, ignored);
    const Array<const double> corners(polygons, "polygons");
    expect(corners.axes() == 4 && corners.shape(3) == 2 && control_points.controls >= 2,
           "polygons");
    const std::size_t uavs = corners.shape(0), zones = corners.shape(1);
    const std::size_t vertices = corners.shape(2), lines = uavs ? pairs.first.size() / uavs : 0;
    expect(vertices >= 1 && lines >= 1 && lines <= zones && uavs * lines == pairs.first.size(),
           "polygons");
    return std::make_shared<kernel::ZoneLimit>(
        control_points, pairs, copy_points(polygons, "polygons", uavs * zones * vertices),
        int(uavs), int(zones), int(vertices), int(lines));
}

std::shared_ptr<kernel::SeparationLimit> make_separation_limit(
    const ControlPoints& control_points, const py::buffer& first, const py::buffer& second,
    const py::buffer& ignored, const py::buffer& radii) {
    const ConstrainedPairs pairs = make_pairs(control_points, first, second, ignored);
    expect(control_points.controls >= 2, "control_points");
    return std::make_shared<kernel::SeparationLimit>(
        control_points, pairs, copy_reals(radii, "radii", pairs.first.size()));
}

std::shared_ptr<kernel::FenceLimit> make_fence_limit(
    const ControlPoints& control_points, const py::buffer& first, const py::buffer& ignored,
    const py::buffer& normals, const py::buffer& offsets) {
    const ConstrainedPairs pairs = make_pairs(control_points, first, std::nullopt, ignored);
    const std::size_t count = pairs.first.size();
    const std::vector<kernel::Point> directions = copy_points(normals, "normals", count);
    const Reals lengths = copy_reals(offsets, "offsets", count);
    std::vector<kernel::Line> sides;
    for (std::size_t i = 0; i < count; ++i) sides.push_back({directions[i], lengths[i]});
    return std::make_shared<kernel::FenceLimit>(control_points, pairs, std::move(sides));
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
    using py::arg;
    py::class_<Limit, std::shared_ptr<Limit>>(module, "Limit").def("evaluate", &evaluate_limit);
    py::class_<kernel::NormLimit, Limit, std::shared_ptr<kernel::NormLimit>>(module, "NormLimit")
        .def(py::init(&make_norm_limit), arg("slots"), arg("order"), arg("square"),
             arg("ignored"), arg("end_moves"));
    py::class_<ControlPoints>(module, "ControlPoints")
        .def(py::init(&make_control_points), arg("weights"), arg("all_weights"),
             arg("constant"));
    py::class_<LineLimit, Limit, std::shared_ptr<LineLimit>>(module, "LineLimit")
        .def("choose_lines", &choose_lines);
    py::class_<kernel::ZoneLimit, LineLimit, std::shared_ptr<kernel::ZoneLimit>>(
        module, "ZoneLimit")
        .def(py::init(&make_zone_limit), arg("control_points"), arg("first"), arg("ignored"),
             arg("polygons"));
    py::class_<kernel::SeparationLimit, LineLimit, std::shared_ptr<kernel::SeparationLimit>>(
        module, "SeparationLimit")
        .def(py::init(&make_separation_limit), arg("control_points"), arg("first"),
             arg("second"), arg("ignored"), arg("radii"));
    py::class_<kernel::FenceLimit, LineLimit, std::shared_ptr<kernel::FenceLimit>>(
        module, "FenceLimit")
        .def(py::init(&make_fence_limit), arg("control_points"), arg("first"), arg("ignored"),
             arg("normals"), arg("offsets"));
}
