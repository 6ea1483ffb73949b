// A primal-dual interior-point method for (P1) and (P2), one start at a time.
//
// The objective is the sum over slots of the largest leak less r_0, in nats; with several ground
// nodes see Rates. Each slack c > 0 of a limit, and each share of a slot, has the term -mu log c,
// that of an average power N times as much. The largest leak t has -mu log(t - leak) for every
// eavesdropper; t is eliminated slot by slot. Limits couple few neighbouring slots, average powers
// and nodes all by one row each, so the Hessian is a band and a few rows, and a step costs time
// linear in the number of slots.
#include "newton.hpp"

#include <algorithm>

#include "linear.hpp"
#include "rates.hpp"

namespace kernel {

namespace {

constexpr double POWER_FACTOR = 10.0;  // By which a power may change in a step.
// Trials of the line search that stop every variable at its own limit, and those along the step.
constexpr int CLIPPED_TRIALS = 3, UNIFORM_TRIALS = 17;
constexpr double ROUNDING = 1e-12;  // Relative change of the barrier function that is rounding.
constexpr double ARMIJO = 1e-4;     // Share of the expected decrease that is sufficient.
constexpr double DUAL_RANGE = 1e4;  // How far a dual may leave its central value, as a factor.
// Linear and superlinear decrease of mu, kappa_mu and theta_mu of IPOPT, and when: at most this
// Newton decrement for each UAV, or this many steps for one mu.
constexpr double MU_FACTOR = 0.2, MU_POWER = 1.5, CENTRED = 0.5;
constexpr int PATIENCE = 15;
// The Newton decrement, or the gain in units of rates a slot, below which a start has converged.
constexpr double CONVERGED = 0.01, NEGLIGIBLE = 1e-8;

// For numbers of UAVs and channel models as Rates are.
template <int UAVS, class Model>
class PrimalDualNewton final : public Newton {
public:
    explicit PrimalDualNewton(const Problem& problem)
        : p_(problem), slots_(problem.slots), count_(problem.uavs), nodes_(problem.nodes()),
          shares_(nodes_ - 1), node_rows_(shares_ ? nodes_ : 0), rates_(problem),
          system_(slots_, count_, shares_, count_ + node_rows_, problem.bandwidth(),
                  problem.rate_unit) {
        const std::size_t size = slots_ * 3 * count_, all = size + slots_ * shares_;
        line_sets_.resize(p_.limits.size());
        slopes_.resize(kinds());
        dual_changes_.resize(kinds());
        has_lines_ = std::any_of(p_.limits.begin(), p_.limits.end(),
                                 [](const auto& limit) { return limit->has_lines(); });
        gradient_.resize(all);
        step_.resize(all + problem.bandwidth());
        trial_x_.resize(size);
        trial_shares_.assign(slots_ * nodes_, 1.0);
        lengths_.resize(count_);
        ratios_.resize(count_ + node_rows_);
        mean_changes_.resize(count_);
        const std::size_t rows = ratios_.size();
        for (std::size_t i = 0; i < slots_ * count_; ++i)
            system_.rows[3 * i * rows + i % count_] = -1.0 / double(slots_);
    }

    void initialise(Iterate& iterate) override {
        const double mu = find_mu(iterate);
        std::fill(iterate.shares, iterate.shares + slots_ * nodes_, 1.0 / nodes_);
        if (shares_) {
            rates_.evaluate(iterate.x, iterate.shares, mu, iterate.evaluation);
            rates_.find_shares(mu, iterate.evaluation, iterate.shares);
        }
        choose_lines(iterate.x, iterate.evaluation);
        find_slacks(iterate.x, iterate.shares, iterate.evaluation);
        for (const Slacks& slacks : iterate.evaluation.slacks) {
            iterate.duals.push_back(slacks.values);
            for (double& dual : iterate.duals.back()) dual = mu / dual;
        }
        for (const double slack : iterate.evaluation.mean_slacks)
            iterate.mean_duals.push_back(double(slots_) * mu / slack);
    }

    Outcome take_step(Iterate& iterate, double final_mu, const std::atomic<bool>& stop) override {
        const double mu = find_mu(iterate);
        Evaluation& here = iterate.evaluation;
        update_evaluation(iterate);
        if (has_lines_) clip_duals(iterate, here, mu);
        if (stop) return Outcome::stopped;
        rates_.differentiate(iterate, mu, gradient_.data(), system_.blocks.data());
        if (stop) return Outcome::stopped;
        add_gradient_of_limits(here, mu, gradient_.data());
        add_gradient_of_energy(iterate.x, gradient_.data());
        clear_fixed(gradient_.data(), 1);
        if (shares_) {
            rates_.fill_rows(iterate, int(ratios_.size()), &system_.rows[uavs()],
                             &ratios_[uavs()]);
            clear_fixed(system_.rows.data(), ratios_.size());
        }
        assemble(iterate);
        if (stop) return Outcome::stopped;
        const bool solved = system_.solve(gradient_.data(), ratios_.data(), step_.data(), stop);
        if (stop) return Outcome::stopped;
        if (!solved) std::fill(step_.begin(), step_.end(), 0.0);
        find_slopes(here);

        double slope = 0.0;
        for (std::size_t i = 0; i < gradient_.size(); ++i) slope += step_[i] * gradient_[i];
        const double length = search_line(iterate, mu, slope, stop);
        if (stop) return Outcome::stopped;
        const bool moved = length > 0.0;
        update_duals(iterate, mu, moved);
        if (moved) {
            std::copy(trial_x_.begin(), trial_x_.end(), iterate.x);
            std::copy(trial_shares_.begin(), trial_shares_.end(), iterate.shares);
            std::swap(here, trial_);
        }
        iterate.is_evaluated = true;
        update_mu(iterate, length, -slope / (double(slots_) * mu), final_mu);
        return solved ? Outcome::stepped : Outcome::failed;
    }

    double evaluate_rate(const Iterate& iterate) override {
        return rates_.find_mean(iterate.x, iterate.shares);
    }

    double evaluate(Iterate& iterate, double* gradient, double* hessian) override {
        update_evaluation(iterate);
        rates_.differentiate(iterate, find_mu(iterate), gradient, hessian);
        add_gradient_of_limits(iterate.evaluation, find_mu(iterate), gradient);
        add_gradient_of_energy(iterate.x, gradient);
        return iterate.evaluation.value;
    }

private:
    int uavs() const { return UAVS ? UAVS : count_; }
    int size() const { return 3 * uavs(); }
    // The numbers of kinds of slacks: of limits, peaks and shares.
    std::size_t kinds() const { return p_.limits.size() + (shares_ ? 2 : 1); }

    // The barrier parameter in nats.
    double find_mu(const Iterate& iterate) const { return *iterate.mu * p_.rate_unit; }

    // Find the points of flights from start to goal, or of their moves, (N + 2, U, 2).
    void find_path(const double* x, bool with_ends) {
        const std::size_t width = 2 * uavs();
        path_.assign((slots_ + 2) * width, 0.0);
        if (with_ends) {
            std::copy(p_.starts.begin(), p_.starts.end(), path_.begin());
            std::copy(p_.goals.begin(), p_.goals.end(), path_.end() - width);
        }
        for (std::size_t i = 0; i < slots_ * uavs(); ++i) {
            path_[width + 2 * i] = x[3 * i + 1];
            path_[width + 2 * i + 1] = x[3 * i + 2];
        }
    }

    void choose_lines(const double* x, Evaluation& here) {
        here.slacks.resize(kinds());
        trial_.slacks.resize(kinds());
        if (has_lines_) find_path(x, true);
        for (std::size_t l = 0; l < p_.limits.size(); ++l) {
            if (p_.limits[l]->has_lines()) p_.limits[l]->choose_lines(path_.data(), line_sets_[l]);
            here.slacks[l].lines = trial_.slacks[l].lines = &line_sets_[l];
        }
    }

    // Choose lines and evaluate the iterate; if only lines changed, only their terms.
    void update_evaluation(Iterate& iterate) {
        Evaluation& here = iterate.evaluation;
        choose_lines(iterate.x, here);
        if (!iterate.is_evaluated) {
            evaluate_barrier(iterate.x, iterate.shares, find_mu(iterate), here);
            return;
        }
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            if (p_.limits[l]->has_lines())
                p_.limits[l]->find_slacks(path_.data(), here.slacks[l]);
        add_lines(find_mu(iterate), here);
    }

    void add_logarithms(const Evaluation& here, bool with_lines, LogSum& sum) const {
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            if (p_.limits[l]->has_lines() == with_lines)
                for (const double slack : here.slacks[l].values) sum.add(slack);
    }

    void add_lines(double mu, Evaluation& here) const {
        LogSum sum;
        add_logarithms(here, true, sum);
        const double value = here.value_without_lines - mu * sum.total();
        here.value = std::isfinite(value) ? value : INFINITE;
    }

    void find_slacks(const double* x, const double* shares, Evaluation& here) {
        const int U = uavs();
        find_path(x, true);
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->find_slacks(path_.data(), here.slacks[l]);
        if (shares_) here.slacks.back().values.assign(shares, shares + slots_ * nodes_);
        Reals& peaks = here.slacks[p_.limits.size()].values;
        peaks.resize(slots_ * U * 2);
        here.mean_slacks.assign(U, 0.0);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const std::size_t i = n * U + u;
                const double power = x[3 * i];
                peaks[2 * i] = power;
                peaks[2 * i + 1] = 1.0 - power / p_.peaks[u];
                here.mean_slacks[u] += power;
            }
        for (double& sum : here.mean_slacks) sum = 1.0 - sum / double(slots_);
    }

    void find_slopes(const Evaluation& here) {
        const int U = uavs();
        find_path(step_.data(), false);
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->find_slopes(here.slacks[l], path_.data(), slopes_[l]);
        Reals& peaks = slopes_[p_.limits.size()].values;
        peaks.resize(slots_ * U * 2);
        for (std::size_t i = 0; i < slots_ * U; ++i) {
            peaks[2 * i] = step_[3 * i];
            peaks[2 * i + 1] = -step_[3 * i] / p_.peaks[i % U];
        }
        if (!shares_) return;
        Reals& changes = slopes_.back().values;
        changes.assign(slots_ * nodes_, 0.0);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int s = 0; s < shares_; ++s) {
                const double change = step_[slots_ * size() + n * shares_ + s];
                changes[n * nodes_] -= change;
                changes[n * nodes_ + 1 + s] = change;
            }
    }

    void evaluate_barrier(const double* x, const double* shares, double mu, Evaluation& here) {
        double value = rates_.evaluate(x, shares, mu, here);
        find_slacks(x, shares, here);
        if (p_.energy) value += p_.energy->find_value(path_.data());
        LogSum sum;
        add_logarithms(here, false, sum);
        for (std::size_t l = p_.limits.size(); l < kinds(); ++l)
            for (const double slack : here.slacks[l].values) sum.add(slack);
        value -= mu * sum.total();
        for (const double slack : here.mean_slacks) value -= double(slots_) * mu * std::log(slack);
        here.value_without_lines = value;
        add_lines(mu, here);
    }

    // Set the derivatives by fixed positions, several of each, to zero.
    void clear_fixed(double* derivatives, std::size_t several) const {
        const int U = uavs();
        for (int u = 0; u < U; ++u)
            if (p_.fixed[u])
                for (std::size_t n = 0; n < slots_; ++n) {
                    double* at = derivatives + ((n * U + u) * 3 + 1) * several;
                    std::fill(at, at + 2 * several, 0.0);
                }
    }

    void add_gradient_of_limits(const Evaluation& here, double mu, double* gradient) const {
        const int U = uavs(), V = size();
        const Reals& peaks = here.slacks[p_.limits.size()].values;
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->add_gradient(here.slacks[l], mu, gradient);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const double* slacks = &peaks[(n * U + u) * 2];
                gradient[n * V + 3 * u] += mu / here.mean_slacks[u]  // (N mu / c) / N
                    - mu / slacks[0] + mu / slacks[1] / p_.peaks[u];
            }
        for (std::size_t n = 0; shares_ && n < slots_; ++n) {
            const double* shares = &here.slacks.back().values[n * nodes_];
            for (int s = 0; s < shares_; ++s)
                gradient[slots_ * V + n * shares_ + s] += mu / shares[0] - mu / shares[1 + s];
        }
    }

    void add_gradient_of_energy(const double* x, double* gradient) {
        if (!p_.energy) return;
        find_path(x, true);
        p_.energy->add_gradient(path_.data(), gradient);
    }

    // Assemble the band from the objective's blocks and the limits' terms.
    void assemble(const Iterate& iterate) {
        const Evaluation& here = iterate.evaluation;
        const int U = uavs(), V = size(), W = V + shares_, height = system_.height();
        const std::size_t peaks = p_.limits.size();
        std::fill(system_.band.begin(), system_.band.end(), 0.0);
        for (std::size_t i = 0; shares_ && i < slots_ * nodes_; ++i)
            system_.share_curvatures[i] = iterate.duals.back()[i] / iterate.shares[i];
        for (std::size_t n = 0; n < slots_; ++n) {
            double* block = &system_.blocks[n * W * W];
            for (int u = 0; u < U; ++u)
                if (p_.fixed[u])
                    for (int axis = 3 * u + 1; axis < 3 * u + 3; ++axis) {
                        std::fill(block + axis * W, block + axis * W + W, 0.0);
                        for (int i = axis; i < W; ++i) block[i * W + axis] = 0.0;
                    }
            system_.add_slot(n);
            for (int u = 0; u < U; ++u) {
                const double* slacks = &here.slacks[peaks].values[(n * U + u) * 2];
                const double* duals = &iterate.duals[peaks][(n * U + u) * 2];
                double* at = &system_.band[(n * V + 3 * u) * height];
                at[0] += duals[0] / slacks[0]
                    + duals[1] / slacks[1] / (p_.peaks[u] * p_.peaks[u]);
                if (p_.fixed[u]) at[height] = at[2 * height] = 1.0;
            }
        }
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->add_curvature(
                here.slacks[l], iterate.duals[l], {system_.band.data(), height});
        if (p_.energy)  // Its gradient has left the path.
            p_.energy->add_curvature(path_.data(), {system_.band.data(), height});
        for (int u = 0; u < U; ++u)
            ratios_[u] = here.mean_slacks[u] / iterate.mean_duals[u];
    }

    // Find how far the limits let every UAV's flight go along the step, in lengths_; return the
    // least of these and of the powers' step lengths.
    double limit_lengths(const Iterate& iterate) {
        const Evaluation& here = iterate.evaluation;
        const int U = uavs();
        double least = 1.0;
        std::fill(lengths_.begin(), lengths_.end(), 1.0);
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->limit_steps(
                here.slacks[l], slopes_[l], FRACTION_TO_BOUNDARY, lengths_.data());
        for (const double length : lengths_) least = std::min(least, length);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const double power = iterate.x[(n * U + u) * 3], change = step_[(n * U + u) * 3];
                limit_step(least, power, change, FRACTION_TO_BOUNDARY);
                limit_step(least, p_.peaks[u] - power, -change, FRACTION_TO_BOUNDARY);
            }
        for (int u = 0; u < U; ++u)
            limit_step(least, here.mean_slacks[u], mean_slope(u), FRACTION_TO_BOUNDARY);
        for (std::size_t i = 0; shares_ && i < slots_ * nodes_; ++i)
            limit_step(least, iterate.shares[i], slopes_.back().values[i], FRACTION_TO_BOUNDARY);
        return least;
    }

    // The directional derivative of the slack of an average power.
    double mean_slope(int u) const {
        const int U = uavs();
        double sum = 0.0;
        for (std::size_t n = 0; n < slots_; ++n) sum += step_[(n * U + u) * 3];
        return -sum / double(slots_);
    }

    // Find the step length, or 0, with trial_x_ and its evaluation trial_.
    //
    // First every power is stopped at its own limit and every flight at its own, which goes much
    // farther than stopping all at the first limit; then all go along the step.
    double search_line(const Iterate& iterate, double mu, double slope,
                       const std::atomic<bool>& stop) {
        const int U = uavs();
        const double uniform = limit_lengths(iterate), value = iterate.evaluation.value;
        const double bound = value + ROUNDING * std::fabs(value);
        const double lowest = std::max(1.0 - FRACTION_TO_BOUNDARY, 1.0 / POWER_FACTOR);
        for (int trial = 0; trial < CLIPPED_TRIALS + UNIFORM_TRIALS; ++trial) {
            if (stop) return 0.0;
            const bool clipped = trial < CLIPPED_TRIALS;
            const double length = clipped ? std::ldexp(1.0, -trial)
                : uniform * std::ldexp(1.0, CLIPPED_TRIALS - trial);
            double expected = length * slope;
            if (clipped) {
                expected = 0.0;
                for (std::size_t n = 0; n < slots_; ++n)
                    for (int u = 0; u < U; ++u) {
                        const std::size_t i = (n * U + u) * 3;
                        const double* x = iterate.x + i;
                        const double most = std::min(
                            x[0] * POWER_FACTOR,
                            x[0] + FRACTION_TO_BOUNDARY * (p_.peaks[u] - x[0]));
                        trial_x_[i] =
                            std::min(std::max(x[0] + length * step_[i], x[0] * lowest), most);
                        for (int axis = 1; axis < 3; ++axis)
                            trial_x_[i + axis] = x[axis] + length * step_[i + axis] * lengths_[u];
                        for (int j = 0; j < 3; ++j)
                            expected += gradient_[i + j] * (trial_x_[i + j] - x[j]);
                    }
            } else {
                for (std::size_t i = 0; i < trial_x_.size(); ++i)
                    trial_x_[i] = iterate.x[i] + length * step_[i];
            }
            if (shares_) expected += move_shares(iterate, length, clipped);
            if (!(expected < 0.0)) continue;
            evaluate_barrier(trial_x_.data(), trial_shares_.data(), mu, trial_);
            if (trial_.value <= bound + ARMIJO * expected) return length;
        }
        return 0.0;
    }

    // Move the shares along the step, or those of every slot to their own limit; return the
    // expected change of the barrier function in that case, which else is known.
    double move_shares(const Iterate& iterate, double length, bool clipped) {
        double expected = 0.0;
        const int G = nodes_;
        for (std::size_t n = 0; n < slots_; ++n) {
            const double* shares = iterate.shares + n * G;
            const double* changes = &slopes_.back().values[n * G];
            double own = length;
            for (int k = 0; clipped && k < G; ++k)
                limit_step(own, shares[k], changes[k], FRACTION_TO_BOUNDARY);
            for (int k = 0; k < G; ++k) {
                trial_shares_[n * G + k] = shares[k] + own * changes[k];
                if (clipped && k)
                    expected += own * changes[k]
                        * gradient_[slots_ * size() + n * shares_ + k - 1];
            }
        }
        return expected;
    }

    // Find the Newton step of a dual, and lower the duals' step length for it.
    double find_dual_change(double dual, double slack, double slope, double weight,
                            double& length) const {
        const double change = (weight - dual * slope) / slack - dual;
        limit_step(length, dual, change, FRACTION_TO_BOUNDARY);
        return change;
    }

    // Move the duals along with the step, as far as they stay positive.
    void update_duals(Iterate& iterate, double mu, bool moved) {
        const Evaluation& here = iterate.evaluation;
        const int U = uavs();
        double length = 1.0;
        for (std::size_t l = 0; l < iterate.duals.size(); ++l) {
            const Reals& slacks = here.slacks[l].values;
            dual_changes_[l].resize(slacks.size());
            for (std::size_t i = 0; i < slacks.size(); ++i)
                dual_changes_[l][i] = find_dual_change(
                    iterate.duals[l][i], slacks[i], slopes_[l].values[i], mu, length);
        }
        for (int u = 0; u < U; ++u)
            mean_changes_[u] = find_dual_change(iterate.mean_duals[u], here.mean_slacks[u],
                                                mean_slope(u), double(slots_) * mu, length);
        rates_.update_duals(iterate, step_.data(), mu, int(ratios_.size()),
                            &system_.rows[uavs()], length);
        const auto add = [length](Reals& duals, const Reals& changes) {
            for (std::size_t i = 0; i < duals.size(); ++i) duals[i] += length * changes[i];
        };
        for (std::size_t l = 0; l < iterate.duals.size(); ++l)
            add(iterate.duals[l], dual_changes_[l]);
        add(iterate.mean_duals, mean_changes_);
        clip_duals(iterate, moved ? trial_ : here, mu);
    }

    // Keep the duals near their central values for the slacks of an evaluation.
    void clip_duals(Iterate& iterate, const Evaluation& evaluation, double mu) const {
        const auto clip = [](double& dual, double central) {
            dual = std::min(std::max(dual, central / DUAL_RANGE), central * DUAL_RANGE);
        };
        for (std::size_t l = 0; l < iterate.duals.size(); ++l)
            for (std::size_t i = 0; i < iterate.duals[l].size(); ++i)
                clip(iterate.duals[l][i], mu / evaluation.slacks[l].values[i]);
        for (int u = 0; u < uavs(); ++u)
            clip(iterate.mean_duals[u], double(slots_) * mu / evaluation.mean_slacks[u]);
    }

    // Decide whether the start has finished, and lower its barrier parameter.
    void update_mu(Iterate& iterate, double length, double decrement, double final_mu) const {
        const double mu = *iterate.mu;
        ++iterate.steps_at_mu;
        const bool stalled = iterate.steps_at_mu >= PATIENCE || length == 0.0;
        const bool centred = decrement <= CENTRED * uavs() && length > 0.5;
        const bool converged = decrement <= std::max(CONVERGED, NEGLIGIBLE / mu);
        *iterate.finished = mu <= final_mu && (converged || stalled);
        if ((centred || stalled) && mu > final_mu) {
            iterate.steps_at_mu = 0;
            *iterate.mu = std::max(final_mu, std::min(MU_FACTOR * mu, std::pow(mu, MU_POWER)));
            iterate.is_evaluated = false;
        }
    }

    const Problem& p_;
    const std::size_t slots_;
    const int count_, nodes_, shares_, node_rows_;  // Shares that vary in a slot.
    Rates<UAVS, Model> rates_;
    NewtonSystem<UAVS> system_;
    Evaluation trial_;
    Reals gradient_, step_, trial_x_, trial_shares_, lengths_, path_, ratios_, mean_changes_;
    bool has_lines_;  // True if any limit has.
    std::vector<LineSet> line_sets_;   // Of every Limit, for this step.
    std::vector<Slopes> slopes_;       // Of all kinds of slacks.
    std::vector<Reals> dual_changes_;  // Likewise.
};

template <class Model>
std::unique_ptr<Newton> make_newton_for(const Problem& problem) {
    switch (problem.uavs) {
        case 1: return std::make_unique<PrimalDualNewton<1, Model>>(problem);
        case 2: return std::make_unique<PrimalDualNewton<2, Model>>(problem);
        case 3: return std::make_unique<PrimalDualNewton<3, Model>>(problem);
        case 4: return std::make_unique<PrimalDualNewton<4, Model>>(problem);
        default: return std::make_unique<PrimalDualNewton<0, Model>>(problem);
    }
}

}  // namespace

std::unique_ptr<Newton> make_newton(const Problem& problem) {
    const Channel* channel = problem.channel.get();
    if (dynamic_cast<const FreeSpace*>(channel)) return make_newton_for<FreeSpace>(problem);
    if (dynamic_cast<const PathLoss*>(channel)) return make_newton_for<PathLoss>(problem);
    return std::make_unique<PrimalDualNewton<0, Channel>>(problem);
}

}  // namespace kernel
