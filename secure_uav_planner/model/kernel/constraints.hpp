// The slacks c > 0 of a BarrierProblem and their duals.
//
// The kinds of slacks, in this order: one kind for each limit, peaks of powers, average powers,
// energies, and shares. A slack has the barrier term -mu log c; the slacks of average powers and of
// energies have -N mu log c.
//
// An energy that exceeds its limit has a price in place of its barrier term. The price rises from
// step to step until the barrier term has the same slope.
#pragma once

#include <algorithm>
#include <cmath>

#include "epigraph.hpp"
#include "newton.hpp"
#include "numbers.hpp"

namespace kernel {

constexpr double DUAL_RANGE = 1e4;  // Largest ratio of a dual to its central value mu / c.
constexpr double PRICE_RISE = 1.3;  // Ratio of an energy's prices in two successive steps.
// Ratio of a price to N mu above which it does not rise. At higher prices flights leave the centre
// and are stopped by their other limits.
constexpr double MOST_PRICE = 1e3;

// UAVS is the number of UAVs if it is known when compiling, or 0 for any number.
template <int UAVS>
class Constraints {
public:
    explicit Constraints(const BarrierProblem& problem)
        : p_(problem), limits_(p_.limits.size()), means_(limits_ + 1), energies_(means_ + 1),
          kinds_(energies_ + 2), slopes_(kinds_), line_sets_(limits_), dual_changes_(kinds_) {
        for (const auto& limit : p_.limits) have_lines = have_lines || limit->has_lines();
    }

    bool have_lines = false;  // Whether any limit chooses lines before every step.

    // Choose the lines normal . d = offset of limits that have lines, for the flights at x. Slacks
    // of the evaluations `here`, at x, and `trial`, of a step from x, get pointers to these lines.
    void choose_lines(const double* x, Evaluation& here, Evaluation& trial) {
        here.slacks.resize(kinds_);
        trial.slacks.resize(kinds_);
        if (have_lines) p_.fill_path(x, path_);
        for (std::size_t l = 0; l < limits_; ++l) {
            if (has_lines(l)) p_.limits[l]->choose_lines(path_.data(), line_sets_[l]);
            here.slacks[l].lines = trial.slacks[l].lines = &line_sets_[l];
        }
    }

    // Fill here.slacks, and here.value with objective - sum weight log(slack), or INFINITE outside
    // the limits. Weights are mu, and N mu for average powers and energies. An energy with a price
    // (`over`) adds price * energy instead. A power p has the slacks p and 1 - p / peak, an average
    // power 1 - mean (powers are in units of the largest average power), a share the share itself.
    void evaluate(const Iterate& iterate, const double* x, const double* shares, double objective,
                  double mu, Evaluation& here) {
        p_.fill_path(x, path_);
        LogSum sum;
        for (std::size_t l = 0; l < limits_; ++l)
            if (!has_lines(l)) add_limit(l, here, sum);
        Reals &peaks = here.slacks[limits_].values, &means = here.slacks[means_].values;
        peaks.resize(p_.slots * p_.uavs * 2);
        means.assign(p_.uavs, 0.0);
        for_powers([&](std::size_t i, int u) {
            peaks[2 * i] = x[3 * i];
            peaks[2 * i + 1] = 1.0 - x[3 * i] / p_.peaks[u];
            means[u] += x[3 * i];
        });
        here.slacks.back().values.assign(shares, shares + p_.share_slacks());
        for (const Reals* slacks : {&peaks, &here.slacks.back().values})
            for (const double slack : *slacks) sum.add(slack);
        here.value_without_lines = objective - mu * sum.total();
        for (double& slack : means) {
            slack = 1.0 - slack / double(p_.slots);
            here.value_without_lines -= double(p_.slots) * mu * std::log(slack);
        }
        if (p_.energies) evaluate_energies(iterate, mu, here);
        evaluate_lines(mu, here);
    }

    // Find the slacks of limits with lines on path_, which choose_lines or evaluate has filled. Set
    // here.value to value_without_lines - mu sum log(slack), or to INFINITE if it is not finite.
    void evaluate_lines(double mu, Evaluation& here) const {
        LogSum sum;
        for (std::size_t l = 0; l < limits_; ++l)
            if (has_lines(l)) add_limit(l, here, sum);
        const double value = here.value_without_lines - mu * sum.total();
        here.value = std::isfinite(value) ? value : INFINITE;
    }

    // Add the gradient of all barrier terms by x, (N, U, 3), and behind it by shares, (N, G - 1). A
    // term -w log c has the gradient -(w / c) dc. If an energy has a price (`over`), the price
    // replaces w / c. Also set energy_gradient_, which find_slopes and fill_energy_rows use.
    void add_gradient(const Iterate& iterate, double mu, double* gradient) {
        const Evaluation& here = iterate.evaluation;
        for (std::size_t l = 0; l < limits_; ++l)
            p_.limits[l]->add_gradient(here.slacks[l], mu, gradient);
        const Reals &peaks = here.slacks[limits_].values, &means = here.slacks[means_].values;
        for_powers([&](std::size_t i, int u) {
            gradient[3 * i] += mu / means[u]  // (N mu / c) / N
                - mu / peaks[2 * i] + mu / peaks[2 * i + 1] / p_.peaks[u];
        });
        const Reals& shares = here.slacks.back().values;
        for_shares([&](std::size_t i, std::size_t share, std::size_t first) {
            gradient[i] += mu / shares[first] - mu / shares[share];
        });
        if (!p_.energies) return;
        p_.fill_path(iterate.x, path_);
        energy_gradient_.assign(p_.slots * p_.uavs * 3, 0.0);
        p_.energies->add_gradient(path_.data(), energy_gradient_.data());
        for_powers([&](std::size_t i, int u) {
            const double price = iterate.over[u] ? price_in_nats(iterate, u)
                : barrier_weight(energies_, mu) / here.slacks[energies_].values[u];
            for (int j = 1; j < 3; ++j) gradient[3 * i + j] += price * energy_gradient_[3 * i + j];
        });
    }

    // Add the limits' primal-dual curvature in x to the band. A slack c of a power or a flight adds
    // dual / c (dc/dx)(dc/dx)^T - dual d2c/dx2. An energy adds only the dual times its Hessian,
    // made positive semidefinite move by move. The outer products of average powers and energies
    // couple all slots, and are in mean_ratio and fill_energy_rows.
    void add_curvature(const Iterate& iterate, const Band& band) {
        const std::vector<Slacks>& slacks = iterate.evaluation.slacks;
        for_powers([&](std::size_t i, int u) {
            const double* slack = &slacks[limits_].values[2 * i];
            const double* dual = &iterate.duals[limits_][2 * i];
            band.entries[3 * i * band.height] +=
                dual[0] / slack[0] + dual[1] / slack[1] / (p_.peaks[u] * p_.peaks[u]);
        });
        for (std::size_t l = 0; l < limits_; ++l)
            p_.limits[l]->add_curvature(slacks[l], iterate.duals[l], band);
        if (!p_.energies) return;
        p_.fill_path(iterate.x, path_);
        p_.energies->add_curvature(path_.data(), iterate.duals[energies_], band);
    }
    // Return the ratio slack / dual of UAV u's average power, which adds row row^T / ratio to the
    // Hessian. The row is the gradient of the slack.
    double mean_ratio(const Iterate& iterate, int u) const {
        return iterate.evaluation.slacks[means_].values[u] / iterate.duals[means_][u];
    }
    // Fill U of the R dense rows, and U ratios: rows[i R + u] is the derivative of UAV u's energy
    // by variable i, from the last add_gradient. The energy of UAV u adds row row^T / ratio to the
    // Hessian, with ratio = slack / dual. With a price (`over`) the row is 0 and the ratio 1.
    void fill_energy_rows(const Iterate& iterate, int R, double* rows, double* ratios) const {
        const Reals& slacks = iterate.evaluation.slacks[energies_].values;
        for (int u = 0; u < p_.uavs; ++u)
            ratios[u] = iterate.over[u] ? 1.0 : slacks[u] / iterate.duals[energies_][u];
        for_powers([&](std::size_t i, int u) {
            for (int j = 1; j < 3; ++j)
                rows[(3 * i + j) * R + u] = iterate.over[u] ? 0.0 : energy_gradient_[3 * i + j];
        });
    }
    // The curvature that the limit share > 0 of share i adds.
    double share_curvature(const Iterate& iterate, std::size_t i) const {
        return iterate.duals.back()[i] / iterate.shares[i];
    }

    // Set slopes_, the derivatives of all slacks along `step`, which has x, (N, U, 3), and behind
    // it shares, (N, G - 1). Gradients of energies are from the last add_gradient.
    void find_slopes(const double* step, const Evaluation& here) {
        p_.fill_path(step, path_, true);
        for (std::size_t l = 0; l < limits_; ++l)
            p_.limits[l]->find_slopes(here.slacks[l], path_.data(), slopes_[l]);
        Reals &peaks = slopes_[limits_].values, &means = slopes_[means_].values;
        peaks.resize(p_.slots * p_.uavs * 2);
        means.assign(p_.uavs, 0.0);
        for_powers([&](std::size_t i, int u) {
            peaks[2 * i] = step[3 * i];
            peaks[2 * i + 1] = -step[3 * i] / p_.peaks[u];
            means[u] += step[3 * i];
        });
        for (double& slope : means) slope = -slope / double(p_.slots);
        Reals& energies = slopes_[energies_].values;
        energies.assign(p_.energies ? p_.uavs : 0, 0.0);
        if (p_.energies)
            for_powers([&](std::size_t i, int u) {
                for (int j = 1; j < 3; ++j)
                    energies[u] -= energy_gradient_[3 * i + j] * step[3 * i + j];
            });
        Reals& shares = slopes_.back().values;
        shares.assign(p_.share_slacks(), 0.0);
        for_shares([&](std::size_t i, std::size_t share, std::size_t first) {
            // The first share of a slot is 1 minus the slot's other shares.
            shares[first] -= step[i];
            shares[share] = step[i];
        });
    }
    const Reals& share_slopes() const { return slopes_.back().values; }

    // Fill `lengths`, (U), with the largest step length, at most 1, of each UAV's flight within the
    // limits of flights, and of energies without a price. Return the least of these and of the
    // largest lengths for powers, average powers and shares. A step takes at most 99.5% of a slack.
    double limit_lengths(const Iterate& iterate, const double* step, Reals& lengths) const {
        const std::vector<Slacks>& slacks = iterate.evaluation.slacks;
        std::fill(lengths.begin(), lengths.end(), 1.0);
        for (std::size_t l = 0; l < limits_; ++l)
            p_.limits[l]->limit_steps(slacks[l], slopes_[l], lengths.data());
        for (std::size_t u = 0; u < slacks[energies_].values.size(); ++u)
            if (!iterate.over[u])
                limit_step(lengths[u], slacks[energies_].values[u], slopes_[energies_].values[u]);
        double least = *std::min_element(lengths.begin(), lengths.end());
        for_powers([&](std::size_t i, int u) {
            limit_step(least, iterate.x[3 * i], step[3 * i]);
            limit_step(least, p_.peaks[u] - iterate.x[3 * i], -step[3 * i]);
        });
        for (const std::size_t l : {means_, kinds_ - 1})
            for (std::size_t i = 0; i < slacks[l].values.size(); ++i)
                limit_step(least, slacks[l].values[i], slopes_[l].values[i]);
        return least;
    }

    // Append each slack's dual: barrier_weight / slack, or the price if an energy has one (`over`).
    void initialise_duals(Iterate& iterate, double mu) const {
        for (std::size_t l = 0; l < kinds_; ++l) {
            iterate.duals.push_back(iterate.evaluation.slacks[l].values);
            for (double& dual : iterate.duals.back()) dual = barrier_weight(l, mu) / dual;
        }
        for (std::size_t u = 0; u < iterate.duals[energies_].size(); ++u)
            if (iterate.over[u]) iterate.duals[energies_][u] = price_in_nats(iterate, u);
    }

    // Decide for each UAV how the limit of its energy enters the barrier function at first: by a
    // price (`over`), or by a barrier term. A price is used if the limit is exceeded or if the
    // price, from iterate.prices, is below the slope N mu / slack of the barrier term.
    void initialise_energies(Iterate& iterate, double mu) {
        if (!p_.energies) return;
        Reals energies;
        p_.fill_path(iterate.x, path_);
        p_.energies->compute_energies(path_.data(), energies);
        for (int u = 0; u < p_.uavs; ++u)
            iterate.over[u] =
                !((1.0 - energies[u]) * price_in_nats(iterate, u) >= barrier_weight(energies_, mu));
    }

    // Multiply each price below MOST_PRICE * weight, with weight = N mu, by PRICE_RISE. Instead, if
    // slack * price >= weight, a barrier term, whose slope is weight / slack, replaces the price.
    // Return whether any price has risen. The price of an energy (`over`) is the energy's dual.
    // iterate.prices gets the duals of all energies per slot and rate unit.
    bool raise_prices(Iterate& iterate, double mu) const {
        bool risen = false;
        const double weight = barrier_weight(energies_, mu);
        const Reals& slacks = iterate.evaluation.slacks[energies_].values;
        for (std::size_t u = 0; u < slacks.size(); ++u) {
            double& dual = iterate.duals[energies_][u];
            if (iterate.over[u]) {
                iterate.is_evaluated = false;
                if (slacks[u] * dual >= weight) {
                    iterate.over[u] = false;
                } else if (dual < MOST_PRICE * weight) {
                    dual *= PRICE_RISE;
                    risen = true;
                }
            }
            iterate.prices[u] = dual / (double(p_.slots) * p_.rate_unit);
        }
        return risen;
    }

    // Find the Newton step of the duals, weight / c - dual - dual / c * (slope of c) for slack c,
    // and lower the step length `length` so that all duals stay positive. Prices do not change.
    void find_dual_changes(const Iterate& iterate, double mu, double& length) {
        for (std::size_t l = 0; l < kinds_; ++l) {
            const Reals &duals = iterate.duals[l], &slacks = iterate.evaluation.slacks[l].values;
            const double weight = barrier_weight(l, mu);
            Reals& changes = dual_changes_[l];
            changes.resize(duals.size());
            for (std::size_t i = 0; i < duals.size(); ++i) {
                if (has_price(iterate, l, i)) {
                    changes[i] = 0.0;
                    continue;
                }
                changes[i] = (weight - duals[i] * slopes_[l].values[i]) / slacks[i] - duals[i];
                limit_step(length, duals[i], changes[i]);
            }
        }
    }

    // Add `length` times the Newton step of find_dual_changes to the duals.
    void move_duals(Iterate& iterate, double length) const {
        for (std::size_t l = 0; l < kinds_; ++l)
            for (std::size_t i = 0; i < iterate.duals[l].size(); ++i)
                iterate.duals[l][i] += length * dual_changes_[l][i];
    }

    // Keep duals within a factor DUAL_RANGE of their central values weight / slack. Prices stay.
    void clip_duals(Iterate& iterate, double mu) const {
        for (std::size_t l = 0; l < kinds_; ++l)
            for (std::size_t i = 0; i < iterate.duals[l].size(); ++i) {
                if (has_price(iterate, l, i)) continue;
                const double central =
                    barrier_weight(l, mu) / iterate.evaluation.slacks[l].values[i];
                double& dual = iterate.duals[l][i];
                dual = std::min(std::max(dual, central / DUAL_RANGE), central * DUAL_RANGE);
            }
    }

private:
    bool has_lines(std::size_t limit) const { return p_.limits[limit]->has_lines(); }

    // Call function(i, u) for the power of every slot n and UAV u, with i = n U + u. The power's
    // index in x, (N, U, 3), is 3 i, and its UAV's position follows at 3 i + 1 and 3 i + 2.
    template <typename Function>
    void for_powers(Function function) const {
        const int U = UAVS ? UAVS : p_.uavs;
        for (std::size_t n = 0; n < p_.slots; ++n)
            for (int u = 0; u < U; ++u) function(n * U + u, u);
    }

    // Call function(i, share, first) for every share that is a variable: every slot's first share
    // is 1 minus the slot's other ones. `i` is the index of the variable. `share` and `first` are
    // indices among all shares, (N, G), of the share and of the first share of its slot.
    template <typename Function>
    void for_shares(Function function) const {
        std::size_t i = p_.slots * p_.uavs * 3;
        for (std::size_t n = 0; n < p_.slots; ++n)
            for (int k = 1; k < p_.nodes(); ++k)
                function(i++, n * p_.nodes() + k, n * p_.nodes());
    }

    // The factor of -log c in the barrier term of a kind of slacks c: N mu for average powers and
    // energies, which occur once and not once a slot, and mu for other kinds.
    double barrier_weight(std::size_t kind, double mu) const {
        return kind == means_ || kind == energies_ ? double(p_.slots) * mu : mu;
    }

    bool has_price(const Iterate& iterate, std::size_t kind, std::size_t i) const {
        return kind == energies_ && iterate.over[i];
    }

    // The price of UAV u's energy in nats per limit; iterate.prices are in rate units and per slot.
    double price_in_nats(const Iterate& iterate, std::size_t u) const {
        return iterate.prices[u] * double(p_.slots) * p_.rate_unit;
    }

    // Find the slacks 1 - energy on path_; energies are shares of their limits. Add to
    // value_without_lines -N mu log(slack), or price * energy for an energy with a price (`over`).
    void evaluate_energies(const Iterate& iterate, double mu, Evaluation& here) const {
        Reals& slacks = here.slacks[energies_].values;
        p_.energies->compute_energies(path_.data(), slacks);
        for (int u = 0; u < p_.uavs; ++u) {
            if (iterate.over[u]) here.value_without_lines += price_in_nats(iterate, u) * slacks[u];
            slacks[u] = 1.0 - slacks[u];
            if (!iterate.over[u])
                here.value_without_lines -= barrier_weight(energies_, mu) * std::log(slacks[u]);
        }
    }

    // Find the slacks of a limit on path_, and add their logarithms to a sum.
    void add_limit(std::size_t limit, Evaluation& here, LogSum& sum) const {
        p_.limits[limit]->find_slacks(path_.data(), here.slacks[limit]);
        for (const double slack : here.slacks[limit].values) sum.add(slack);
    }

    const BarrierProblem& p_;
    const std::size_t limits_;            // Number of limits.
    const std::size_t means_, energies_;  // Indices of these kinds.
    const std::size_t kinds_;             // Number of kinds.
    Reals path_;
    Reals energy_gradient_;            // Gradient of the sum of all energies, (N, U, 3).
    std::vector<Slacks> slopes_;       // Slopes of the slacks of every kind along the step.
    std::vector<LineSet> line_sets_;   // Lines of every Limit for this step.
    std::vector<Reals> dual_changes_;  // Newton step of the duals of every kind.
};

}  // namespace kernel
