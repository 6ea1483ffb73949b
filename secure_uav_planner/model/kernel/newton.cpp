// A primal-dual interior-point method for (P1) and (P2), one start at a time.
//
// Rates have the objective, in nats; Constraints have the barrier terms. A limit couples a few
// neighbouring slots. An average power, or a ground node, couples all slots by one dense row. So
// the Hessian is a band plus a few rows, and the time of a step is linear in the number of slots.
#include "newton.hpp"

#include <algorithm>

#include "constraints.hpp"
#include "line_search.hpp"
#include "linear.hpp"
#include "rates.hpp"

namespace kernel {

namespace {

// Linear and superlinear decrease of mu: kappa_mu and theta_mu of IPOPT.
constexpr double MU_FACTOR = 0.2, MU_POWER = 1.5;
// Largest Newton decrement, for each UAV, at which mu decreases.
constexpr double CENTRED = 0.5;
// Number of steps with one mu after which mu decreases in any case.
constexpr int PATIENCE = 15;
// Newton decrement below which a start has converged.
constexpr double CONVERGED = 0.01;
// Expected gain of a step, in units of rates for each slot, below which a start has converged.
constexpr double NEGLIGIBLE = 1e-8;

// Decide after a step whether the start has finished, and lower its barrier parameter mu, but not
// below `final_mu`, if it is centred or stalled. A start is stalled after PATIENCE steps with one
// mu, or by a step of `length` 0. `decrement` is -(gradient . step) / (N mu).
void update_mu(Iterate& iterate, int uavs, double length, double decrement, double final_mu) {
    const double mu = *iterate.mu;
    ++iterate.steps_at_mu;
    const bool stalled = iterate.steps_at_mu >= PATIENCE || length == 0.0;
    const bool centred = decrement <= CENTRED * uavs && length > 0.5;
    const bool converged = decrement <= std::max(CONVERGED, NEGLIGIBLE / mu);
    *iterate.finished = mu <= final_mu && (converged || stalled);
    if ((centred || stalled) && mu > final_mu) {
        iterate.steps_at_mu = 0;
        *iterate.mu = std::max(final_mu, std::min(MU_FACTOR * mu, std::pow(mu, MU_POWER)));
        iterate.is_evaluated = false;
    }
}

// UAVS is the number of UAVs if it is known when compiling, or 0 for any number. Model is the
// channel model, or LinkGains for any model.
template <int UAVS, class Model>
class PrimalDualNewton final : public Newton {
public:
    // Dense rows belong to U average powers, G nodes if G > 1, and U energies if they are limited.
    // The rows of the average powers are set here: they are the gradients of 1 - mean power.
    explicit PrimalDualNewton(const BarrierProblem& problem)
        : p_(problem), size_(3 * p_.uavs),
          energy_rows_(p_.uavs + (p_.shares() ? p_.nodes() : 0)),
          rows_(energy_rows_ + (p_.energies ? p_.uavs : 0)),
          rates_(problem), constraints_(problem), line_search_(problem),
          system_(p_.slots, p_.uavs, p_.shares(), rows_, p_.bandwidth(), p_.rate_unit),
          gradient_(p_.variables()), step_(p_.variables() + p_.bandwidth()), ratios_(rows_) {
        for (int j = 0; j < size_; ++j)
            if (p_.fixed[j / 3] && j % 3 > 0) fixed_.push_back(j);
        for (std::size_t i = 0; i < p_.slots * p_.uavs; ++i)
            system_.rows[3 * i * rows_ + i % p_.uavs] = -1.0 / double(p_.slots);
    }

    // Find the shares that are best for x, choose lines, decide which energies get prices,
    // evaluate, and set duals: to the price, or to the weight of the barrier term over the slack.
    void initialise(Iterate& iterate) override {
        const double mu = mu_in_nats(iterate);
        Evaluation& here = iterate.evaluation;
        std::fill(iterate.shares, iterate.shares + p_.slots * p_.nodes(), 1.0 / p_.nodes());
        if (p_.shares()) {
            rates_.evaluate(iterate.x, iterate.shares, mu, here);
            rates_.nodes.find_shares(mu, here, iterate.shares);
        }
        constraints_.choose_lines(iterate.x, here, trial_);
        constraints_.initialise_energies(iterate, mu);
        evaluate_at(iterate, iterate.x, iterate.shares, mu, here);
        iterate.is_evaluated = true;
        constraints_.initialise_duals(iterate, mu);
        for (const double slack : here.leak_slacks) iterate.leak_duals.push_back(mu / slack);
        for (const double slack : here.node_slacks) iterate.node_duals.push_back(mu / slack);
    }

    // Take a step: differentiate, solve the linear system, search along the step, move, lower mu.
    // If the system cannot be solved, the step is 0 and the outcome is `failed`. Then, or if no
    // trial is better, x and shares stay, duals move, and update_mu takes the start for stalled. If
    // an energy's price rises, mu stays. Once `stop` is true, return early: x, shares and mu stay.
    Outcome take_step(Iterate& iterate, double final_mu, const std::atomic<bool>& stop) override {
        const double mu = mu_in_nats(iterate);
        update_evaluation(iterate);
        if (constraints_.have_lines) constraints_.clip_duals(iterate, mu);
        if (stop) return Outcome::stopped;
        rates_.differentiate(iterate, mu, gradient_.data(), system_.blocks.data());
        if (stop) return Outcome::stopped;
        assemble(iterate, mu);
        if (stop) return Outcome::stopped;
        const bool solved = system_.solve(gradient_.data(), ratios_.data(), step_.data(), stop);
        if (stop) return Outcome::stopped;
        if (!solved) std::fill(step_.begin(), step_.end(), 0.0);
        constraints_.find_slopes(step_.data(), iterate.evaluation);
        double slope = 0.0;
        for (std::size_t i = 0; i < gradient_.size(); ++i) slope += step_[i] * gradient_[i];
        const double length = line_search_.search(
            iterate, step_, gradient_, slope, constraints_, stop, [&] {
                evaluate_at(iterate, line_search_.x.data(), line_search_.shares.data(), mu, trial_);
                return trial_.value;
            });
        if (stop) return Outcome::stopped;
        move(iterate, mu, length > 0.0);
        if (constraints_.raise_prices(iterate, mu))
            iterate.steps_at_mu = 0;
        else
            update_mu(iterate, p_.uavs, length, -slope / (double(p_.slots) * mu), final_mu);
        return solved ? Outcome::stepped : Outcome::failed;
    }

    double evaluate_rate(const Iterate& iterate) override {
        return rates_.compute_least_mean(iterate);
    }

    // Return the barrier function; fill its gradient and the objective's Newton matrix: for tests.
    double evaluate(Iterate& iterate, double* gradient, double* hessian) override {
        iterate.is_evaluated = false;  // The caller may have changed the iterate's arrays.
        update_evaluation(iterate);
        rates_.differentiate(iterate, mu_in_nats(iterate), gradient, hessian);
        constraints_.add_gradient(iterate, mu_in_nats(iterate), gradient);
        return iterate.evaluation.value;
    }

private:
    double mu_in_nats(const Iterate& iterate) const { return *iterate.mu * p_.rate_unit; }

    // Choose lines, and evaluate the iterate. If it was evaluated, evaluate only limits with lines.
    void update_evaluation(Iterate& iterate) {
        const double mu = mu_in_nats(iterate);
        constraints_.choose_lines(iterate.x, iterate.evaluation, trial_);
        if (iterate.is_evaluated)
            constraints_.evaluate_lines(mu, iterate.evaluation);
        else
            evaluate_at(iterate, iterate.x, iterate.shares, mu, iterate.evaluation);
    }

    void evaluate_at(const Iterate& iterate, const double* x, const double* shares, double mu,
                     Evaluation& here) {
        const double objective = rates_.evaluate(x, shares, mu, here);
        constraints_.evaluate(iterate, x, shares, objective, mu, here);
    }

    // Complete the linear system from the derivatives of the rates. The Hessian is a band plus
    // row row^T / ratio of each dense row. The band is the sum of the slots' blocks and the limits'
    // curvature. Variables in `fixed_` get derivatives of 0 and a pivot of 1, so their steps are 0.
    void assemble(const Iterate& iterate, double mu) {
        const Band band{system_.band.data(), system_.height()};
        constraints_.add_gradient(iterate, mu, gradient_.data());
        if (p_.energies)
            constraints_.fill_energy_rows(
                iterate, rows_, &system_.rows[energy_rows_], &ratios_[energy_rows_]);
        if (p_.shares())
            rates_.nodes.fill_rows(iterate, rows_, &system_.rows[p_.uavs], &ratios_[p_.uavs]);
        for (std::size_t i = 0; i < system_.share_curvatures.size(); ++i)
            system_.share_curvatures[i] = constraints_.share_curvature(iterate, i);
        std::fill(system_.band.begin(), system_.band.end(), 0.0);
        for (std::size_t n = 0; n < p_.slots; ++n) {
            for (const int j : fixed_) clear(n, j);
            system_.add_slot(n);
            for (const int j : fixed_) band.entries[(n * size_ + j) * band.height] = 1.0;
        }
        constraints_.add_curvature(iterate, band);
        for (int u = 0; u < p_.uavs; ++u) ratios_[u] = constraints_.mean_ratio(iterate, u);
    }

    // Set all derivatives by variable j of x in slot n to zero.
    void clear(std::size_t n, int j) {
        const int width = size_ + p_.shares();
        double* block = &system_.blocks[n * width * width];
        for (int i = 0; i < width; ++i) block[i * width + j] = block[j * width + i] = 0.0;
        std::fill_n(&system_.rows[(n * size_ + j) * rows_], rows_, 0.0);
        gradient_[n * size_ + j] = 0.0;
    }

    // Move all duals along their step, with one length of at most 1 that keeps them positive. Move
    // x, shares and evaluation to the line search's last trial if it was `taken`. Clip the duals.
    void move(Iterate& iterate, double mu, bool taken) {
        double length = 1.0;
        constraints_.find_dual_changes(iterate, mu, length);
        rates_.update_duals(iterate, step_.data(), mu, rows_, &system_.rows[p_.uavs], length);
        constraints_.move_duals(iterate, length);
        if (taken) {
            std::copy(line_search_.x.begin(), line_search_.x.end(), iterate.x);
            std::copy(line_search_.shares.begin(), line_search_.shares.end(), iterate.shares);
            std::swap(iterate.evaluation, trial_);
        }
        constraints_.clip_duals(iterate, mu);
        iterate.is_evaluated = true;
    }

    const BarrierProblem& p_;
    const int size_;  // Number of variables in x of a slot.
    // Numbers of dense rows: one for each average power and each of several nodes, and of all rows,
    // with one for each limited energy behind them.
    const int energy_rows_, rows_;
    Rates<UAVS, Model> rates_;
    Constraints<UAVS> constraints_;
    LineSearch<UAVS> line_search_;
    NewtonSystem<UAVS> system_;
    Evaluation trial_;
    Reals gradient_, step_, ratios_;
    std::vector<int> fixed_;  // Indices of the variables in x of a slot that do not vary.
};

// Make a Newton for a channel model, compiled for 1, 2, 3 or 4 UAVs, or for any number.
template <class Model>
std::unique_ptr<Newton> make_newton_for(const BarrierProblem& problem) {
    switch (problem.uavs) {
        case 1: return std::make_unique<PrimalDualNewton<1, Model>>(problem);
        case 2: return std::make_unique<PrimalDualNewton<2, Model>>(problem);
        case 3: return std::make_unique<PrimalDualNewton<3, Model>>(problem);
        case 4: return std::make_unique<PrimalDualNewton<4, Model>>(problem);
        default: return std::make_unique<PrimalDualNewton<0, Model>>(problem);
    }
}

}  // namespace

// Make a Newton that is compiled for the problem's channel model, or for any other model.
std::unique_ptr<Newton> make_newton(const BarrierProblem& problem) {
    const LinkGains* gains = problem.gains.get();
    if (dynamic_cast<const FreeSpace*>(gains)) return make_newton_for<FreeSpace>(problem);
    if (dynamic_cast<const PathLoss*>(gains)) return make_newton_for<PathLoss>(problem);
    return std::make_unique<PrimalDualNewton<0, LinkGains>>(problem);
}

}  // namespace kernel
