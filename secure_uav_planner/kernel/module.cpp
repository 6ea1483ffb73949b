// What Python sees of the kernel; see kernel_barrier.py and kernel_search.py in the package.
//
// Arrays come by the buffer protocol, so that any NumPy will do.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <string>

#include "clearances.hpp"
#include "discs.hpp"
#include "starts.hpp"

namespace py = pybind11;
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

kernel::Numbers numbers_of(const py::dict& given) {
    const auto real = [&given](const char* name) { return given[name].cast<double>(); };
    kernel::Numbers found;
    found.boundary = real("boundary");
    found.power_factor = real("power_factor");
    found.sufficient_decrease = real("sufficient_decrease");
    found.softening = real("softening");
    found.patience = real("patience");
    found.dual_range = real("dual_range");
    found.mu_factor = real("mu_factor");
    found.mu_power = real("mu_power");
    found.centred = real("centred");
    found.still = real("still");
    found.negligible = real("negligible");
    found.clipped_trials = given["clipped_trials"].cast<int>();
    found.uniform_trials = given["uniform_trials"].cast<int>();
    return found;
}

kernel::NormLimit norm_of(const kernel::Problem& problem, const py::dict& given) {
    kernel::NormLimit found;
    const std::size_t uavs = problem.uavs;
    found.order = given["order"].cast<int>();
    expect(found.order == 1 || found.order == 2, "order");
    found.square = reals(given["square"], uavs, "square");
    found.ignored = flags(given["ignored"],
                          (std::size_t(problem.slots) + found.order) * uavs, "ignored");
    found.end_moves = reals(given["end_moves"], 4 * uavs, "end_moves");
    return found;
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

kernel::Tracks tracks_of(const kernel::Problem& problem, const py::dict& given) {
    kernel::Tracks found;
    found.points = problem.slots + 2;
    found.corners = given["corners"].cast<int>();
    expect(found.corners >= 1 && found.corners <= 3, "corners");
    const std::size_t tracks = size_of(given, "uav");
    const std::size_t size = std::size_t(found.points) * tracks * found.corners;
    found.uav = integers(given["uav"], tracks, problem.uavs, "uav");
    found.weights = reals(given["weights"], 3 * size, "weights");
    found.all = reals(given["all"], 3 * size, "all");
    found.constant = reals(given["constant"], 2 * size, "constant");
    for (std::size_t i = 0; i < found.weights.size(); ++i) {
        const std::ptrdiff_t slot =
            std::ptrdiff_t(i / (3 * tracks * found.corners)) + std::ptrdiff_t(i % 3) - 2;
        expect(found.weights[i] == 0.0 || (slot >= 0 && slot < problem.slots), "weights");
    }
    return found;
}

// A LineLimit of one of the three kinds, by what its dictionary holds.
std::shared_ptr<const kernel::LineLimit> lines_of(const kernel::Problem& problem,
                                                  const py::dict& given) {
    kernel::Tracks tracks = tracks_of(problem, given);
    const std::size_t subjects = size_of(given, "first"), corners = tracks.corners;
    const std::size_t entries = tracks.points * subjects * corners;
    const int count = int(tracks.uav.size());
    std::vector<int> second;
    if (!given["second"].is_none()) second = integers(given["second"], subjects, count, "second");
    std::shared_ptr<kernel::LineLimit> found;
    if (given.contains("polygons")) {
        const View<double> polygons(given["polygons"].cast<py::buffer>(), "polygons");
        expect(polygons.axes() == 4 && polygons.shape(3) == 2 && corners >= 2, "polygons");
        const std::size_t uavs = polygons.shape(0), most = polygons.shape(1);
        const std::size_t vertices = polygons.shape(2), lines = given["most_lines"].cast<int>();
        expect(vertices >= 1 && lines >= 1 && lines <= most && uavs * lines == subjects,
               "polygons");
        found = std::make_shared<kernel::ZoneLimit>(
            std::move(tracks), points(given["polygons"], uavs * most * vertices, "polygons"),
            int(uavs), int(most), int(vertices), int(lines));
    } else if (given.contains("radii")) {
        expect(corners >= 2 && second.size() == subjects, "second");
        found = std::make_shared<kernel::SeparationLimit>(
            std::move(tracks), reals(given["radii"], subjects, "radii"));
    } else {
        const std::vector<kernel::Point> normals = points(given["normals"], subjects, "normals");
        const Reals offsets = reals(given["offsets"], subjects, "offsets");
        std::vector<kernel::Line> sides;
        for (std::size_t i = 0; i < subjects; ++i) sides.push_back({normals[i], offsets[i]});
        found = std::make_shared<kernel::FenceLimit>(std::move(tracks), std::move(sides));
    }
    found->set_subjects(integers(given["first"], subjects, count, "first"), std::move(second),
                        flags(given["ignored"], entries, "ignored"));
    return found;
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
    found.slots = given["slots"].cast<int>();
    found.uavs = given["uavs"].cast<int>();
    expect(found.slots >= 1 && found.uavs >= 1, "slots, uavs");
    const std::size_t uavs = found.uavs;
    const auto array = [&given](const char* name, std::size_t size) {
        return reals(given[name], size, name);
    };
    found.starts = array("starts", 2 * uavs);
    found.goals = array("goals", 2 * uavs);
    found.fixed = flags(given["fixed"], uavs, "fixed");
    found.squared_altitudes = array("squared_altitudes", uavs);
    found.peaks = array("peaks", uavs);
    for (const py::handle limit : given["norms"].cast<py::list>())
        found.norms.push_back(norm_of(found, limit.cast<py::dict>()));
    for (const py::handle limit : given["lines"].cast<py::list>())
        found.lines.push_back(lines_of(found, limit.cast<py::dict>()));
    found.numbers = numbers_of(given["numbers"].cast<py::dict>());
    found.receivers = receivers_of(found, given["positions"], given["edge"]);
    found.receivers.snr = array("snr", found.receivers.edge.size());
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
                   && new_x->shape(1) == std::size_t(problem.slots)
                   && new_x->shape(2) == std::size_t(problem.uavs) && new_x->shape(3) == 3, "x");
        x_ = std::move(new_x);
        mu_ = std::move(new_mu);
        finished_ = std::move(new_finished);
    }

    kernel::Starts starts_;
    std::unique_ptr<View<double>> x_, mu_;
    std::unique_ptr<View<bool>> finished_;
};

// The Pairs of channel/inverse_sinr.py in the arrays of Python.
class PairsView {
public:
    explicit PairsView(const py::dict& given)
        : x_(given["x"].cast<py::buffer>(), "x"), y_(given["y"].cast<py::buffer>(), "y"),
          squared_altitudes_(given["squared_altitudes"].cast<py::buffer>(), "squared_altitudes"),
          noise_(given["noise"].cast<py::buffer>(), "noise"),
          radius_(given["radius"].cast<py::buffer>(), "radius"),
          jamming_(given["jamming"].cast<py::buffer>(), "jamming") {
        const std::size_t count = noise_.size(), uavs = squared_altitudes_.size();
        expect(uavs >= 1 && radius_.size() == count, "radius");
        expect(x_.size() == count * uavs && y_.size() == count * uavs, "x, y");
        expect(jamming_.size() == count * (uavs - 1), "jamming");
    }
    kernel::Pairs pairs() const {
        return {noise_.size(), int(squared_altitudes_.size()), x_.data(), y_.data(),
                squared_altitudes_.data(), noise_.data(), radius_.data(), jamming_.data()};
    }

private:
    View<double> x_, y_, squared_altitudes_, noise_, radius_, jamming_;
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

void prove(const py::dict& given, const py::buffer& slot, const py::buffer& most,
           std::int64_t most_sectors, const py::buffer& leaks, const py::buffer& pair,
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
    const kernel::Proof proof{slots.data(), mosts.data(), most_sectors,
                              leak.data(), of_pair.data(), places.data()};
    const py::gil_scoped_release release;
    kernel::prove(pairs, proof, look_for_signals);
}

}  // namespace

PYBIND11_MODULE(_secure_uav_planner_kernel, module) {
    module.doc() = "The compiled form of the joint method's steps and of the worst case.";
    module.attr("sources") = KERNEL_SOURCES;
    module.def("likely_places", &likely_places);
    module.def("prove", &prove);
    py::class_<Barrier>(module, "Barrier")
        .def(py::init<const py::dict&, const py::buffer&, const py::buffer&, const py::buffer&>())
        .def("advance", &Barrier::advance)
        .def("rates", &Barrier::rates)
        .def("exchange", &Barrier::exchange)
        .def("keep", &Barrier::keep);
}
