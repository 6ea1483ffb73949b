// The objective: the sum of all slots' leaks less r_0, or that of several ground nodes, with their
// derivatives and the duals in them.
#pragma once

#include <algorithm>
#include <cmath>

#include "leaks.hpp"
#include "max_min.hpp"
#include "newton.hpp"
#include "signals.hpp"

namespace kernel {

constexpr double SOFTENING = 0.3;  // Rounding of the kink above an eavesdropper, in sqrt(mu).

// For a number of UAVs and a channel model as Signals are.
template <int UAVS, class Model>
class Rates {
public:
    explicit Rates(const BarrierProblem& problem)
        : nodes(problem), p_(problem), signals_(problem),
          several_(problem.nodes() > 1), weights_(receivers()), central_(receivers()),
          gradients_(p_.slots * receivers() * size()), block_(size() * size()),
          leak_gradients_(p_.nodes() * size()) {
        // A single one is that of all nodes where no node listens.
        const int leaks = p_.listeners() ? p_.nodes() : 1;
        leaks_.reserve(leaks);
        for (int k = 0; k < leaks; ++k)
            leaks_.emplace_back(problem, k, k ? leaks_.back().end() : 0);
        node_leaks_.resize(leaks);
        leak_weights_.resize(leaks);
        leak_central_.resize(leaks);
    }

    // The mean rate, or the least of the weighted ones, losing slots silenced, in nats.
    double find_mean(const Iterate& iterate) {
        const int G = p_.nodes();
        Reals means = nodes.sum_offsets();
        resize(scratch_);
        for (std::size_t n = 0; n < p_.slots; ++n) {
            const Reception* at = signals_.receive(iterate.x, n, 0.0, scratch_);
            for (std::size_t l = 0; l < leaks_.size(); ++l)
                node_leaks_[l] = leaks_[l].find(at + G);
            for (int k = 0; k < G; ++k)
                means[k] += iterate.shares[n * G + k]
                    * std::max(at[k].rate() - node_leaks_[leak_of(k)], 0.0)
                    / p_.receivers.weights[k];
        }
        return *std::min_element(means.begin(), means.end()) / double(p_.slots);
    }

    // Find the rates at an x, and return their part of the barrier function.
    double evaluate(const double* x, const double* shares, double mu, Evaluation& here) {
        const int G = p_.nodes();
        const double softening = SOFTENING * std::sqrt(mu / p_.rate_unit);
        RateSum sum;
        resize(here);
        for (std::size_t n = 0; n < p_.slots; ++n) {
            const Reception* at = signals_.receive(x, n, softening * softening, here);
            if (!several_) {
                sum.subtract(at[0]);
                leaks_[0].evaluate(n, at + G, mu, here, sum);
                continue;
            }
            for (std::size_t l = 0; l < leaks_.size(); ++l) {
                RateSum own;
                leaks_[l].evaluate(n, at + G, mu, here, own);
                node_leaks_[l] = own.total(mu);
            }
            for (int k = 0; k < G; ++k)
                here.node_rates[n * G + k] =
                    (at[k].rate() - node_leaks_[leak_of(k)]) / p_.receivers.weights[k];
        }
        if (several_) return nodes.evaluate(shares, mu, here);
        // A sum that is smooth lacks the t = mu of every slot.
        return sum.total(mu, here.leak_slacks.empty() ? mu * double(p_.slots) : 0.0);
    }

    // Find gradient and Hessian of the objective, and what update_duals needs.
    void differentiate(const Iterate& iterate, double mu, double* gradients, double* hessians) {
        const int K = receivers(), V = size(), G = p_.nodes(), W = V + p_.shares();
        for (std::size_t n = 0; n < p_.slots; ++n) {
            double *gradient = gradients + n * V, *rates = &gradients_[n * K * V];
            double* hessian = several_ ? block_.data() : hessians + n * V * V;
            std::fill(gradient, gradient + V, 0.0);
            std::fill(hessian, hessian + V * V, 0.0);
            weigh(n, iterate, mu);
            for (int k = 0; k < K; ++k) {
                double* rate = rates + k * V;
                signals_.differentiate(iterate, n, k, weights_[k], rate, hessian);
                for (int j = 0; j < V; ++j) gradient[j] += central_[k] * rate[j];
            }
            for (std::size_t l = 0; l < leaks_.size(); ++l)
                leaks_[l].add_curvature(n, iterate, leak_weights_[l], rates + G * V, hessian);
            if (!several_) continue;
            std::fill(leak_gradients_.begin(), leak_gradients_.end(), 0.0);
            for (int k = 0; k < G; ++k) {
                const Leak<UAVS>& leak = leaks_[leak_of(k)];
                for (int e = 0; e < leak.count(); ++e)
                    for (int j = 0; j < V; ++j)
                        leak_gradients_[k * V + j] +=
                            leak.central()[e] * rates[(G + leak.hearer(e)) * V + j];
            }
            nodes.add_shares(n, iterate, mu, rates, leak_gradients_.data(), hessian,
                             gradients + p_.slots * V + n * p_.shares(), hessians + n * W * W);
        }
    }

    // Move the duals of leaks and nodes, whose sums are 1, along with a step, as far as all duals
    // stay positive; `length` is that of the duals of the limits, `rows` as in MaxMin::fill_rows.
    void update_duals(Iterate& iterate, const double* step, double mu, int R, const double* rows,
                      double& length) {
        const int V = size();
        for (Leak<UAVS>& leak : leaks_)
            leak.find_dual_changes(iterate, step, mu, &gradients_[p_.nodes() * V],
                                   receivers() * V, length);
        if (several_) nodes.find_dual_changes(iterate, step, mu, R, rows, length);
        for (const Leak<UAVS>& leak : leaks_) leak.move_duals(iterate, length);
        if (several_) nodes.move_duals(iterate, length);
    }

    MaxMin nodes;  // Where there are several.

private:
    int size() const { return 3 * (UAVS ? UAVS : p_.uavs); }
    int receivers() const { return p_.receivers.count; }
    std::size_t leak_of(int node) const { return leaks_.size() > 1 ? node : 0; }

    void resize(Evaluation& here) const {
        here.receptions.resize(p_.slots * receivers());
        here.squared.resize(p_.slots * receivers() * p_.uavs);
        here.distance.resize(here.squared.size());
        if (several_) here.node_rates.resize(p_.slots * p_.nodes());
    }

    // Find the derivatives of the objective by the rates of a slot, and the weights of the rates'
    // Hessians, and the leaks', in its own.
    void weigh(std::size_t n, const Iterate& iterate, double mu) {
        const int G = p_.nodes();
        std::fill(weights_.begin(), weights_.end(), 0.0);
        std::fill(central_.begin(), central_.end(), 0.0);
        std::fill(leak_weights_.begin(), leak_weights_.end(), several_ ? 0.0 : 1.0);
        std::fill(leak_central_.begin(), leak_central_.end(), several_ ? 0.0 : 1.0);
        for (int k = 0; k < G; ++k) {
            weights_[k] = central_[k] = -1.0;
            if (!several_) continue;
            const double share = iterate.shares[n * G + k] / p_.receivers.weights[k];
            leak_weights_[leak_of(k)] += iterate.node_duals[k] * share;
            leak_central_[leak_of(k)] += mu / iterate.evaluation.node_slacks[k] * share;
            weights_[k] = -iterate.node_duals[k] * share;
            central_[k] = -mu / iterate.evaluation.node_slacks[k] * share;
        }
        const Reception* at = &iterate.evaluation.receptions[n * receivers() + G];
        for (std::size_t l = 0; l < leaks_.size(); ++l) {
            const double* duals = leaks_[l].weigh(n, at, iterate, mu);
            for (int e = 0; e < leaks_[l].count(); ++e) {
                weights_[G + leaks_[l].hearer(e)] += leak_weights_[l] * duals[e];
                central_[G + leaks_[l].hearer(e)] += leak_central_[l] * leaks_[l].central()[e];
            }
        }
    }

    const BarrierProblem& p_;
    Signals<UAVS, Model> signals_;
    std::vector<Leak<UAVS>> leaks_;  // For each node, (G), or a single one.
    const bool several_;             // Whether there are several ground nodes.
    Reals weights_, central_;        // Of the rates of a slot, (K).
    Reals node_leaks_, leak_weights_, leak_central_;  // Of a slot, as leaks_.
    Reals gradients_;                // Of all rates, (N, K, V).
    Reals block_, leak_gradients_;   // Of a slot, (V, V) and (G, V).
    Evaluation scratch_;
};

}  // namespace kernel
