// The slacks c > 0 of a BarrierProblem and their duals.
//
// The kinds of slacks, in this order: one kind for each limit, peaks of powers, average powers,
// and shares. A slack has the barrier term -mu log c; the slack of an average power has
// -N mu log c.
#pragma once

#include <algorithm>
#include <cmath>

#include "epigraph.hpp"
#include "newton.hpp"
#include "numbers.hpp"

namespace kernel {

constexpr double DUAL_RANGE = 1e4;  // Largest ratio of a dual to its central value mu / c.

// UAVS is the number of UAVs if it is known when compiling, or 0 for any number.
template <int UAVS>
class Constraints {
public:
    explicit Constraints(const BarrierProblem& problem)
        : p_(problem), limits_(p_.limits.size()), means_(limits_ + 1),
          kinds_(means_ + 2), slopes_(kinds_), line_sets_(limits_), dual_changes_(kinds_) {
        for (const auto& limit : p_.limits) have_lines = have_lines || limit->has_lines();
    }

    bool have_lines = false;  // Whether any limit chooses lines before every step.

    // Choose lines at x. The evaluation `here` at x and the trials of the line search share them.
    void choose_lines(const double* x, Evaluation& here, Evaluation& trial) {
        here.slacks.resize(kinds_);
        trial.slacks.resize(kinds_);
        if (have_lines) p_.fill_path(x, path_);
        for (std::size_t l = 0; l < limits_; ++l) {
            if (has_lines(l)) p_.limits[l]->choose_lines(path_.data(), line_sets_[l]);
            here.slacks[l].lines = trial.slacks[l].lines = &line_sets_[l];
        }
    }

    // Find all slacks at an x and the barrier function's value. `objective` is the value's part
    // without barrier terms.
    void evaluate(const double* x, const double* shares, double objective, double mu,
                  Evaluation& here) {
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
        evaluate_lines(mu, here);
    }

    // Find the slacks of limits with lines on the path of the last evaluate, and the barrier
    // function's value.
    void evaluate_lines(double mu, Evaluation& here) const {
        LogSum sum;
        for (std::size_t l = 0; l < limits_; ++l)
            if (has_lines(l)) add_limit(l, here, sum);
        const double value = here.value_without_lines - mu * sum.total();
        here.value = std::isfinite(value) ? value : INFINITE;
    }

    // Add the gradient of all barrier terms by x and by the shares.
    void add_gradient(const Evaluation& here, double mu, double* gradient) const {
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
    }

    // Add the curvature in x to the band. The average powers' curvature is not a band; see
    // mean_ratio.
    void add_curvature(const Iterate& iterate, const Band& band) const {
        const std::vector<Slacks>& slacks = iterate.evaluation.slacks;
        for_powers([&](std::size_t i, int u) {
            const double* slack = &slacks[limits_].values[2 * i];
            const double* dual = &iterate.duals[limits_][2 * i];
            band.entries[3 * i * band.height] +=
                dual[0] / slack[0] + dual[1] / slack[1] / (p_.peaks[u] * p_.peaks[u]);
        });
        for (std::size_t l = 0; l < limits_; ++l)
            p_.limits[l]->add_curvature(slacks[l], iterate.duals[l], band);
    }
    // The average power of UAV u adds the outer product of its row, divided by this ratio, to the
    // Hessian.
    double mean_ratio(const Iterate& iterate, int u) const {
        return iterate.evaluation.slacks[means_].values[u] / iterate.duals[means_][u];
    }
    // The curvature that the limit share > 0 of share i adds.
    double share_curvature(const Iterate& iterate, std::size_t i) const {
        return iterate.duals.back()[i] / iterate.shares[i];
    }

    // Find the slopes of all slacks along a step.
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
        Reals& shares = slopes_.back().values;
        shares.assign(p_.share_slacks(), 0.0);
        for_shares([&](std::size_t i, std::size_t share, std::size_t first) {
            shares[first] -= step[i];
            shares[share] = step[i];
        });
    }
    const Reals& share_slopes() const { return slopes_.back().values; }

    // Find the largest step length of each UAV's flight within the limits. Return the least of
    // these lengths and of the step lengths of powers and shares.
    double limit_lengths(const Iterate& iterate, const double* step, Reals& lengths) const {
        const std::vector<Slacks>& slacks = iterate.evaluation.slacks;
        std::fill(lengths.begin(), lengths.end(), 1.0);
        for (std::size_t l = 0; l < limits_; ++l)
            p_.limits[l]->limit_steps(slacks[l], slopes_[l], lengths.data());
        double least = *std::min_element(lengths.begin(), lengths.end());
        for_powers([&](std::size_t i, int u) {
            limit_step(least, iterate.x[3 * i], step[3 * i]);
            limit_step(least, p_.peaks[u] - iterate.x[3 * i], -step[3 * i]);
        });
        for (std::size_t l = means_; l < kinds_; ++l)
            for (std::size_t i = 0; i < slacks[l].values.size(); ++i)
                limit_step(least, slacks[l].values[i], slopes_[l].values[i]);
        return least;
    }

    // Set the duals to their central values mu / c.
    void initialise_duals(Iterate& iterate, double mu) const {
        for (std::size_t l = 0; l < kinds_; ++l) {
            iterate.duals.push_back(iterate.evaluation.slacks[l].values);
            for (double& dual : iterate.duals.back()) dual = weigh(l, mu) / dual;
        }
    }

    // Find the Newton step of the duals, and lower its `length` so that they stay positive.
    void find_dual_changes(const Iterate& iterate, double mu, double& length) {
        for (std::size_t l = 0; l < kinds_; ++l) {
            const Reals &duals = iterate.duals[l], &slacks = iterate.evaluation.slacks[l].values;
            const double weight = weigh(l, mu);
            Reals& changes = dual_changes_[l];
            changes.resize(duals.size());
            for (std::size_t i = 0; i < duals.size(); ++i) {
                changes[i] = (weight - duals[i] * slopes_[l].values[i]) / slacks[i] - duals[i];
                limit_step(length, duals[i], changes[i]);
            }
        }
    }

    // Move the duals along their Newton step.
    void move_duals(Iterate& iterate, double length) const {
        for (std::size_t l = 0; l < kinds_; ++l)
            for (std::size_t i = 0; i < iterate.duals[l].size(); ++i)
                iterate.duals[l][i] += length * dual_changes_[l][i];
    }

    // Keep the duals within a factor DUAL_RANGE of their central values.
    void clip_duals(Iterate& iterate, double mu) const {
        for (std::size_t l = 0; l < kinds_; ++l)
            for (std::size_t i = 0; i < iterate.duals[l].size(); ++i) {
                const double central = weigh(l, mu) / iterate.evaluation.slacks[l].values[i];
                double& dual = iterate.duals[l][i];
                dual = std::min(std::max(dual, central / DUAL_RANGE), central * DUAL_RANGE);
            }
    }

private:
    bool has_lines(std::size_t limit) const { return p_.limits[limit]->has_lines(); }

    // Call a function for every power with an index i and the UAV; the power's index in x is 3 i.
    template <typename Function>
    void for_powers(Function function) const {
        const int U = UAVS ? UAVS : p_.uavs;
        for (std::size_t n = 0; n < p_.slots; ++n)
            for (int u = 0; u < U; ++u) function(n * U + u, u);
    }

    // Call a function for every share that varies with three indices: of its variable, of the
    // share among all shares (N, G), and of the first share of its slot.
    template <typename Function>
    void for_shares(Function function) const {
        std::size_t i = p_.slots * p_.uavs * 3;
        for (std::size_t n = 0; n < p_.slots; ++n)
            for (int k = 1; k < p_.nodes(); ++k)
                function(i++, n * p_.nodes() + k, n * p_.nodes());
    }

    // The factor of -log c in the barrier term of a kind of slacks.
    double weigh(std::size_t kind, double mu) const {
        return kind == means_ ? double(p_.slots) * mu : mu;
    }

    // Find the slacks of a limit on the last path, and add their logarithms to a sum.
    void add_limit(std::size_t limit, Evaluation& here, LogSum& sum) const {
        p_.limits[limit]->find_slacks(path_.data(), here.slacks[limit]);
        for (const double slack : here.slacks[limit].values) sum.add(slack);
    }

    const BarrierProblem& p_;
    const std::size_t limits_, means_, kinds_;  // Numbers: of limits, of the kind means, of kinds.
    Reals path_;
    std::vector<Slacks> slopes_;       // Slopes of the slacks of every kind along the step.
    std::vector<LineSet> line_sets_;   // Lines of every Limit for this step.
    std::vector<Reals> dual_changes_;  // Newton step of the duals of every kind.
};

}  // namespace kernel
