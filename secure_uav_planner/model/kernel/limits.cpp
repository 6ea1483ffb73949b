// Constructors of limits and of the cost of energy, for Python; model/limits calls them.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstdint>
#include <memory>

#include "array.hpp"
#include "energy.hpp"
#include "lines.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::copy_flags;
using kernel::copy_reals;
using kernel::count_entries;
using kernel::Energies;
using kernel::expect;
using kernel::FenceLimit;
using kernel::Limit;
using kernel::LineLimit;
using kernel::Pieces;
using kernel::Point;
using kernel::Reals;
using kernel::SeparationLimit;
using kernel::Vectors;
using kernel::ZoneLimit;

namespace {

std::vector<int> copy_indices(const py::buffer& source, const char* name) {
    const Array<const std::int64_t> numbers(source, name);
    return std::vector<int>(numbers.data(), numbers.data() + numbers.size());
}

// Copy an array of `size` points (x, y).
std::vector<Point> copy_points(const py::buffer& source, const char* name, std::size_t size) {
    const Array<const double> numbers(source, name, 2 * size);
    std::vector<Point> points;
    for (std::size_t i = 0; i < size; ++i)
        points.push_back({numbers[2 * i], numbers[2 * i + 1]});
    return points;
}

// Check Python's arguments, and make I vectors from them: weighted sums of points of flights.
// `varies` (M, U): which points vary, not the first and last ones. `points` (I, T): the points of
// each vector, as indices n U + u. `weights` (I, T): weights of the points. `constants` (I, 2): a
// constant part of each vector. `differences`: whether the weights of each vector add up to 0.
Vectors make_vectors(const py::buffer& varies, const py::buffer& points, const py::buffer& weights,
                     const py::buffer& constants, bool differences) {
    const Array<const bool> flags(varies, "varies");
    expect(flags.axes() == 2 && flags.shape(0) >= 3 && flags.shape(1) >= 1, "varies");
    const std::size_t uavs = flags.shape(1), size = flags.size();
    for (std::size_t u = 0; u < uavs; ++u)
        expect(!flags[u] && !flags[size - uavs + u], "varies");
    const std::vector<int> indices = copy_indices(points, "points");
    for (const int point : indices) expect(point >= 0 && std::size_t(point) < size, "points");
    const std::size_t count = count_entries(constants) / 2;
    expect(count >= 1 && !indices.empty() && indices.size() % count == 0, "points");
    return Vectors(int(uavs), copy_flags(varies, "varies", size), indices,
                   copy_reals(weights, "weights", indices.size()),
                   copy_points(constants, "constants", count), differences);
}

// Make the limit |d|^2 < square of each of I vectors d that is not ignored, with `squares` (I).
std::shared_ptr<Limit> make_limit(const Vectors& vectors, const py::buffer& ignored,
                                  const py::buffer& squares) {
    return std::make_shared<Limit>(
        vectors, copy_flags(ignored, "ignored", vectors.count()),
        copy_reals(squares, "squares", vectors.count()));
}

// Make the energies of U UAVs, constant + sum of weight * power over S moves: `moves` and `weights`
// are (U, S), `constants` (U), and `terms` (U, 4), the numbers of each UAV's PowerTerms in order.
std::shared_ptr<Energies> make_energies(const Vectors& moves, const py::buffer& weights,
                                        const py::buffer& terms, const py::buffer& constants) {
    const std::size_t uavs = count_entries(terms) / 4;
    expect(uavs >= 1 && moves.fits(moves.slots(), uavs) && moves.count() % uavs == 0, "terms");
    const Reals numbers = copy_reals(terms, "terms", 4 * uavs);
    std::vector<kernel::PowerTerms> powers;
    for (std::size_t i = 0; i < numbers.size(); i += 4)
        powers.push_back({numbers[i], numbers[i + 1], numbers[i + 2], numbers[i + 3]});
    return std::make_shared<Energies>(moves, copy_reals(weights, "weights", moves.count()),
                                      std::move(powers),
                                      copy_reals(constants, "constants", uavs));
}

// Fill `energies`, (U), with the energies on a path, (M, U, 2), as shares of their limits.
void find_energies(const Energies& self, const py::buffer& path, const py::buffer& energies) {
    const std::size_t uavs = count_entries(energies);
    const Reals points = copy_reals(path, "path", (self.moves().slots() + 2) * 2 * uavs);
    Reals values;
    self.compute_energies(points.data(), values);
    const Array<double> filled(energies, "energies", values.size());
    std::copy(values.begin(), values.end(), filled.data());
}

// Make Pieces: one piece of K control points around each of the M = N + 2 points of a flight, for
// each of G pairs; struct Pieces says what a pair is. `ignored` (M, G, K): True for control points
// that are constant, which a limit leaves out.
Pieces make_pieces(const Vectors& control_points, const py::buffer& ignored) {
    const Array<const bool> flags(ignored, "ignored", control_points.count());
    expect(flags.axes() == 3 && flags.shape(0) == control_points.slots() + 2
               && flags.shape(2) >= 1, "ignored");
    return {control_points, copy_flags(ignored, "ignored", flags.size()), flags.shape(1),
            int(flags.shape(2))};
}

// Make the limit that keeps A UAVs out of obstacles. `polygons` (A, Z, V, 2): the Z obstacles of
// each UAV, with V vertices each. `ignored` (M, G, K): control points that do not vary. Each UAV
// has G / A <= Z of the G pairs. The lines of a UAV's pairs are tangents of different obstacles.
std::shared_ptr<ZoneLimit> make_zone_limit(const Vectors& control_points,
                                           const py::buffer& ignored, const py::buffer& polygons) {
    const Pieces pieces = make_pieces(control_points, ignored);
    const Array<const double> corners(polygons, "polygons");
    expect(corners.axes() == 4 && corners.shape(3) == 2, "polygons");
    const std::size_t uavs = corners.shape(0), zones = corners.shape(1);
    const std::size_t vertices = corners.shape(2);
    expect(vertices >= 1 && uavs >= 1 && pieces.pairs >= uavs && pieces.pairs % uavs == 0
               && pieces.pairs / uavs <= zones, "polygons");
    return std::make_shared<ZoneLimit>(
        pieces, copy_points(polygons, "polygons", uavs * zones * vertices), int(uavs), int(zones),
        int(vertices));
}

std::shared_ptr<SeparationLimit> make_separation_limit(
    const Vectors& control_points, const py::buffer& ignored, const py::buffer& radii) {
    const Pieces pieces = make_pieces(control_points, ignored);
    return std::make_shared<SeparationLimit>(pieces, copy_reals(radii, "radii", pieces.pairs));
}

// Make the limit that keeps the curves of G pairs at normal . p > offset, with a side of the fence
// for each pair: `normals` are (G, 2), and `offsets` (G). `ignored` is (M, G, K).
std::shared_ptr<FenceLimit> make_fence_limit(const Vectors& control_points,
                                             const py::buffer& ignored, const py::buffer& normals,
                                             const py::buffer& offsets) {
    const Pieces pieces = make_pieces(control_points, ignored);
    const std::vector<Point> directions = copy_points(normals, "normals", pieces.pairs);
    const Reals distances = copy_reals(offsets, "offsets", pieces.pairs);
    std::vector<kernel::Line> sides;
    for (std::size_t i = 0; i < pieces.pairs; ++i) sides.push_back({directions[i], distances[i]});
    return std::make_shared<FenceLimit>(pieces, std::move(sides));
}

// Choose lines normal . p = offset that separate the pieces of a path, (M, U, 2), from what they
// must clear: one line for each of M pieces and G pairs of `limit`. Fill the unit `normals`,
// (M, G, 2), and the `offsets`, (M, G).
void choose_lines(const LineLimit& limit, const py::buffer& path, const py::buffer& normals,
                  const py::buffer& offsets) {
    const Array<const double> points(path, "path");
    expect(points.axes() == 3 && points.shape(2) == 2
               && limit.vectors().fits(points.shape(0) - 2, points.shape(1)), "path");
    const std::size_t pieces = limit.count() / limit.controls();
    const Array<double> normal(normals, "normals", 2 * pieces), offset(offsets, "offsets", pieces);
    kernel::LineSet set;
    limit.choose_lines(points.data(), set);
    for (std::size_t i = 0; i < pieces; ++i) {
        // The control points of a piece share a line.
        const kernel::Line& line = set.lines[i * limit.controls()];
        normal[2 * i] = line.normal.x;
        normal[2 * i + 1] = line.normal.y;
        offset[i] = line.offset;
    }
}

// Evaluate all methods of a limit for mu = 1 and duals 1 / slack, for a path, (M, U, 2), and moves
// of its points, (M, U, 2): for tests. core.pyi lists the answer.
py::dict evaluate_limit(const Limit& limit, const py::buffer& path, const py::buffer& moves) {
    const Array<const double> point(path, "path"), move(moves, "moves");
    expect(point.axes() == 3 && point.shape(2) == 2, "path");
    const std::size_t slots = point.shape(0) - 2, uavs = point.shape(1), size = 3 * uavs * slots;
    expect(limit.vectors().fits(slots, uavs) && move.size() == point.size(), "path, moves");
    kernel::LineSet lines;
    kernel::Slacks slacks, slopes;
    limit.choose_lines(point.data(), lines);
    slacks.lines = &lines;
    limit.find_slacks(point.data(), slacks);
    limit.find_slopes(slacks, move.data(), slopes);
    Reals lengths(uavs, 1.0), gradient(size), duals(slacks.values);
    limit.limit_steps(slacks, slopes, lengths.data());
    limit.add_gradient(slacks, 1.0, gradient.data());
    for (double& dual : duals) dual = 1.0 / dual;
    const int height = limit.vectors().bandwidth() + 1;
    Reals band((size + height) * height);
    limit.add_curvature(slacks, duals, {band.data(), height});
    py::dict answer;
    answer["slacks"] = slacks.values;
    answer["slopes"] = slopes.values;
    answer["lengths"] = lengths;
    answer["gradient"] = gradient;
    answer["band"] = band;
    answer["height"] = height;
    answer["limits_moves"] = !lines.max_moves.empty();
    return answer;
}

}  // namespace

void add_limits(py::module_& module) {
    using py::arg;
    py::class_<Vectors>(module, "Vectors")
        .def(py::init(&make_vectors), arg("varies"), arg("points"), arg("weights"),
             arg("constants"), arg("differences"));
    py::class_<Limit, std::shared_ptr<Limit>>(module, "Limit")
        .def(py::init(&make_limit), arg("vectors"), arg("ignored"), arg("squares"))
        .def("evaluate", &evaluate_limit);
    py::class_<Energies, std::shared_ptr<Energies>>(module, "Energies")
        .def(py::init(&make_energies), arg("moves"), arg("weights"), arg("terms"),
             arg("constants"))
        .def("find", &find_energies);
    py::class_<LineLimit, Limit, std::shared_ptr<LineLimit>>(module, "LineLimit")
        .def("choose_lines", &choose_lines);
    py::class_<ZoneLimit, LineLimit, std::shared_ptr<ZoneLimit>>(module, "ZoneLimit")
        .def(py::init(&make_zone_limit), arg("control_points"), arg("ignored"), arg("polygons"));
    py::class_<SeparationLimit, LineLimit, std::shared_ptr<SeparationLimit>>(
        module, "SeparationLimit")
        .def(py::init(&make_separation_limit), arg("control_points"), arg("ignored"),
             arg("radii"));
    py::class_<FenceLimit, LineLimit, std::shared_ptr<FenceLimit>>(module, "FenceLimit")
        .def(py::init(&make_fence_limit), arg("control_points"), arg("ignored"), arg("normals"),
             arg("offsets"));
}
