// The objective, to be minimised: the sum over the slots of leak minus r_0. With several ground
// nodes it is minus the least weighted mean, in max_min.hpp. Also its derivatives and duals.
#pragma once

#include <algorithm>
#include <cmath>

#include "leaks.hpp"
#include "max_min.hpp"
#include "newton.hpp"
#include "signals.hpp"

namespace kernel {

constexpr double SOFTENING = 0.3;  // Softening of the kink above a receiver, over sqrt(mu).

// UAVS is the number of UAVs if it is known when compiling, or 0 for any number. Model is the
// channel model, or LinkGains for any model.
template <int UAVS, class Model>
class Rates {
public:
    // Make one Leak for each ground node if any node listens; otherwise all nodes share one Leak.
    explicit Rates(const BarrierProblem& problem)
        : nodes(problem), p_(problem), signals_(problem),
          several_(problem.nodes() > 1), rate_weights_(receivers()), by_rates_(receivers()),
          gradients_(p_.slots * receivers() * size()), block_(size() * size()),
          leak_gradients_(p_.nodes() * size()) {
        const int leaks = p_.listeners() ? p_.nodes() : 1;
        leaks_.reserve(leaks);
        for (int k = 0; k < leaks; ++k)
            leaks_.emplace_back(problem, k, k ? leaks_.back().end() : 0);
        node_leaks_.resize(leaks);
        leak_weights_.resize(leaks);
        by_leaks_.resize(leaks);
    }

    // Return min over nodes of (offset + mean over slots of share [rate - leak]^+) / weight, in
    // nats, without any smoothing.
    double compute_least_mean(const Iterate& iterate) {
        const int G = p_.nodes();
        Reals means = nodes.sum_offsets();
        resize(scratch_);
        for (std::size_t n = 0; n < p_.slots; ++n) {
            const Reception* at = signals_.receive(iterate.x, n, 0.0, scratch_);
            for (std::size_t l = 0; l < leaks_.size(); ++l)
                node_leaks_[l] = leaks_[l].compute_exact(at + G);
            for (int k = 0; k < G; ++k)
                means[k] += iterate.shares[n * G + k]
                    * std::max(at[k].rate() - node_leaks_[leak_of(k)], 0.0)
                    / p_.receivers.weights[k];
        }
        return *std::min_element(means.begin(), means.end()) / double(p_.slots);
    }

    // Fill `here` with the receptions and node rates at an x. Return the objective: for one node
    // the sum over the slots of (leak - rate), and for several nodes -N times the smoothed least of
    // their means, by MaxMin::evaluate. A leak that is the largest of several rates is smoothed.
    double evaluate(const double* x, const double* shares, double mu, Evaluation& here) {
        const int G = p_.nodes();
        const double softening = SOFTENING * std::sqrt(mu / p_.rate_unit);
        RateSum sum;
        resize(here);
        for (std::size_t n = 0; n < p_.slots; ++n) {
            const Reception* at = signals_.receive(x, n, softening * softening, here);
            if (!several_) {
                sum.subtract(at[0]);
                leaks_[0].add_leak(n, at + G, mu, here, sum);
                continue;
            }
            for (std::size_t l = 0; l < leaks_.size(); ++l) {
                RateSum leak;
                leaks_[l].add_leak(n, at + G, mu, here, leak);
                node_leaks_[l] = leak.total(mu);
            }
            for (int k = 0; k < G; ++k)
                here.node_rates[n * G + k] =
                    (at[k].rate() - node_leaks_[leak_of(k)]) / p_.receivers.weights[k];
        }
        if (several_) return nodes.evaluate(shares, mu, here);
        // A smoothed leak is larger by terms that include mu. A leak that is not smoothed gets mu
        // for each slot, so that both kinds of values are comparable.
        return sum.total(mu, here.leak_slacks.empty() ? mu * double(p_.slots) : 0.0);
    }

    // Find the objective's gradient, (N, V) by x and behind it (N, G - 1) by shares, and the
    // primal-dual Newton matrix, a block (W, W) a slot with W = V + G - 1. V = 3 U variables are
    // powers and positions. Smoothed terms have weights mu / slack in the gradient and the duals in
    // the matrix. The rates' gradients are kept for update_duals.
    void differentiate(const Iterate& iterate, double mu, double* gradients, double* hessians) {
        const int K = receivers(), V = size(), G = p_.nodes(), W = V + p_.shares();
        for (std::size_t n = 0; n < p_.slots; ++n) {
            double *gradient = gradients + n * V, *rates = &gradients_[n * K * V];
            double* hessian = several_ ? block_.data() : hessians + n * V * V;
            std::fill(gradient, gradient + V, 0.0);
            std::fill(hessian, hessian + V * V, 0.0);
            differentiate_by_rates(n, iterate, mu);
            for (int k = 0; k < K; ++k) {
                double* rate = rates + k * V;
                signals_.differentiate(iterate, n, k, rate_weights_[k], rate, hessian);
                for (int j = 0; j < V; ++j) gradient[j] += by_rates_[k] * rate[j];
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
                            leak.by_rates()[e] * rates[(G + leak.hearer(e)) * V + j];
            }
            nodes.add_shares(n, iterate, mu, rates, leak_gradients_.data(), hessian,
                             gradients + p_.slots * V + n * p_.shares(), hessians + n * W * W);
        }
    }

    // Move the duals of leaks and nodes along their step. `length` comes in as the step length that
    // keeps the limits' duals positive. It is lowered until duals of leaks and nodes stay positive,
    // too. `rows` are the nodes' dense rows by MaxMin::fill_rows, R numbers for each variable.
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

    MaxMin nodes;  // Used only with several ground nodes.

private:
    int size() const { return 3 * (UAVS ? UAVS : p_.uavs); }
    int receivers() const { return p_.receivers.count; }
    std::size_t leak_of(int node) const { return leaks_.size() > 1 ? node : 0; }

    // Give the arrays that `evaluate` fills their sizes.
    void resize(Evaluation& here) const {
        here.receptions.resize(p_.slots * receivers());
        here.squared.resize(p_.slots * receivers() * p_.uavs);
        here.distance.resize(here.squared.size());
        if (several_) here.node_rates.resize(p_.slots * p_.nodes());
    }

    // Set for slot n the objective's derivatives by the K receivers' rates (by_rates_) and by the
    // leaks (by_leaks_), and the weights of the rates' and leaks' Hessians in the Newton matrix
    // (rate_weights_, leak_weights_). With one ground node, derivative and weight are -1 for its
    // rate and 1 for the leak. With several, node k has c = share / weight. Its rate then has the
    // derivative -c mu / slack and the weight -c dual (primal-dual method), and its leak the same
    // with a plus sign, summed over nodes that share it. A hearer's rate has the leak's derivative
    // and weight times the numbers of Leak::differentiate_by_rates.
    void differentiate_by_rates(std::size_t n, const Iterate& iterate, double mu) {
        const int G = p_.nodes();
        std::fill(rate_weights_.begin(), rate_weights_.end(), 0.0);
        std::fill(by_rates_.begin(), by_rates_.end(), 0.0);
        std::fill(leak_weights_.begin(), leak_weights_.end(), several_ ? 0.0 : 1.0);
        std::fill(by_leaks_.begin(), by_leaks_.end(), several_ ? 0.0 : 1.0);
        for (int k = 0; k < G; ++k) {
            rate_weights_[k] = by_rates_[k] = -1.0;
            if (!several_) continue;
            const double c = iterate.shares[n * G + k] / p_.receivers.weights[k];
            leak_weights_[leak_of(k)] += iterate.node_duals[k] * c;
            by_leaks_[leak_of(k)] += mu / iterate.evaluation.node_slacks[k] * c;
            rate_weights_[k] = -iterate.node_duals[k] * c;
            by_rates_[k] = -mu / iterate.evaluation.node_slacks[k] * c;
        }
        const Reception* at = &iterate.evaluation.receptions[n * receivers() + G];
        for (std::size_t l = 0; l < leaks_.size(); ++l) {
            const double* hearer_weights = leaks_[l].differentiate_by_rates(n, at, iterate, mu);
            for (int e = 0; e < leaks_[l].count(); ++e) {
                rate_weights_[G + leaks_[l].hearer(e)] += leak_weights_[l] * hearer_weights[e];
                by_rates_[G + leaks_[l].hearer(e)] += by_leaks_[l] * leaks_[l].by_rates()[e];
            }
        }
    }

    const BarrierProblem& p_;
    Signals<UAVS, Model> signals_;
    std::vector<Leak<UAVS>> leaks_;  // One for each node, or one for all nodes.
    const bool several_;             // Whether there are several ground nodes.
    Reals rate_weights_, by_rates_;  // For the rates of a slot, (K); see differentiate_by_rates.
    Reals node_leaks_;               // The leaks of a slot in nats, one for each of leaks_.
    Reals leak_weights_, by_leaks_;  // For the leaks of a slot; see differentiate_by_rates.
    Reals gradients_;                // Gradients of all receivers' rates, (N, K, V).
    Reals block_;                    // Hessian of a slot in x, (V, V).
    Reals leak_gradients_;           // Gradients of a slot's leak for each node, (G, V).
    Evaluation scratch_;
};

}  // namespace kernel
