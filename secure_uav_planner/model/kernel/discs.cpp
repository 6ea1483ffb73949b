// The largest leak over the discs of a slot, proven; see channel/worst_case.py.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "array.hpp"
#include "inverse_sinr.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::Candidate;
using kernel::copy_reals;
using kernel::count_entries;
using kernel::Discs;
using kernel::expect;
using kernel::INFINITE;
using kernel::PI;
using kernel::Sector;

namespace {

// Excess [bit/s/Hz] of a proven leak over the largest leak found that callers accept.
constexpr double TOLERANCE = 8e-7;
constexpr double LOG_2 = 0.69314718055994530942;
constexpr std::int64_t CHECK_INTERVAL = 200000;  // Sectors between two checks for signals.

double find_leak(double inverse_sinr) { return std::log1p(1.0 / inverse_sinr) / LOG_2; }
double invert_leak(double leak) { return 1.0 / std::expm1(leak * LOG_2); }

// A branch and bound over the discs of one slot after the other.
//
// Discs are divided into sectors of rings. A sector is dropped if its bound shows that the leak in
// it is at most `tolerance` above the incumbent. The search of a slot ends when no sector is left,
// or after `most_sectors`. The result includes the bounds of the sectors that are left: it is
// valid in both cases, but less tight in the second.
class DiscSearch {
public:
    // `formula_bounds` (P): upper bound of each disc's leak by a formula [bit/s/Hz].
    DiscSearch(const Discs& discs, const double* formula_bounds, std::int64_t most_sectors,
               double tolerance)
        : discs_(discs), problem_(make_disc_problem(discs)), formula_bounds_(formula_bounds),
          most_sectors_(most_sectors), tolerance_(tolerance) {}

    // Find leak(), an upper bound [bit/s/Hz] of the leak in a slot's discs `begin` to `end` - 1,
    // and the incumbent, the place with the largest leak found. Return how many sectors it bounded.
    std::int64_t search(std::size_t begin, std::size_t end) {
        const double dropped = drop_discs(begin, end);
        // Branch and bound of the other discs, level by level; the first level has whole discs.
        level_.clear();
        for (const std::size_t disc : active_)
            level_.push_back(
                {disc, 0.0, discs_.radius[disc], 0.0, PI, invert_leak(formula_bounds_[disc])});
        double proven = INFINITE;  // The least bound of 1 / SINR in sectors not divided further.
        std::int64_t examined = 0;
        while (!level_.empty()) {
            examined += std::int64_t(level_.size());
            bound_level();
            const double accepted_inverse =
                invert_leak(find_leak(incumbent_.inverse_sinr) + tolerance_);
            next_level_.clear();
            for (const Sector& sector : level_) {
                if (sector.bound < accepted_inverse && examined < most_sectors_) divide(sector);
                else proven = std::min(proven, sector.bound);
            }
            level_.swap(next_level_);
        }
        leak_ = std::max(dropped, find_leak(std::min(proven, incumbent_.inverse_sinr)));
        return examined;
    }

    double leak() const { return leak_; }  // No place of the slot's discs leaks more.
    const Candidate& incumbent() const { return incumbent_; }
    std::size_t incumbent_disc() const { return incumbent_disc_; }

private:
    void update_incumbent(std::size_t disc, const Candidate& candidate) {
        if (!(candidate.inverse_sinr < incumbent_.inverse_sinr)) return;
        incumbent_ = candidate;
        incumbent_disc_ = disc;
    }

    // Find the incumbent in two passes over discs `begin` to `end` - 1: by the place nearest to the
    // transmitter, then by a local search. After each pass, drop from active_ discs whose formula
    // bound is at most the incumbent's leak plus the tolerance. Return the largest formula bound
    // [bit/s/Hz] of the dropped discs, or 0.
    double drop_discs(std::size_t begin, std::size_t end) {
        incumbent_ = {INFINITE, 0.0, 0.0};
        incumbent_disc_ = begin;
        active_.clear();
        for (std::size_t disc = begin; disc < end; ++disc) active_.push_back(disc);
        for (const bool descend : {false, true}) {
            for (const std::size_t disc : active_) {
                problem_->select(disc);
                update_incumbent(disc, descend ? problem_->find_local_minimum()
                                               : problem_->evaluate_nearest());
            }
            const double accepted = find_leak(incumbent_.inverse_sinr) + tolerance_;
            active_.erase(std::remove_if(active_.begin(), active_.end(), [&](std::size_t disc) {
                return !(formula_bounds_[disc] > accepted);
            }), active_.end());
        }
        double largest = 0.0;
        for (std::size_t disc = begin; disc < end; ++disc)
            if (!std::binary_search(active_.begin(), active_.end(), disc))
                largest = std::max(largest, formula_bounds_[disc]);
        return largest;
    }

    // Raise the bound of each sector of a level to the sector's lower bound of the inverse SINR. If
    // the middle of a sector is better than the incumbent, descend from the best such place.
    void bound_level() {
        Candidate best = incumbent_;
        std::size_t best_disc = incumbent_disc_, selected = discs_.count;
        for (Sector& sector : level_) {
            if (sector.disc != selected) problem_->select(selected = sector.disc);
            Candidate candidate;
            const double bound = problem_->bound_sector(sector, candidate);
            // A sector's bound is at least its parent's. A bound that is NaN is ignored.
            if (bound > sector.bound) sector.bound = bound;
            if (candidate.inverse_sinr < best.inverse_sinr) {
                best = candidate;
                best_disc = sector.disc;
            }
        }
        if (!(best.inverse_sinr < incumbent_.inverse_sinr)) return;
        problem_->select(best_disc);
        update_incumbent(best_disc, problem_->descend(best));
    }

    // Add the parts of a sector to the next level. A whole disc is divided into a disc of half the
    // radius and six sectors of the ring around it, any other sector into four.
    void divide(const Sector& sector) {
        const double middle = 0.5 * (sector.inner + sector.outer);
        Sector part = sector;
        if (sector.is_whole()) {
            part.outer = middle;
            part.half = PI;
            next_level_.push_back(part);
            part.inner = middle;
            part.outer = sector.outer;
            part.half = PI / kernel::RAYS;
            for (int ray = 1; ray <= kernel::RAYS; ++ray) {
                part.middle = sector.middle + ray * (2.0 * PI / kernel::RAYS);
                next_level_.push_back(part);
            }
            return;
        }
        part.half = 0.5 * sector.half;
        for (const double angle : {-part.half, part.half}) {
            part.middle = sector.middle + angle;
            part.inner = sector.inner;
            part.outer = middle;
            next_level_.push_back(part);
            part.inner = middle;
            part.outer = sector.outer;
            next_level_.push_back(part);
        }
    }

    const Discs& discs_;
    std::unique_ptr<kernel::DiscProblem> problem_;
    const double* formula_bounds_;
    std::int64_t most_sectors_;
    double tolerance_, leak_ = 0.0;
    Candidate incumbent_{};
    std::size_t incumbent_disc_ = 0;
    std::vector<std::size_t> active_;
    std::vector<Sector> level_, next_level_;
};

// Copy P discs from Python's arguments: noise = 1 / (p_0 SNR_0) and radius, (P), places x and y of
// the UAVs from the disc's centre, (U, P), and jamming = p_j SNR_j / (p_0 SNR_0), (U - 1, P).
Discs make_discs(const py::dict& args) {
    const std::size_t count = count_entries(args, "noise");
    const std::size_t uavs = count_entries(args, "squared_altitudes");
    expect(uavs >= 1, "squared_altitudes");
    Discs discs;
    discs.count = count;
    discs.uavs = int(uavs);
    discs.x = copy_reals(args, "x", count * uavs);
    discs.y = copy_reals(args, "y", count * uavs);
    discs.squared_altitudes = copy_reals(args, "squared_altitudes", uavs);
    discs.noise = copy_reals(args, "noise", count);
    discs.radius = copy_reals(args, "radius", count);
    discs.jamming = copy_reals(args, "jamming", count * (uavs - 1));
    if (args.contains("channel")) {
        discs.channel = args["channel"].cast<std::shared_ptr<kernel::PathLoss>>();
        expect(discs.channel->links() == uavs, "channel");
    }
    return discs;
}

// Fill `minima`, (3, P), with a local minimum of the inverse SINR in each of P discs: its value,
// and its place's x and y from the disc's centre [m].
void find_local_minima(const py::dict& args, const py::buffer& minima) {
    const Discs discs = make_discs(args);
    const Array<double> minimum(minima, "minima", 3 * discs.count);
    const py::gil_scoped_release release;
    const std::unique_ptr<kernel::DiscProblem> problem = make_disc_problem(discs);
    for (std::size_t i = 0; i < discs.count; ++i) {
        problem->select(i);
        const Candidate candidate = problem->find_local_minimum();
        minimum[i] = candidate.inverse_sinr;
        minimum[discs.count + i] = candidate.x;
        minimum[2 * discs.count + i] = candidate.y;
    }
}

// Fill `bounds` (P) with a lower bound of the inverse SINR in one sector of each disc, and `values`
// (P) with the inverse SINR in the middle of each sector: for tests.
void bound_sectors(const py::dict& args, const py::dict& sectors, const py::buffer& bounds,
                   const py::buffer& values) {
    const Discs discs = make_discs(args);
    const std::size_t count = discs.count;
    const Array<double> bound(bounds, "bounds", count), value(values, "values", count);
    const Array<const double> inner(sectors, "inner", count), outer(sectors, "outer", count);
    const Array<const double> middle(sectors, "middle", count), half(sectors, "half", count);
    const std::unique_ptr<kernel::DiscProblem> problem = make_disc_problem(discs);
    for (std::size_t i = 0; i < count; ++i) {
        problem->select(i);
        Candidate candidate;
        bound[i] = std::max(0.0, problem->bound_sector(
            {i, inner[i], outer[i], middle[i], half[i], 0.0}, candidate));
        value[i] = candidate.inverse_sinr;
    }
}

// Prove for every slot an upper bound of the leak [bit/s/Hz] to an eavesdropper anywhere in its
// discs, by branch and bound: at most `tolerance` above the largest leak found, unless the search
// ends after `most_sectors`. `slots` (P): slot of each disc, ascending. `most` (P): upper bound of
// each disc's leak by a formula. `leaks` (N) gets the bounds; `worst_discs` (N) and `places` (N, 2)
// get the disc, and the place from its centre [m], with the largest leak found in each slot.
void prove_leaks(const py::dict& args, const py::buffer& slots, const py::buffer& most,
                 std::int64_t most_sectors, double tolerance, const py::buffer& leaks,
                 const py::buffer& worst_discs, const py::buffer& places) {
    const Discs discs = make_discs(args);
    const Array<const std::int64_t> slot_of(slots, "slots", discs.count);
    const Array<const double> formula_bound(most, "most", discs.count);
    const Array<double> leak(leaks, "leaks");
    const Array<std::int64_t> worst_disc(worst_discs, "discs", leak.size());
    const Array<double> place(places, "places", 2 * leak.size());
    for (std::size_t i = 0; i < discs.count; ++i)
        expect(slot_of[i] >= (i ? slot_of[i - 1] : 0) && std::size_t(slot_of[i]) < leak.size(),
               "slots");
    const py::gil_scoped_release release;
    DiscSearch search(discs, formula_bound.data(), most_sectors, tolerance);
    std::int64_t examined = 0;  // Sectors since the last check for signals, and one a slot.
    for (std::size_t begin = 0, end = 0; begin < discs.count; begin = end) {
        const std::int64_t slot = slot_of[begin];
        while (end < discs.count && slot_of[end] == slot) ++end;
        examined += search.search(begin, end) + 1;
        leak[slot] = search.leak();
        worst_disc[slot] = std::int64_t(search.incumbent_disc());
        place[2 * slot] = search.incumbent().x;
        place[2 * slot + 1] = search.incumbent().y;
        if (examined < CHECK_INTERVAL) continue;
        kernel::check_signals();
        examined = 0;
    }
}

}  // namespace

void add_discs(py::module_& module) {
    module.attr("TOLERANCE") = TOLERANCE;
    module.def("find_local_minima", &find_local_minima);
    module.def("bound_sectors", &bound_sectors);
    module.def("prove_leaks", &prove_leaks);
}
