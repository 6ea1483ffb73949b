// A primal-dual interior-point method for (P1) and (P2), one start at a time.
//
// The objective is the sum over slots of the largest leak less r_0, in nats. Every slack c > 0 of a
// limit has the term -mu log c, that of an average power N times as much. The largest leak t has
// -mu log(t - leak) for every eavesdropper; t is eliminated slot by slot. Limits couple few
// neighbouring slots, average powers all by one row each, so the Hessian is a band and a few rows,
// and a step costs time linear in the number of slots.
#pragma once

#include <algorithm>
#include <array>

#include "linear.hpp"
#include "rates.hpp"
#include "start.hpp"

namespace kernel {

constexpr double FIRST_SHIFT = 1e-12;  // For matrices that are singular by rounding.
constexpr int ONE_BY_ONE = 3;    // Failures after which more and more slots are made convex at
constexpr int ALL_AT_ONCE = 12;  // once, and after which all are.
// Of all variables, when no slot is left to be made convex.
constexpr std::array<double, 9> SHIFTS{1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6, 1e8};
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
// The Newton decrement, or the gain in nats a slot, below which a mu is done in any case.
constexpr double STILL = 0.01, NEGLIGIBLE = 1e-8;

// For numbers of UAVs and channel models as Rates are.
template <int UAVS, class Model>
class NewtonOf : public Newton {
public:
    explicit NewtonOf(const Problem& problem)
        : p_(problem), slots_(problem.slots), count_(problem.uavs), rates_(problem) {
        const std::size_t n = slots_, v = 3 * count_;
        below_ = p_.bandwidth();
        lines_.resize(p_.limits.size());
        slopes_.resize(p_.limits.size() + 1);
        dual_moves_.resize(p_.limits.size() + 1);
        chooses_ = std::any_of(p_.limits.begin(), p_.limits.end(),
                               [](const auto& limit) { return limit->chooses(); });
        gradient_.resize(n * v);
        step_.resize(n * v + below_);
        there_.resize(n * v);
        hessian_.resize(n * v * v);
        band_.resize((n * v + below_) * (below_ + 1));
        factor_.resize(band_.size());
        right_.resize((n * v + below_) * (1 + count_));
        convex_.resize(n);
        flights_.resize(count_);
        space_.resize(v * (2 * v + 4));
        mean_moves_.resize(count_);
    }

    void begin(State& state) override {
        choose_lines(state.x, state.here);
        find_slacks(state.x, state.here);
        const double mu = *state.mu;
        for (const Terms& terms : state.here.limits) {
            state.duals.push_back(terms.slacks);
            for (double& dual : state.duals.back()) dual = mu / dual;
        }
        for (const double slack : state.here.mean_slacks)
            state.mean_duals.push_back(double(slots_) * mu / slack);
    }

    Outcome iterate(State& state, double final, const std::atomic<bool>& stop) override {
        const double mu = *state.mu;
        Evaluation& here = state.here;
        look(state);
        if (chooses_) clip_duals(state, here, mu);
        if (stop) return Outcome::stopped;
        rates_.model(state, here, mu, gradient_.data(), hessian_.data());
        if (stop) return Outcome::stopped;
        add_gradient_of_limits(here, mu, gradient_.data());
        fix(gradient_.data());
        assemble(state, here);
        if (stop) return Outcome::stopped;
        const bool solved = newton_step(state, here, stop);
        if (stop) return Outcome::stopped;
        if (!solved) std::fill(step_.begin(), step_.end(), 0.0);
        find_slopes(here);

        double slope = 0.0;
        for (std::size_t i = 0; i < gradient_.size(); ++i) slope += step_[i] * gradient_[i];
        const double length = line_search(state, here, mu, slope, stop);
        if (stop) return Outcome::stopped;
        const bool moved = length > 0.0;
        move_duals(state, here, mu, moved);
        if (moved) {
            std::copy(there_.begin(), there_.end(), state.x);
            std::swap(here, trial_);
        }
        state.known = true;
        update_mu(state, length, -slope / (double(slots_) * mu), final);
        return solved ? Outcome::stepped : Outcome::failed;
    }

    double rate(const State& state) override { return rates_.rate(state.x); }

    double model(State& state, double* gradient, double* hessian) override {
        look(state);
        rates_.model(state, state.here, *state.mu, gradient, hessian);
        add_gradient_of_limits(state.here, *state.mu, gradient);
        return state.here.value;
    }

private:
    int uavs() const { return UAVS ? UAVS : count_; }
    int size() const { return 3 * uavs(); }

    // The points of flights from start to goal, or of a change of them, (N + 2, U, 2).
    void follow_path(const double* x, bool ends) {
        const std::size_t width = 2 * uavs();
        path_.assign((slots_ + 2) * width, 0.0);
        if (ends) {
            std::copy(p_.starts.begin(), p_.starts.end(), path_.begin());
            std::copy(p_.goals.begin(), p_.goals.end(), path_.end() - width);
        }
        for (std::size_t i = 0; i < slots_ * uavs(); ++i) {
            path_[width + 2 * i] = x[3 * i + 1];
            path_[width + 2 * i + 1] = x[3 * i + 2];
        }
    }

    // Choose the lines for a step.
    void choose_lines(const double* x, Evaluation& found) {
        found.limits.resize(p_.limits.size() + 1);
        trial_.limits.resize(p_.limits.size() + 1);
        if (chooses_) follow_path(x, true);
        for (std::size_t l = 0; l < p_.limits.size(); ++l) {
            if (p_.limits[l]->chooses()) p_.limits[l]->choose(path_.data(), lines_[l]);
            found.limits[l].lines = trial_.limits[l].lines = &lines_[l];
        }
    }

    // Evaluate where a step begins, as far as that is not known, beside lines that are new.
    void look(State& state) {
        choose_lines(state.x, state.here);
        if (!state.known) {
            evaluate(state.x, *state.mu, state.here);
            return;
        }
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            if (p_.limits[l]->chooses())
                p_.limits[l]->find_slacks(path_.data(), state.here.limits[l]);
        add_lines(*state.mu, state.here);
    }

    void add_logarithms(const Evaluation& here, bool choosing, LogSum& sum) const {
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            if (p_.limits[l]->chooses() == choosing)
                for (const double slack : here.limits[l].slacks) sum.add(slack);
    }

    // Find the value with the terms of lines.
    void add_lines(double mu, Evaluation& found) const {
        LogSum lines;
        add_logarithms(found, true, lines);
        const double value = found.without_lines - mu * lines.total();
        found.value = std::isfinite(value) ? value : INFINITE;
    }

    void find_slacks(const double* x, Evaluation& found) {
        const int U = uavs();
        follow_path(x, true);
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->find_slacks(path_.data(), found.limits[l]);
        Reals& peaks = found.limits.back().slacks;
        peaks.resize(slots_ * U * 2);
        found.mean_slacks.assign(U, 0.0);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const std::size_t i = n * U + u;
                const double power = x[3 * i];
                peaks[2 * i] = power;
                peaks[2 * i + 1] = 1.0 - power / p_.peaks[u];
                found.mean_slacks[u] += power;
            }
        for (double& sum : found.mean_slacks) sum = 1.0 - sum / double(slots_);
    }

    // Find the directional derivatives of the limits' and the peaks' slacks along the step.
    void find_slopes(const Evaluation& here) {
        const int U = uavs();
        follow_path(step_.data(), false);
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->find_slopes(here.limits[l], path_.data(), slopes_[l]);
        Reals& peaks = slopes_.back().slacks;
        peaks.resize(slots_ * U * 2);
        for (std::size_t i = 0; i < slots_ * U; ++i) {
            peaks[2 * i] = step_[3 * i];
            peaks[2 * i + 1] = -step_[3 * i] / p_.peaks[i % U];
        }
    }

    void evaluate(const double* x, double mu, Evaluation& found) {
        double value = rates_.evaluate(x, mu, found);
        find_slacks(x, found);
        LogSum limits;
        add_logarithms(found, false, limits);
        for (const double slack : found.limits.back().slacks) limits.add(slack);
        value -= mu * limits.total();
        for (const double slack : found.mean_slacks)
            value -= double(slots_) * mu * std::log(slack);
        found.without_lines = value;
        add_lines(mu, found);
    }

    void fix(double* change) const {
        const int U = uavs();
        for (int u = 0; u < U; ++u)
            if (p_.fixed[u])
                for (std::size_t n = 0; n < slots_; ++n)
                    change[(n * U + u) * 3 + 1] = change[(n * U + u) * 3 + 2] = 0.0;
    }

    void add_gradient_of_limits(const Evaluation& here, double mu, double* gradient) const {
        const int U = uavs(), V = size();
        const Reals& peaks = here.limits.back().slacks;
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->add_gradient(here.limits[l], mu, gradient);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const double* slacks = &peaks[(n * U + u) * 2];
                gradient[n * V + 3 * u] += mu / here.mean_slacks[u]  // (N mu / c) / N
                    - mu / slacks[0] + mu / slacks[1] / p_.peaks[u];
            }
    }

    // Put the Hessian with the limits' parts into the band.
    void assemble(const State& state, const Evaluation& here) {
        const int U = uavs(), V = size(), height = below_ + 1;
        std::fill(band_.begin(), band_.end(), 0.0);
        for (std::size_t n = 0; n < slots_; ++n) {
            double* hessian = &hessian_[n * V * V];
            for (int u = 0; u < U; ++u)
                if (p_.fixed[u])
                    for (int axis = 3 * u + 1; axis < 3 * u + 3; ++axis) {
                        std::fill(hessian + axis * V, hessian + axis * V + V, 0.0);
                        for (int i = axis; i < V; ++i) hessian[i * V + axis] = 0.0;
                    }
            add_block(n, hessian);
            for (int u = 0; u < U; ++u) {
                const double* slacks = &here.limits.back().slacks[(n * U + u) * 2];
                const double* duals = &state.duals.back()[(n * U + u) * 2];
                double* at = &band_[(n * V + 3 * u) * height];
                at[0] += duals[0] / slacks[0]
                    + duals[1] / slacks[1] / (p_.peaks[u] * p_.peaks[u]);
                if (p_.fixed[u]) at[height] = at[2 * height] = 1.0;
            }
        }
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->add_curvature(here.limits[l], state.duals[l], {band_.data(), height});
    }

    void add_block(std::size_t n, const double* block) {
        const int V = size(), height = below_ + 1;
        for (int j = 0; j < V; ++j)
            for (int i = j; i < V; ++i) band_[(n * V + j) * height + i - j] += block[i * V + j];
    }

    // Minus the inverse of the Hessian, made positive, times the gradient; whether it was found.
    bool newton_step(const State& state, const Evaluation& here, const std::atomic<bool>& stop) {
        const int U = uavs(), V = size(), sides = 1 + U;
        const std::size_t columns = slots_ * V;
        if (any_infinite(band_.data(), band_.size()) || !factor_positive(stop)) return false;
        std::fill(right_.begin(), right_.end(), 0.0);
        for (std::size_t i = 0; i < columns; ++i) right_[i * sides] = -gradient_[i];
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u)
                right_[(n * V + 3 * u) * sides + 1 + u] = -1.0 / double(slots_);
        divide_by_lower_factor();
        // Woodbury's formula for the average powers, from what is before the factor's other half.
        double* products = space_.data();
        double* right = products + U * U;
        std::fill(products, right + U, 0.0);
        for (std::size_t i = 0; i < columns; ++i) {
            const double* row = &right_[i * sides];
            const double inverse = factor_[i * (below_ + 1)];
            for (int u = 0; u < U; ++u) {
                const double by = row[1 + u] * inverse;
                right[u] += by * row[0];
                for (int s = 0; s <= u; ++s) products[u * U + s] += by * row[1 + s];
            }
        }
        for (int u = 0; u < U; ++u) {
            for (int s = 0; s < u; ++s) products[s * U + u] = products[u * U + s];
            products[u * U + u] += here.mean_slacks[u] / state.mean_duals[u];
        }
        if (!solve_small(products, right, U)) return false;
        for (std::size_t i = 0; i < columns; ++i) {
            const double* row = &right_[i * sides];
            double change = row[0];
            for (int u = 0; u < U; ++u) change -= row[1 + u] * right[u];
            step_[i] = change * factor_[i * (below_ + 1)];
        }
        with_bandwidth([this](auto below) {
            divide_by_upper<below.value>(factor_.data(), slots_ * size(), below_, step_.data());
        });
        return !any_infinite(step_.data(), columns);
    }

    // Factor the band after making it positive definite, as little as that takes.
    //
    // First, the Hessians of the slots where the factorisation fails and of their neighbours are
    // projected on the semidefinite cone. All limits' terms are convex, so that this ends; what
    // rounding still breaks is mended by shifts of the diagonal.
    bool factor_positive(const std::atomic<bool>& stop) {
        const int V = size(), height = below_ + 1;
        const std::ptrdiff_t slots = slots_;
        std::fill(convex_.begin(), convex_.end(), 0);
        std::ptrdiff_t left = slots;
        for (std::ptrdiff_t j = 0; j < slots * V; ++j) band_[j * height] += FIRST_SHIFT;
        std::ptrdiff_t begin = 0;  // The first column that has changed.
        for (int failures = 0; left; ++failures) {
            if (stop) return false;
            const std::ptrdiff_t failed = factor(begin);
            if (failed < 0) return true;
            std::ptrdiff_t from = 0, to = slots - 1;
            if (failures < ALL_AT_ONCE) {
                const std::ptrdiff_t width =
                    std::ptrdiff_t(1) << std::max(0, failures - ONE_BY_ONE);
                const std::ptrdiff_t near_from = std::max(from, failed / V - width);
                const std::ptrdiff_t near_to = std::min(to, failed / V + width);
                if (!std::all_of(convex_.begin() + near_from, convex_.begin() + near_to + 1,
                                 [](char is) { return is; })) {
                    from = near_from;
                    to = near_to;
                }
            }
            begin = failed;
            for (std::ptrdiff_t n = from; n <= to; ++n) {
                if (convex_[n]) continue;
                convex_[n] = 1;
                --left;
                begin = std::min(begin, n * V);
                negative_part(&hessian_[n * V * V], V, space_.data());
                add_block(n, &hessian_[n * V * V]);
            }
        }
        double scale = 1.0;
        for (std::ptrdiff_t j = 0; j < slots * V; ++j)
            scale = std::max(scale, std::fabs(band_[j * height]));
        for (const double shift : SHIFTS) {
            if (stop) return false;
            if (factor(0) < 0) return true;
            for (std::ptrdiff_t j = 0; j < slots * V; ++j) band_[j * height] += shift * scale;
        }
        return false;
    }

    // Where points are coupled with the next, with separation or without, or with the one behind it
    // as well, the bandwidth is known when compiling.
    template <typename Function>
    auto with_bandwidth(Function function) {
        constexpr int V = 3 * UAVS;
        if (UAVS && below_ == V + 1) return function(std::integral_constant<int, V + 1>());
        if (UAVS && below_ == 2 * V + 1) return function(std::integral_constant<int, 2 * V + 1>());
        if (UAVS > 1 && below_ == 2 * V - 2)
            return function(std::integral_constant<int, (UAVS > 1) ? 2 * V - 2 : 0>());
        return function(std::integral_constant<int, 0>());
    }

    std::ptrdiff_t factor(std::ptrdiff_t from) {
        return with_bandwidth([this, from](auto below) {
            return factor_band<below.value>(band_.data(), factor_.data(), slots_ * size(), below_,
                                            from);
        });
    }

    void divide_by_lower_factor() {
        with_bandwidth([this](auto below) {
            divide_by_lower<below.value, UAVS ? UAVS + 1 : 0>(
                factor_.data(), slots_ * size(), below_, right_.data(), 1 + uavs());
        });
    }

    // How far every limit lets every UAV go along the step: the least of all and those of flights.
    double longest_step(const State& state, const Evaluation& here) {
        const int U = uavs();
        double least = 1.0;
        std::fill(flights_.begin(), flights_.end(), 1.0);
        for (std::size_t l = 0; l < p_.limits.size(); ++l)
            p_.limits[l]->shorten(here.limits[l], slopes_[l], BOUNDARY, flights_.data());
        for (const double length : flights_) least = std::min(least, length);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const double power = state.x[(n * U + u) * 3], change = step_[(n * U + u) * 3];
                stop_at_zero(least, power, change, BOUNDARY);
                stop_at_zero(least, p_.peaks[u] - power, -change, BOUNDARY);
            }
        for (int u = 0; u < U; ++u)
            stop_at_zero(least, here.mean_slacks[u], mean_change(u), BOUNDARY);
        return least;
    }

    double mean_change(int u) const {
        const int U = uavs();
        double sum = 0.0;
        for (std::size_t n = 0; n < slots_; ++n) sum += step_[(n * U + u) * 3];
        return -sum / double(slots_);
    }

    // Return how far to go along the step, with `there_` and its evaluation `trial_`, or 0.
    //
    // First every power is stopped at its own limit and every flight at its own, which goes much
    // farther than stopping all at the first limit; then all go plainly along the step.
    double line_search(const State& state, const Evaluation& here, double mu, double slope,
                       const std::atomic<bool>& stop) {
        const int U = uavs();
        const double uniform = longest_step(state, here);
        const double enough = here.value + ROUNDING * std::fabs(here.value);
        const double lowest = std::max(1.0 - BOUNDARY, 1.0 / POWER_FACTOR);
        for (int trial = 0; trial < CLIPPED_TRIALS + UNIFORM_TRIALS; ++trial) {
            if (stop) return 0.0;
            const bool clipped = trial < CLIPPED_TRIALS;
            const double by = clipped ? std::ldexp(1.0, -trial)
                : uniform * std::ldexp(1.0, CLIPPED_TRIALS - trial);
            double expected = by * slope;
            if (clipped) {
                expected = 0.0;
                for (std::size_t n = 0; n < slots_; ++n)
                    for (int u = 0; u < U; ++u) {
                        const std::size_t i = (n * U + u) * 3;
                        const double* x = state.x + i;
                        const double most = std::min(
                            x[0] * POWER_FACTOR,
                            x[0] + BOUNDARY * (p_.peaks[u] - x[0]));
                        there_[i] = std::min(std::max(x[0] + by * step_[i], x[0] * lowest), most);
                        for (int axis = 1; axis < 3; ++axis)
                            there_[i + axis] = x[axis] + by * step_[i + axis] * flights_[u];
                        for (int j = 0; j < 3; ++j)
                            expected += gradient_[i + j] * (there_[i + j] - x[j]);
                    }
            } else {
                for (std::size_t i = 0; i < there_.size(); ++i)
                    there_[i] = state.x[i] + by * step_[i];
            }
            if (!(expected < 0.0)) continue;
            evaluate(there_.data(), mu, trial_);
            if (trial_.value <= enough + ARMIJO * expected) return by;
        }
        return 0.0;
    }

    // The Newton step of a dual, whose part of the longest step it takes into account.
    double move_of(double dual, double slack, double change, double weight, double& by) const {
        const double move = (weight - dual * change) / slack - dual;
        stop_at_zero(by, dual, move, BOUNDARY);
        return move;
    }

    // Move the duals along with the step, as far as they stay positive.
    void move_duals(State& state, const Evaluation& here, double mu, bool moved) {
        const int U = uavs();
        double by = 1.0;
        for (std::size_t l = 0; l < state.duals.size(); ++l) {
            const Reals& slacks = here.limits[l].slacks;
            dual_moves_[l].resize(slacks.size());
            for (std::size_t i = 0; i < slacks.size(); ++i)
                dual_moves_[l][i] =
                    move_of(state.duals[l][i], slacks[i], slopes_[l].slacks[i], mu, by);
        }
        for (int u = 0; u < U; ++u)
            mean_moves_[u] = move_of(state.mean_duals[u], here.mean_slacks[u], mean_change(u),
                                     double(slots_) * mu, by);
        rates_.move(state, here, step_.data(), by);
        const auto go = [by](Reals& duals, const Reals& moves) {
            for (std::size_t i = 0; i < duals.size(); ++i) duals[i] += by * moves[i];
        };
        for (std::size_t l = 0; l < state.duals.size(); ++l) go(state.duals[l], dual_moves_[l]);
        go(state.mean_duals, mean_moves_);
        clip_duals(state, moved ? trial_ : here, mu);
    }

    // Keep the duals near their central values for some slacks.
    void clip_duals(State& state, const Evaluation& now, double mu) const {
        const auto clip = [](double& dual, double target) {
            dual = std::min(std::max(dual, target / DUAL_RANGE), target * DUAL_RANGE);
        };
        for (std::size_t l = 0; l < state.duals.size(); ++l)
            for (std::size_t i = 0; i < state.duals[l].size(); ++i)
                clip(state.duals[l][i], mu / now.limits[l].slacks[i]);
        for (int u = 0; u < uavs(); ++u)
            clip(state.mean_duals[u], double(slots_) * mu / now.mean_slacks[u]);
    }

    // Decide whether the start has finished, and lower its barrier parameter.
    void update_mu(State& state, double length, double decrement, double final) const {
        const double mu = *state.mu;
        ++state.age;
        const bool stalled = state.age >= PATIENCE || length == 0.0;
        const bool centred = decrement <= CENTRED * uavs() && length > 0.5;
        const bool still = decrement <= std::max(STILL, NEGLIGIBLE / mu);
        *state.finished = mu <= final && (still || stalled);
        if ((centred || stalled) && mu > final) {
            state.age = 0;
            *state.mu = std::max(final, std::min(MU_FACTOR * mu, std::pow(mu, MU_POWER)));
            state.known = false;
        }
    }

    const Problem& p_;
    const std::size_t slots_;
    const int count_;
    Rates<UAVS, Model> rates_;
    int below_;  // Rows of the band below its diagonal.
    Evaluation trial_;
    Reals gradient_, step_, there_, hessian_, band_, factor_, right_, space_, flights_;
    Reals path_, mean_moves_;
    bool chooses_;  // Whether any limit does.
    // Of every Limit the lines of this step; of these and, last, of the peaks the directional
    // derivatives and the duals' steps.
    std::vector<Lines> lines_;
    std::vector<Slopes> slopes_;
    std::vector<Reals> dual_moves_;
    std::vector<char> convex_;
};

}  // namespace kernel
