// What Python sees of the kernel.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstdint>

#include "array.hpp"
#include "clearances.hpp"
#include "discs.hpp"
#include "norm.hpp"
#include "starts.hpp"

namespace py = pybind11;

void add_bound_boxes(py::module_& module);  // bound_boxes.cpp
void add_bound_dual(py::module_& module);   // bound_dual.cpp

using kernel::Array;
using kernel::expect;
using kernel::Reals;
using kernel::size_of;

namespace {

// From a dict with arrays by name, or from the array itself.
template <typename Given>
Reals reals(const Given& given, const char* name, std::size_t size) {
    const Array<const double> found(given, name, size);
    return Reals(found.data(), found.data() + size);
}

std::vector<char> flags(const py::dict& given, const char* name, std::size_t size) {
    const Reals found = reals(given, name, size);
    return std::vector<char>(found.begin(), found.end());
}

std::vector<int> integers(const py::dict& given, const char* name, std::size_t size, int below) {
    const Reals found = reals(given, name, size);
    for (const double number : found) expect(number >= 0.0 && number < below, name);
    return std::vector<int>(found.begin(), found.end());
}

std::vector<kernel::Point> points(const py::dict& given, const char* name, std::size_t size) {
    const Reals found = reals(given, name, 2 * size);
    std::vector<kernel::Point> points;
    for (std::size_t i = 0; i < size; ++i) points.push_back({found[2 * i], found[2 * i + 1]});
    return points;
}

kernel::Receivers receivers_of(const kernel::Problem& problem, const py::dict& given) {
    const std::size_t uavs = problem.uavs, entries = size_of(given, "edge");
    expect(entries >= 2 * uavs && entries % uavs == 0, "edge");
    kernel::Receivers found;
    found.edge = reals(given, "edge", entries);
    found.count = int(entries / uavs);
    const std::size_t all = 2 * std::size_t(found.count);
    const bool per_slot = given["positions"].cast<py::buffer>().request().ndim == 3;
    found.stride = per_slot ? int(all) : 0;
    found.positions = reals(given, "positions", per_slot ? all * problem.slots : all);
    return found;
}

std::shared_ptr<kernel::NormLimit> norm_of(const py::dict& given) {
    const std::size_t uavs = size_of(given, "square");
    const std::size_t slots = given["slots"].cast<std::size_t>();
    const int order = given["order"].cast<int>();
    expect((order == 1 || order == 2) && uavs && slots, "order, square, slots");
    return std::make_shared<kernel::NormLimit>(
        slots, order, reals(given, "square", uavs),
        flags(given, "ignored", (slots + order) * uavs), reals(given, "end_moves", 4 * uavs));
}

kernel::Tracks tracks_of(const py::dict& given) {
    kernel::Tracks found;
    found.slots = given["slots"].cast<std::size_t>();
    found.uavs = given["uavs"].cast<int>();
    found.corners = given["corners"].cast<int>();
    expect(found.corners >= 1 && found.corners <= 3, "corners");
    const std::size_t tracks = size_of(given, "uav"), subjects = size_of(given, "first");
    const std::size_t points = found.slots + 2, size = points * tracks * found.corners;
    found.uav = integers(given, "uav", tracks, found.uavs);
    found.weights = reals(given, "weights", 3 * size);
    found.all = reals(given, "all", 3 * size);
    found.constant = reals(given, "constant", 2 * size);
    for (std::size_t i = 0; i < found.weights.size(); ++i) {
        const std::ptrdiff_t slot =
            std::ptrdiff_t(i / (3 * tracks * found.corners)) + std::ptrdiff_t(i % 3) - 2;
        expect(found.weights[i] == 0.0 || (slot >= 0 && slot < std::ptrdiff_t(found.slots)),
               "weights");
    }
    found.first = integers(given, "first", subjects, int(tracks));
    if (!given["second"].is_none())
        found.second = integers(given, "second", subjects, int(tracks));
    found.ignored = flags(given, "ignored", points * subjects * found.corners);
    return found;
}

std::shared_ptr<kernel::ZoneLimit> zones_of(const py::dict& given) {
    kernel::Tracks tracks = tracks_of(given);
    const Array<const double> polygons(given["polygons"].cast<py::buffer>(), "polygons");
    expect(polygons.axes() == 4 && polygons.shape(3) == 2 && tracks.corners >= 2, "polygons");
    const std::size_t uavs = polygons.shape(0), most = polygons.shape(1);
    const std::size_t vertices = polygons.shape(2), subjects = tracks.first.size();
    const std::size_t lines = uavs ? subjects / uavs : 0;
    expect(vertices >= 1 && lines >= 1 && lines <= most && uavs * lines == subjects, "polygons");
    return std::make_shared<kernel::ZoneLimit>(
        std::move(tracks), points(given, "polygons", uavs * most * vertices), int(uavs),
        int(most), int(vertices), int(lines));
}

std::shared_ptr<kernel::SeparationLimit> separation_of(const py::dict& given) {
    kernel::Tracks tracks = tracks_of(given);
    const std::size_t subjects = tracks.first.size();
    expect(tracks.corners >= 2 && tracks.second.size() == subjects, "second");
    return std::make_shared<kernel::SeparationLimit>(
        std::move(tracks), reals(given, "radii", subjects));
}

std::shared_ptr<kernel::FenceLimit> fence_of(const py::dict& given) {
    kernel::Tracks tracks = tracks_of(given);
    const std::size_t subjects = tracks.first.size();
    const std::vector<kernel::Point> normals = points(given, "normals", subjects);
    const Reals offsets = reals(given, "offsets", subjects);
    std::vector<kernel::Line> sides;
    for (std::size_t i = 0; i < subjects; ++i) sides.push_back({normals[i], offsets[i]});
    return std::make_shared<kernel::FenceLimit>(std::move(tracks), std::move(sides));
}

// Copy the lines that a limit chooses for a path.
void choose_lines(const kernel::LineLimit& limit, const py::buffer& path,
                  const py::buffer& normals, const py::buffer& offsets) {
    const Array<const double> points(path, "path");
    expect(points.axes() == 3 && points.shape(2) == 2
               && limit.fits(points.shape(0) - 2, int(points.shape(1))), "path");
    const Array<double> normal(normals, "normals", 2 * limit.pieces());
    const Array<double> offset(offsets, "offsets", limit.pieces());
    kernel::Lines lines;
    limit.choose(points.data(), lines);
    for (std::size_t i = 0; i < lines.of.size(); ++i) {
        normal[2 * i] = lines.of[i].normal.x;
        normal[2 * i + 1] = lines.of[i].normal.y;
        offset[i] = lines.of[i].offset;
    }
}

// All that a limit answers for a path and moves of its points, for tests to compare.
py::dict answers(const kernel::Limit& limit, const py::buffer& path, const py::buffer& moves,
                 double share) {
    const Array<const double> at(path, "path"), by(moves, "moves");
    expect(at.axes() == 3 && at.shape(2) == 2, "path");
    const std::size_t slots = at.shape(0) - 2, uavs = at.shape(1), size = 3 * uavs * slots;
    expect(limit.fits(slots, int(uavs)) && by.size() == at.size(), "path, moves");
    kernel::Lines lines;
    kernel::Terms here;
    kernel::Slopes step;
    limit.choose(at.data(), lines);
    here.lines = &lines;
    limit.find_slacks(at.data(), here);
    limit.find_slopes(here, by.data(), step);
    Reals longest(uavs, 1.0), gradient(size), duals(here.slacks);
    limit.shorten(here, step, share, longest.data());
    limit.add_gradient(here, 1.0, gradient.data());
    for (double& dual : duals) dual = 1.0 / dual;
    const int height = limit.bandwidth() + 1;
    Reals band((size + height) * height);
    limit.add_curvature(here, duals, {band.data(), height});
    // The gradient of -sum log c and its Hessian, along the moves.
    double slope = 0.0, curvature = 0.0;
    Reals x(size + height);
    for (std::size_t i = 0; i < slots * uavs; ++i)
        for (int axis = 0; axis < 2; ++axis)
            x[3 * i + 1 + axis] = by[2 * (i + uavs) + axis];
    for (std::size_t column = 0; column < size; ++column) {
        slope += gradient[column] * x[column];
        for (int down = 0; down < height; ++down)
            curvature += (down ? 2.0 : 1.0) * band[column * height + down] * x[column]
                * x[column + down];
    }
    py::dict found;
    found["slacks"] = here.slacks;
    found["slopes"] = step.slacks;
    found["longest"] = longest;
    found["slope"] = slope;
    found["curvature"] = curvature;
    found["has_room"] = !lines.room.empty();
    return found;
}

std::shared_ptr<kernel::FreeSpace> free_space(const py::buffer& snr,
                                              const py::buffer& squared_altitudes) {
    const std::size_t links = size_of(snr);
    return std::make_shared<kernel::FreeSpace>(
        reals(snr, "snr", links), reals(squared_altitudes, "squared_altitudes", links));
}

std::shared_ptr<kernel::PathLoss> path_loss(const py::buffer& snr,
                                            const py::buffer& squared_altitudes,
                                            const py::buffer& losses, double exponent, double a,
                                            double b) {
    const std::size_t links = size_of(snr);
    return std::make_shared<kernel::PathLoss>(
        reals(snr, "snr", links), reals(squared_altitudes, "squared_altitudes", links),
        reals(losses, "losses", links), exponent, a, b);
}

// Bounds of the derivatives of log gain, for tests.
py::tuple slopes(const kernel::PathLoss& channel, std::size_t link, double near, double far) {
    expect(link < channel.links() && near <= far, "link, near, far");
    const kernel::PathLoss::Slopes found = channel.slopes(link, near, far);
    return py::make_tuple(found.first, found.second, found.third);
}

py::tuple gain(const kernel::Channel& channel, std::size_t link, double squared) {
    expect(link < channel.links(), "link");
    const kernel::Gain found = channel.derivatives(link, squared);
    return py::make_tuple(channel.gain(link, squared), found.value, found.first, found.second);
}

kernel::Places places_of(const kernel::Problem& problem, const py::dict& given) {
    const std::size_t places = problem.receivers.count - 1;
    kernel::Places found;
    found.followed = flags(given, "followed", problem.slots * places);
    found.offsets = reals(given, "offsets", problem.slots * places * 2);
    found.radii = reals(given, "radii", places);
    return found;
}

kernel::Problem problem_of(const py::dict& given) {
    kernel::Problem found;
    found.slots = given["slots"].cast<std::size_t>();
    found.uavs = given["uavs"].cast<int>();
    expect(found.slots >= 1 && found.uavs >= 1, "slots, uavs");
    const std::size_t uavs = found.uavs;
    found.starts = reals(given, "starts", 2 * uavs);
    found.goals = reals(given, "goals", 2 * uavs);
    found.fixed = flags(given, "fixed", uavs);
    found.peaks = reals(given, "peaks", uavs);
    for (const py::handle limit : given["limits"].cast<py::list>()) {
        found.limits.push_back(limit.cast<std::shared_ptr<kernel::Limit>>());
        expect(found.limits.back()->fits(found.slots, found.uavs), "limits");
    }
    found.receivers = receivers_of(found, given);
    found.channel = given["channel"].cast<std::shared_ptr<kernel::Channel>>();
    expect(found.channel->links() == found.receivers.edge.size(), "channel");
    found.colluding = given["colluding"].cast<bool>();
    if (!given["places"].is_none())
        found.places = places_of(found, given["places"].cast<py::dict>());
    return found;
}

void look_for_signals() {
    const py::gil_scoped_acquire acquire;
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

// Starts in arrays of Python.
class Barrier {
public:
    Barrier(const py::dict& given, const py::buffer& x, const py::buffer& mu,
            const py::buffer& finished)
        : starts_(problem_of(given)), x_(x, "x"), mu_(mu, "mu"),
          finished_(finished, "finished", mu_.size()) {
        const kernel::Problem& problem = starts_.problem();
        expect(mu_.size() > 0, "mu");
        expect(x_.axes() == 4 && x_.shape(0) == mu_.size() && x_.shape(1) == problem.slots
                   && x_.shape(2) == std::size_t(problem.uavs) && x_.shape(3) == 3, "x");
        const std::size_t size = x_.size() / mu_.size();
        for (std::size_t s = 0; s < mu_.size(); ++s)
            starts_.add(&x_[s * size], &mu_[s], &finished_[s]);
    }

    py::tuple advance(int steps, double final, const py::function& check) {
        kernel::Taken taken;
        {
            const py::gil_scoped_release release;
            taken = starts_.advance(steps, final, [&check] {
                look_for_signals();
                const py::gil_scoped_acquire acquire;
                check();
            });
        }
        return py::make_tuple(taken.steps, taken.failed);
    }

    void rates(const py::buffer& found) {
        const Array<double> rates(found, "rates", starts_.count());
        const py::gil_scoped_release release;
        starts_.rates(rates.data());
    }

    // See Newton::model; values (S), gradients (S, N, U, 3) and hessians (S, N, 3 U, 3 U).
    void model(const py::buffer& values, const py::buffer& gradients,
               const py::buffer& hessians) {
        const std::size_t size = x_.size();
        const Array<double> value(values, "values", starts_.count());
        const Array<double> gradient(gradients, "gradients", size);
        const Array<double> hessian(hessians, "hessians", 3 * starts_.problem().uavs * size);
        starts_.model(value.data(), gradient.data(), hessian.data());
    }

    void exchange(const py::dict& places, const py::buffer& positions) {
        const kernel::Problem& problem = starts_.problem();
        const std::size_t size = problem.receivers.positions.size();
        expect(!problem.places.followed.empty(), "places");
        starts_.exchange(places_of(problem, places), reals(positions, "positions", size));
    }

private:
    kernel::Starts starts_;
    Array<double> x_, mu_;
    Array<bool> finished_;
};

kernel::Pairs pairs_of(const py::dict& given) {
    const std::size_t count = size_of(given, "noise");
    const std::size_t uavs = size_of(given, "squared_altitudes");
    expect(uavs >= 1, "squared_altitudes");
    kernel::Pairs found;
    found.count = count;
    found.uavs = int(uavs);
    found.x = reals(given, "x", count * uavs);
    found.y = reals(given, "y", count * uavs);
    found.squared_altitudes = reals(given, "squared_altitudes", uavs);
    found.noise = reals(given, "noise", count);
    found.radius = reals(given, "radius", count);
    found.jamming = reals(given, "jamming", count * (uavs - 1));
    if (given.contains("channel")) {
        found.channel = given["channel"].cast<std::shared_ptr<kernel::PathLoss>>();
        expect(found.channel->links() == uavs, "channel");
    }
    return found;
}

void likely_places(const py::dict& given, const py::buffer& found) {
    const kernel::Pairs pairs = pairs_of(given);
    const Array<double> places(found, "found", 3 * pairs.count);
    const py::gil_scoped_release release;
    double* v = places.data();
    kernel::likely_places(pairs, v, v + pairs.count, v + 2 * pairs.count);
}

// Find a bound of v in one sector of every pair, and v at a place of it; (P) each.
void bound_sectors(const py::dict& given, const py::dict& sectors, const py::buffer& bounds,
                   const py::buffer& values) {
    const kernel::Pairs pairs = pairs_of(given);
    const Array<double> bound(bounds, "bounds", pairs.count);
    const Array<double> value(values, "values", pairs.count);
    const Reals inner = reals(sectors, "inner", pairs.count);
    const Reals outer = reals(sectors, "outer", pairs.count);
    const Reals middle = reals(sectors, "middle", pairs.count);
    const Reals half = reals(sectors, "half", pairs.count);
    for (std::size_t i = 0; i < pairs.count; ++i) {
        kernel::Sector sector{i, inner[i], outer[i], middle[i], half[i], 0.0};
        value[i] = kernel::bound_sector(pairs, sector).v;
        bound[i] = sector.bound;
    }
}

void prove(const py::dict& given, const py::buffer& slot, const py::buffer& most,
           std::int64_t most_sectors, double tolerance, const py::buffer& leaks,
           const py::buffer& pair, const py::buffer& place) {
    const kernel::Pairs pairs = pairs_of(given);
    const Array<const std::int64_t> slots(slot, "slot", pairs.count);
    const Array<const double> mosts(most, "most", pairs.count);
    const Array<double> leak(leaks, "leaks");
    const Array<std::int64_t> of_pair(pair, "pair", leak.size());
    const Array<double> places(place, "place", 2 * leak.size());
    for (std::size_t i = 0; i < pairs.count; ++i)
        expect(slots[i] >= (i ? slots[i - 1] : 0) && std::size_t(slots[i]) < leak.size(), "slot");
    const kernel::Proof proof{slots.data(), mosts.data(), most_sectors, tolerance,
                              leak.data(), of_pair.data(), places.data()};
    const py::gil_scoped_release release;
    kernel::prove(pairs, proof, look_for_signals);
}

}  // namespace

PYBIND11_MODULE(_secure_uav_planner_kernel, module) {
    module.doc() = "The joint method's Newton steps, the limits in them, and the worst case.";
    module.attr("sources") = KERNEL_SOURCES;
    module.attr("TOLERANCE") = kernel::TOLERANCE;
    module.def("likely_places", &likely_places);
    module.def("bound_sectors", &bound_sectors);
    module.def("prove", &prove);
    add_bound_boxes(module);
    add_bound_dual(module);

    py::class_<kernel::Channel, std::shared_ptr<kernel::Channel>>(module, "Channel")
        .def("gain", &gain);
    py::class_<kernel::FreeSpace, kernel::Channel, std::shared_ptr<kernel::FreeSpace>>(
        module, "FreeSpace").def(py::init(&free_space));
    py::class_<kernel::PathLoss, kernel::Channel, std::shared_ptr<kernel::PathLoss>>(
        module, "PathLoss").def(py::init(&path_loss)).def("slopes", &slopes);

    py::class_<kernel::Limit, std::shared_ptr<kernel::Limit>>(module, "Limit")
        .def("answers", &answers);
    py::class_<kernel::NormLimit, kernel::Limit, std::shared_ptr<kernel::NormLimit>>(
        module, "NormLimit").def(py::init(&norm_of));
    using kernel::LineLimit;
    py::class_<LineLimit, kernel::Limit, std::shared_ptr<LineLimit>>(module, "LineLimit")
        .def("choose", &choose_lines);
    py::class_<kernel::ZoneLimit, LineLimit, std::shared_ptr<kernel::ZoneLimit>>(
        module, "ZoneLimit").def(py::init(&zones_of));
    py::class_<kernel::SeparationLimit, LineLimit, std::shared_ptr<kernel::SeparationLimit>>(
        module, "SeparationLimit").def(py::init(&separation_of));
    py::class_<kernel::FenceLimit, LineLimit, std::shared_ptr<kernel::FenceLimit>>(
        module, "FenceLimit").def(py::init(&fence_of));

    py::class_<Barrier>(module, "Barrier")
        .def(py::init<const py::dict&, const py::buffer&, const py::buffer&, const py::buffer&>())
        .def("advance", &Barrier::advance)
        .def("rates", &Barrier::rates)
        .def("model", &Barrier::model)
        .def("exchange", &Barrier::exchange);
}
