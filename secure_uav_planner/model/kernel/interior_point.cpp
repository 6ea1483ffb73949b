// Several starts of a problem, advanced side by side on all cores; see joint/interior_point.py.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <future>
#include <memory>
#include <thread>
#include <vector>

#include "array.hpp"
#include "newton.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::copy_flags;
using kernel::copy_reals;
using kernel::count_entries;
using kernel::expect;
using kernel::BarrierProblem;
using kernel::Reals;

namespace {

// Costs are estimated numbers of multiplications. WORTH_THREADS: least cost of steps from several
// starts for which threads pay. WORTH_CHECKS: least cost of steps from a single start during which
// `raise_if_over` is called. MOST_AT_ONCE: largest cost of the steps of one call.
constexpr double WORTH_THREADS = 1e6, WORTH_CHECKS = 5e6, MOST_AT_ONCE = 2e7;
constexpr std::chrono::milliseconds CHECK_INTERVAL{10};  // Time between calls of raise_if_over.

// Check and copy K receivers: G ground nodes, at least one eavesdropper, and listeners. `args` has
// `radii` (N, K), `weights` and `offsets` (G), `positions` (N, K, 2), and indices `listeners`.
kernel::Receivers make_receivers(const BarrierProblem& problem, const py::dict& args) {
    const std::size_t entries = count_entries(args, "radii");
    const std::size_t nodes = count_entries(args, "weights");
    expect(nodes >= 1, "weights");
    const std::size_t count = entries / problem.slots;
    const auto listeners = args["listeners"].cast<std::vector<int>>();
    expect(count > nodes + listeners.size() && entries % problem.slots == 0, "radii");
    for (const int node : listeners) expect(node >= 0 && node < int(nodes), "listeners");
    return {int(count), listeners, copy_reals(args, "weights", nodes),
            copy_reals(args, "offsets", nodes), copy_reals(args, "positions", 2 * entries),
            copy_reals(args, "radii", entries)};
}

// Copy core.pyi's `places`: for each slot and place, whether the place moves along with the UAVs,
// the offset from the disc's centre, and the disc's radius. Places are listed as eavesdroppers.
kernel::Places read_places(const BarrierProblem& problem, const py::dict& args) {
    const std::size_t places = problem.eavesdroppers();
    return {copy_flags(args, "moves_along", problem.slots * places),
            copy_reals(args, "offsets", problem.slots * places * 2),
            copy_reals(args, "radii", problem.slots * places)};
}

// Check and copy the barrier problem of Python's arguments, which core.pyi lists.
BarrierProblem make_problem(const py::dict& args) {
    BarrierProblem problem;
    problem.slots = args["slots"].cast<std::size_t>();
    problem.uavs = args["uavs"].cast<int>();
    expect(problem.slots >= 1 && problem.uavs >= 1, "slots, uavs");
    const std::size_t uavs = problem.uavs;
    problem.starts = copy_reals(args, "starts", 2 * uavs);
    problem.goals = copy_reals(args, "goals", 2 * uavs);
    problem.fixed = copy_flags(args, "fixed", uavs);
    problem.peaks = copy_reals(args, "peaks", uavs);
    for (const py::handle limit : args["limits"].cast<py::list>()) {
        problem.limits.push_back(limit.cast<std::shared_ptr<kernel::Limit>>());
        expect(problem.limits.back()->vectors().fits(problem.slots, uavs), "limits");
    }
    problem.receivers = make_receivers(problem, args);
    problem.gains = args["gains"].cast<std::shared_ptr<kernel::LinkGains>>();
    expect(problem.gains->links() == problem.receivers.count * uavs, "gains");
    problem.colluding = args["colluding"].cast<bool>();
    problem.rate_unit = args["rate_unit"].cast<double>();
    expect(problem.rate_unit > 0.0, "rate_unit");
    problem.energies = args["energies"].cast<std::shared_ptr<kernel::Energies>>();
    expect(!problem.energies || problem.energies->moves().fits(problem.slots, uavs), "energies");
    if (!args["places"].is_none())
        problem.places = read_places(problem, args["places"].cast<py::dict>());
    return problem;
}

// Newton's method for several starts, whose arrays in Python it changes in place; see core.pyi.
class InteriorPointSolver {
public:
    // Initialise S starts: `x` (S, N, U, 3), `shares` (S, N, G), `mu` and `finished` (S), `over`
    // and `prices` (S, U). Steps change these. Here `shares`, and `over` with energies, are filled.
    InteriorPointSolver(const py::dict& args, const py::buffer& x, const py::buffer& shares,
            const py::buffer& mu, const py::buffer& finished, const py::buffer& over,
            const py::buffer& prices)
        : problem_(make_problem(args)), bandwidth_(problem_.bandwidth()), x_(x, "x"),
          mu_(mu, "mu"),
          shares_(shares, "shares", mu_.size() * problem_.slots * problem_.nodes()),
          finished_(finished, "finished", mu_.size()),
          over_(over, "over", mu_.size() * problem_.uavs),
          prices_(prices, "prices", mu_.size() * problem_.uavs) {
        expect(mu_.size() > 0, "mu");
        expect(x_.axes() == 4 && x_.shape(0) == mu_.size() && x_.shape(1) == problem_.slots
                   && x_.shape(2) == std::size_t(problem_.uavs) && x_.shape(3) == 3, "x");
        const std::size_t size = x_.size() / mu_.size();
        iterates_.resize(mu_.size());
        for (std::size_t s = 0; s < mu_.size(); ++s) {
            iterates_[s].x = &x_[s * size];
            iterates_[s].shares = &shares_[s * problem_.slots * problem_.nodes()];
            iterates_[s].mu = &mu_[s];
            iterates_[s].finished = &finished_[s];
            iterates_[s].over = &over_[s * problem_.uavs];
            iterates_[s].prices = &prices_[s * problem_.uavs];
            worker(0).initialise(iterates_[s]);
        }
    }
    InteriorPointSolver(const InteriorPointSolver&) = delete;

    // Take `steps` steps from every start. If steps are expensive, take fewer, at least 1. Return
    // the number of steps, and how many starts failed in the step with most failures. Expensive
    // steps are taken in threads, while `raise_if_over` is called; if it throws, starts that have
    // not yet stepped are left unchanged. With cheap steps, `raise_if_over` is never called.
    py::tuple advance(int steps, double final_mu, const py::function& raise_if_over) {
        std::size_t failed;
        {
            const py::gil_scoped_release release;
            const double cost = estimate_cost();
            steps = int(std::clamp(MOST_AT_ONCE / cost, 1.0, double(std::max(1, steps))));
            stop_ = false;
            next_ = 0;
            failed_ = std::vector<std::atomic<std::size_t>>(steps);
            worker(0);
            if (cost * steps < (iterates_.size() > 1 ? WORTH_THREADS : WORTH_CHECKS))
                take_steps(0, final_mu);
            else
                run_threads(final_mu, raise_if_over);
            failed = *std::max_element(failed_.begin(), failed_.end());
        }
        return py::make_tuple(steps, failed);
    }

    // Fill `rates` (S) with each start's least weighted mean of max(rate - leak, 0) in nats.
    void evaluate_rates(const py::buffer& rates) {
        const Array<double> rate(rates, "rates", iterates_.size());
        const py::gil_scoped_release release;
        for (std::size_t s = 0; s < iterates_.size(); ++s)
            rate[s] = worker(0).evaluate_rate(iterates_[s]);
    }

    // Fill each start's barrier function and gradient, and the objective's Hessian: for tests.
    void evaluate(const py::buffer& values, const py::buffer& gradients,
                  const py::buffer& hessians) {
        const std::size_t row = 3 * problem_.uavs + problem_.nodes() - 1;
        const std::size_t size = problem_.slots * row, starts = iterates_.size();
        const Array<double> value(values, "values", starts);
        const Array<double> gradient(gradients, "gradients", starts * size);
        const Array<double> hessian(hessians, "hessians", starts * size * row);
        for (std::size_t s = 0; s < starts; ++s)
            value[s] = worker(0).evaluate(iterates_[s], &gradient[s * size],
                                          &hessian[s * size * row]);
    }

    // Replace the places, and the positions of all receivers, by the same number of new ones. Throw
    // if the problem was made without places.
    void exchange_places(const py::dict& places, const py::buffer& positions) {
        Reals& current = problem_.receivers.positions;
        expect(!problem_.places.moves_along.empty(), "places");
        kernel::Places made = read_places(problem_, places);
        current = copy_reals(positions, "positions", current.size());
        problem_.places = std::move(made);
        for (kernel::Iterate& iterate : iterates_) iterate.is_evaluated = false;
    }

private:
    // Return a Newton with its own working memory, made at its first use; one for each thread.
    kernel::Newton& worker(std::size_t number) {
        while (workers_.size() <= number) workers_.push_back(kernel::make_newton(problem_));
        return *workers_[number];
    }

    // Run a worker: take all steps of the next start that no thread has taken, until no start is
    // left or stop_ is true. failed_ counts how many starts fail in each step.
    void take_steps(std::size_t number, double final_mu) {
        kernel::Newton& newton = *workers_[number];
        while (!stop_) {
            const std::size_t index = next_++;
            if (index >= iterates_.size()) return;
            for (auto& failed : failed_) {  // One entry for each step.
                if (stop_) return;
                if (newton.take_step(iterates_[index], final_mu, stop_)
                    == kernel::Outcome::failed) ++failed;
            }
        }
    }

    // Take all steps in threads, while the calling thread checks signals and raise_if_over. If one
    // throws, stop the threads and throw again.
    void run_threads(double final_mu, const py::function& raise_if_over) {
        const std::size_t count = std::min<std::size_t>(
            iterates_.size(), std::max(1u, std::thread::hardware_concurrency()));
        worker(count - 1);  // Makes the workers 0 to count - 1.
        // After a throw, the futures join their threads as they are destroyed.
        std::vector<std::future<void>> threads;
        try {
            for (std::size_t number = 0; number < count; ++number)
                threads.push_back(std::async(
                    std::launch::async, &InteriorPointSolver::take_steps, this, number, final_mu));
            for (std::future<void>& thread : threads) {
                while (thread.wait_for(CHECK_INTERVAL) != std::future_status::ready) {
                    kernel::check_signals();
                    const py::gil_scoped_acquire acquire;
                    raise_if_over();
                }
                thread.get();
            }
        } catch (...) {
            stop_ = true;
            throw;
        }
    }

    // Estimate the multiplications of one step from all starts.
    double estimate_cost() const {
        const double row = 3.0 * problem_.uavs + problem_.nodes() - 1, height = bandwidth_ + row;
        return double(iterates_.size()) * double(problem_.slots)
            * (height * height + 4.0 * row * row * problem_.receivers.count);
    }

    BarrierProblem problem_;
    const int bandwidth_;
    Array<double> x_, mu_, shares_;
    Array<bool> finished_, over_;
    Array<double> prices_;
    std::vector<kernel::Iterate> iterates_;
    std::vector<std::unique_ptr<kernel::Newton>> workers_;
    std::atomic<bool> stop_{false};
    std::atomic<std::size_t> next_{0};
    std::vector<std::atomic<std::size_t>> failed_;  // Number of starts that failed in each step.
};

}  // namespace

void add_interior_point(py::module_& module) {
    py::class_<InteriorPointSolver>(module, "InteriorPointSolver")
        .def(py::init<const py::dict&, const py::buffer&, const py::buffer&, const py::buffer&,
                      const py::buffer&, const py::buffer&, const py::buffer&>())
        .def("advance", &InteriorPointSolver::advance)
        .def("evaluate_rates", &InteriorPointSolver::evaluate_rates)
        .def("evaluate", &InteriorPointSolver::evaluate)
        .def("exchange_places", &InteriorPointSolver::exchange_places);
}
