// What Python sees of the kernel.
//
// Arrays come by the buffer protocol, so that any NumPy will do.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <string>

#include "clearances.hpp"
#include "discs.hpp"
#include "norm.hpp"
#include "starts.hpp"

namespace py = pybind11;

void add_bound_boxes(py::module_& module);  // bound_boxes.cpp
void add_bound_dual(py::module_& module);   // bound_dual.cpp
void add_bound_shares(py::module_& module);  // bound_shares.cpp

using kernel::Reals;

namespace {

// Whatever Python hands over is checked, so that nothing here reads beyond an array.
void expect(bool right, const char* name) {
    if (!right) throw std::invalid_argument(std::string("wrong array: ") + name);
}

// A contiguous array of Python's, kept as long as this is.
template <typename T>
class View {
public:
    View(const py::buffer& given, const char* name, bool writable = false)
        : info_(given.request(writable)) {
        py::ssize_t stride = sizeof(T);
        bool right = info_.itemsize == stride && py::detail::compare_buffer_info<T>::compare(info_);
        for (py::ssize_t axis = info_.ndim - 1; axis >= 0; --axis) {
            right = right && (info_.strides[axis] == stride || info_.shape[axis] < 2);
            stride *= info_.shape[axis];
        }
        expect(right, name);
    }
    T* data() const { return static_cast<T*>(info_.ptr); }
    std::size_t size() const { return std::size_t(info_.size); }
    std::size_t axes() const { return std::size_t(info_.ndim); }
    std::size_t shape(std::size_t axis) const { return std::size_t(info_.shape[axis]); }

private:
    py::buffer_info info_;
};

Reals reals(const py::handle& given, std::size_t size, const char* name) {
    const View<double> view(given.cast<py::buffer>(), name);
    expect(view.size() == size, name);
    return Reals(view.data(), view.data() + size);
}

std::vector<char> flags(const py::handle& given, std::size_t size, const char* name) {
    const Reals found = reals(given, size, name);
    return std::vector<char>(found.begin(), found.end());
}

kernel::Receivers receivers_of(const kernel::Problem& problem, const py::handle& positions,
                               const py::handle& edge) {
    const std::size_t uavs = problem.uavs;
    kernel::Receivers found;
    const std::size_t entries = View<double>(edge.cast<py::buffer>(), "edge").size();
    expect(entries >= 2 * uavs && entries % uavs == 0, "edge");
    found.edge = reals(edge, entries, "edge");
    found.count = int(entries / uavs);
    const std::size_t all = 2 * std::size_t(found.count);
    const bool per_slot = View<double>(positions.cast<py::buffer>(), "positions").axes() == 3;
    found.stride = per_slot ? int(all) : 0;
    found.positions = reals(positions, per_slot ? all * problem.slots : all, "positions");
    return found;
}

std::shared_ptr<kernel::NormLimit> norm_of(const py::dict& given) {
    const std::size_t uavs = View<double>(given["square"].cast<py::buffer>(), "square").size();
    const std::size_t slots = given["slots"].cast<std::size_t>();
    const int order = given["order"].cast<int>();
    expect((order == 1 || order == 2) && uavs && slots, "order, square, slots");
    return std::make_shared<kernel::NormLimit>(
        slots, order, reals(given["square"], uavs, "square"),
        flags(given["ignored"], (slots + order) * uavs, "ignored"),
        reals(given["end_moves"], 4 * uavs, "end_moves"));
}

std::vector<int> integers(const py::handle& given, std::size_t size, int below,
                          const char* name) {
    const Reals found = reals(given, size, name);
    for (const double number : found) expect(number >= 0.0 && number < below, name);
    return std::vector<int>(found.begin(), found.end());
}

std::vector<kernel::Point> points(const py::handle& given, std::size_t size, const char* name) {
    const Reals found = reals(given, 2 * size, name);
    std::vector<kernel::Point> points;
    for (std::size_t i = 0; i < size; ++i) points.push_back({found[2 * i], found[2 * i + 1]});
    return points;
}

std::size_t size_of(const py::dict& given, const char* name) {
    return View<double>(given[name].cast<py::buffer>(), name).size();
}

kernel::Tracks tracks_of(const py::dict& given) {
    kernel::Tracks found;
    found.slots = given["slots"].cast<std::size_t>();
    found.uavs = given["uavs"].cast<int>();
    found.corners = given["corners"].cast<int>();
    expect(found.corners >= 1 && found.corners <= 3, "corners");
    const std::size_t tracks = size_of(given, "uav");
    const std::size_t size = (found.slots + 2) * tracks * found.corners;
    found.uav = integers(given["uav"], tracks, found.uavs, "uav");
    found.weights = reals(given["weights"], 3 * size, "weights");
    found.all = reals(given["all"], 3 * size, "all");
    found.constant = reals(given["constant"], 2 * size, "constant");
    for (std::size_t i = 0; i < found.weights.size(); ++i) {
        const std::ptrdiff_t slot =
            std::ptrdiff_t(i / (3 * tracks * found.corners)) + std::ptrdiff_t(i % 3) - 2;
        expect(found.weights[i] == 0.0 || (slot >= 0 && slot < std::ptrdiff_t(found.slots)),
               "weights");
    }
    return found;
}

// Make a LineLimit of some kind with what is its own; `make` takes the tracks.
template <typename Make>
auto lines_of(const py::dict& given, Make make) {
    kernel::Tracks tracks = tracks_of(given);
    const std::size_t subjects = size_of(given, "first"), corners = tracks.corners;
    const std::size_t entries = (tracks.slots + 2) * subjects * corners;
    const int count = int(tracks.uav.size());
    std::vector<int> second;
    if (!given["second"].is_none()) second = integers(given["second"], subjects, count, "second");
    auto found = make(std::move(tracks), subjects, corners);
    found->set_subjects(integers(given["first"], subjects, count, "first"), std::move(second),
                        flags(given["ignored"], entries, "ignored"));
    return found;
}

std::shared_ptr<kernel::ZoneLimit> zones_of(const py::dict& given) {
    return lines_of(given, [&](kernel::Tracks tracks, std::size_t subjects, std::size_t corners) {
        const View<double> polygons(given["polygons"].cast<py::buffer>(), "polygons");
        expect(polygons.axes() == 4 && polygons.shape(3) == 2 && corners >= 2, "polygons");
        const std::size_t uavs = polygons.shape(0), most = polygons.shape(1);
        const std::size_t vertices = polygons.shape(2), lines = uavs ? subjects / uavs : 0;
        expect(vertices >= 1 && lines >= 1 && lines <= most && uavs * lines == subjects,
               "polygons");
        return std::make_shared<kernel::ZoneLimit>(
            std::move(tracks), points(given["polygons"], uavs * most * vertices, "polygons"),
            int(uavs), int(most), int(vertices), int(lines));
    });
}

std::shared_ptr<kernel::SeparationLimit> separation_of(const py::dict& given) {
    return lines_of(given, [&](kernel::Tracks tracks, std::size_t subjects, std::size_t corners) {
        expect(corners >= 2 && !given["second"].is_none(), "second");
        return std::make_shared<kernel::SeparationLimit>(
            std::move(tracks), reals(given["radii"], subjects, "radii"));
    });
}

std::shared_ptr<kernel::FenceLimit> fence_of(const py::dict& given) {
    return lines_of(given, [&](kernel::Tracks tracks, std::size_t subjects, std::size_t) {
        const std::vector<kernel::Point> normals = points(given["normals"], subjects, "normals");
        const Reals offsets = reals(given["offsets"], subjects, "offsets");
        std::vector<kernel::Line> sides;
        for (std::size_t i = 0; i < subjects; ++i) sides.push_back({normals[i], offsets[i]});
        return std::make_shared<kernel::FenceLimit>(std::move(tracks), std::move(sides));
    });
}

// Copy the lines that a limit chooses for a path.
void choose_lines(const kernel::LineLimit& limit, const py::buffer& path,
                  const py::buffer& normals, const py::buffer& offsets) {
    const View<double> points(path, "path");
    const View<double> normal(normals, "normals", true), offset(offsets, "offsets", true);
    expect(points.axes() == 3 && points.shape(2) == 2
               && limit.fits(points.shape(0) - 2, int(points.shape(1))), "path");
    expect(normal.size() == 2 * limit.pieces() && offset.size() == limit.pieces(), "normals");
    kernel::Lines lines;
    limit.choose(points.data(), lines);
    for (std::size_t i = 0; i < lines.of.size(); ++i) {
        normal.data()[2 * i] = lines.of[i].normal.x;
        normal.data()[2 * i + 1] = lines.of[i].normal.y;
        offset.data()[i] = lines.of[i].offset;
    }
}

// All that a limit answers for a path and moves of its points, for tests to compare.
py::dict answers(const kernel::Limit& limit, const py::buffer& path, const py::buffer& moves,
                 double share) {
    const View<double> at(path, "path"), by(moves, "moves");
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
            x[3 * i + 1 + axis] = by.data()[2 * (i + uavs) + axis];
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
    const std::size_t links = View<double>(snr, "snr").size();
    return std::make_shared<kernel::FreeSpace>(
        reals(snr, links, "snr"), reals(squared_altitudes, links, "squared_altitudes"));
}

std::shared_ptr<kernel::PathLoss> path_loss(const py::buffer& snr,
                                            const py::buffer& squared_altitudes,
                                            const py::buffer& losses, double exponent, double a,
                                            double b) {
    const std::size_t links = View<double>(snr, "snr").size();
    return std::make_shared<kernel::PathLoss>(
        reals(snr, links, "snr"), reals(squared_altitudes, links, "squared_altitudes"),
        reals(losses, links, "losses"), exponent, a, b);
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
    found.followed = flags(given["followed"], problem.slots * places, "followed");
    found.offsets = reals(given["offsets"], problem.slots * places * 2, "offsets");
    found.radii = reals(given["radii"], places, "radii");
    return found;
}

kernel::Problem problem_of(const py::dict& given) {
    kernel::Problem found;
    found.slots = given["slots"].cast<std::size_t>();
    found.uavs = given["uavs"].cast<int>();
    expect(found.slots >= 1 && found.uavs >= 1, "slots, uavs");
    const std::size_t uavs = found.uavs;
    const auto array = [&given](const char* name, std::size_t size) {
        return reals(given[name], size, name);
    };
    found.starts = array("starts", 2 * uavs);
    found.goals = array("goals", 2 * uavs);
    found.fixed = flags(given["fixed"], uavs, "fixed");
    found.peaks = array("peaks", uavs);
    for (const py::handle limit : given["limits"].cast<py::list>()) {
        found.limits.push_back(limit.cast<std::shared_ptr<kernel::Limit>>());
        expect(found.limits.back()->fits(found.slots, found.uavs), "limits");
    }
    found.receivers = receivers_of(found, given["positions"], given["edge"]);
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

// Starts with the arrays of Python in which they are.
class Barrier {
public:
    Barrier(const py::dict& problem, const py::buffer& x, const py::buffer& mu,
            const py::buffer& finished)
        : starts_(problem_of(problem)) {
        hold(x, mu, finished);
        const std::size_t size = x_->size() / mu_->size();
        for (std::size_t s = 0; s < mu_->size(); ++s)
            starts_.add(x_->data() + s * size, mu_->data() + s, finished_->data() + s);
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
        const View<double> view(found, "rates", true);
        expect(view.size() == starts_.count(), "rates");
        const py::gil_scoped_release release;
        starts_.rates(view.data());
    }

    // See Newton::model; values (S), gradients (S, N, U, 3) and hessians (S, N, 3 U, 3 U).
    void model(const py::buffer& values, const py::buffer& gradients,
               const py::buffer& hessians) {
        const View<double> value(values, "values", true), gradient(gradients, "gradients", true);
        const View<double> hessian(hessians, "hessians", true);
        expect(value.size() == starts_.count() && gradient.size() == x_->size()
                   && hessian.size() == 3 * starts_.problem().uavs * x_->size(), "gradients");
        starts_.model(value.data(), gradient.data(), hessian.data());
    }

    void exchange(const py::dict& places, const py::buffer& positions) {
        const kernel::Problem& problem = starts_.problem();
        const std::size_t size = problem.receivers.positions.size();
        expect(!problem.places.followed.empty(), "places");
        starts_.exchange(places_of(problem, places), reals(positions, size, "positions"));
    }

    void keep(const py::buffer& chosen, const py::buffer& x, const py::buffer& mu,
              const py::buffer& finished) {
        const View<std::int64_t> view(chosen, "chosen");
        std::vector<std::size_t> indices(view.data(), view.data() + view.size());
        for (const std::size_t index : indices) expect(index < starts_.count(), "chosen");
        // Before anything is released: the starts are still in the arrays of before.
        expect(View<double>(mu, "mu").size() == indices.size(), "chosen");
        hold(x, mu, finished);
        starts_.keep(indices, x_->data(), mu_->data(), finished_->data());
    }

private:
    void hold(const py::buffer& x, const py::buffer& mu, const py::buffer& finished) {
        const kernel::Problem& problem = starts_.problem();
        auto new_x = std::make_unique<View<double>>(x, "x", true);
        auto new_mu = std::make_unique<View<double>>(mu, "mu", true);
        auto new_finished = std::make_unique<View<bool>>(finished, "finished", true);
        expect(new_mu->size() > 0 && new_finished->size() == new_mu->size(), "mu, finished");
        expect(new_x->axes() == 4 && new_x->shape(0) == new_mu->size()
                   && new_x->shape(1) == problem.slots
                   && new_x->shape(2) == std::size_t(problem.uavs) && new_x->shape(3) == 3, "x");
        x_ = std::move(new_x);
        mu_ = std::move(new_mu);
        finished_ = std::move(new_finished);
    }

    kernel::Starts starts_;
    std::unique_ptr<View<double>> x_, mu_;
    std::unique_ptr<View<bool>> finished_;
};

// Pairs in the arrays of Python.
class PairsView {
public:
    explicit PairsView(const py::dict& given)
        : x_(given["x"].cast<py::buffer>(), "x"), y_(given["y"].cast<py::buffer>(), "y"),
          squared_altitudes_(given["squared_altitudes"].cast<py::buffer>(), "squared_altitudes"),
          noise_(given["noise"].cast<py::buffer>(), "noise"),
          radius_(given["radius"].cast<py::buffer>(), "radius"),
          jamming_(given["jamming"].cast<py::buffer>(), "jamming"),
          channel_(given.contains("channel")
                   ? given["channel"].cast<std::shared_ptr<kernel::PathLoss>>() : nullptr) {
        const std::size_t count = noise_.size(), uavs = squared_altitudes_.size();
        expect(uavs >= 1 && radius_.size() == count, "radius");
        expect(x_.size() == count * uavs && y_.size() == count * uavs, "x, y");
        expect(jamming_.size() == count * (uavs - 1), "jamming");
        expect(!channel_ || channel_->links() == uavs, "channel");
    }
    kernel::Pairs pairs() const {
        return {noise_.size(), int(squared_altitudes_.size()), x_.data(), y_.data(),
                squared_altitudes_.data(), noise_.data(), radius_.data(), jamming_.data(),
                channel_.get()};
    }

private:
    View<double> x_, y_, squared_altitudes_, noise_, radius_, jamming_;
    std::shared_ptr<const kernel::PathLoss> channel_;
};

void likely_places(const py::dict& given, const py::buffer& found) {
    const PairsView view(given);
    const kernel::Pairs pairs = view.pairs();
    const View<double> places(found, "found", true);
    expect(places.size() == 3 * pairs.count, "found");
    const py::gil_scoped_release release;
    double* v = places.data();
    kernel::likely_places(pairs, v, v + pairs.count, v + 2 * pairs.count);
}

// Find a bound of v in one sector of every pair, and v at a place of it; (P) each.
void bound_sectors(const py::dict& given, const py::dict& sectors, const py::buffer& bounds,
                   const py::buffer& values) {
    const PairsView view(given);
    const kernel::Pairs pairs = view.pairs();
    const View<double> bound(bounds, "bounds", true), value(values, "values", true);
    expect(bound.size() == pairs.count && value.size() == pairs.count, "bounds, values");
    const auto array = [&](const char* name) { return reals(sectors[name], pairs.count, name); };
    const Reals inner = array("inner"), outer = array("outer");
    const Reals middle = array("middle"), half = array("half");
    for (std::size_t i = 0; i < pairs.count; ++i) {
        kernel::Sector sector{i, inner[i], outer[i], middle[i], half[i], 0.0};
        value.data()[i] = kernel::bound_sector(pairs, sector).v;
        bound.data()[i] = sector.bound;
    }
}

void prove(const py::dict& given, const py::buffer& slot, const py::buffer& most,
           std::int64_t most_sectors, double tolerance, const py::buffer& leaks, const py::buffer& pair,
           const py::buffer& place) {
    const PairsView view(given);
    const kernel::Pairs pairs = view.pairs();
    const View<std::int64_t> slots(slot, "slot");
    const View<double> mosts(most, "most"), leak(leaks, "leaks", true);
    const View<std::int64_t> of_pair(pair, "pair", true);
    const View<double> places(place, "place", true);
    expect(slots.size() == pairs.count && mosts.size() == pairs.count, "slot, most");
    expect(of_pair.size() == leak.size() && places.size() == 2 * leak.size(), "pair, place");
    for (std::size_t i = 0; i < pairs.count; ++i)
        expect(slots.data()[i] >= (i ? slots.data()[i - 1] : 0)
                   && std::size_t(slots.data()[i]) < leak.size(), "slot");
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
    add_bound_shares(module);

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
        .def("exchange", &Barrier::exchange)
        .def("keep", &Barrier::keep);
}
