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
        : nodes(problem), p_(problem), signals_(problem), leak_(problem),
          several_(problem.nodes() > 1), weights_(receivers()), central_(receivers()),
          gradients_(p_.slots * receivers() * size()), block_(size() * size()),
          leak_gradient_(size()) {}

    // The mean rate, or the least of the weighted ones, losing slots silenced, in nats.
    double find_mean(const Iterate& iterate) {
        const int G = p_.nodes();
        Reals means = nodes.sum_offsets();
        resize(scratch_);
        for (std::size_t n = 0; n < p_.slots; ++n) {
            const Reception* at = signals_.receive(iterate.x, n, 0.0, scratch_);
            const double leak = leak_.find(at + G);
            for (int k = 0; k < G; ++k)
                means[k] += iterate.shares[n * G + k] * std::max(at[k].rate() - leak, 0.0)
                    / p_.receivers.weights[k];
        }
        return *std::min_element(means.begin(), means.end()) / double(p_.slots);
    }

    // Find the rates at an x, and return their part of the barrier function.
    double evaluate(const double* x, const double* shares, double mu, Evaluation& here) const {
        const int G = p_.nodes();
        const double softening = SOFTENING * std::sqrt(mu / p_.rate_unit);
        RateSum sum;
        resize(here);
        for (std::size_t n = 0; n < p_.slots; ++n) {
            const Reception* at = signals_.receive(x, n, softening * softening, here);
            if (!several_) {
                sum.subtract(at[0]);
                leak_.evaluate(n, at + G, mu, here, sum);
                continue;
            }
            RateSum own;
            leak_.evaluate(n, at + G, mu, here, own);
            const double leak = own.total(mu);
            for (int k = 0; k < G; ++k)
                here.node_rates[n * G + k] = (at[k].rate() - leak) / p_.receivers.weights[k];
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
            const double leak_weight = weigh(n, iterate, mu);
            for (int k = 0; k < K; ++k) {
                double* rate = rates + k * V;
                signals_.differentiate(iterate, n, k, weights_[k], rate, hessian);
                for (int j = 0; j < V; ++j) gradient[j] += central_[k] * rate[j];
            }
            leak_.add_curvature(n, iterate, leak_weight, rates + G * V, hessian);
            if (!several_) continue;
            std::fill(leak_gradient_.begin(), leak_gradient_.end(), 0.0);
            for (int k = G; k < K; ++k)
                for (int j = 0; j < V; ++j)
                    leak_gradient_[j] += leak_.central()[k - G] * rates[k * V + j];
            nodes.add_shares(n, iterate, mu, rates, leak_gradient_.data(), hessian,
                             gradients + p_.slots * V + n * p_.shares(), hessians + n * W * W);
        }
    }

    // Move the duals of leaks and nodes, whose sums are 1, along with a step, as far as all duals
    // stay positive; `length` is that of the duals of the limits, `rows` as in MaxMin::fill_rows.
    void update_duals(Iterate& iterate, const double* step, double mu, int R, const double* rows,
                      double& length) {
        const int V = size();
        leak_.find_dual_changes(iterate, step, mu, &gradients_[p_.nodes() * V], receivers() * V,
                                length);
        if (several_) nodes.find_dual_changes(iterate, step, mu, R, rows, length);
        leak_.move_duals(iterate, length);
        if (several_) nodes.move_duals(iterate, length);
    }

    MaxMin nodes;  // Where there are several.

private:
    int size() const { return 3 * (UAVS ? UAVS : p_.uavs); }
    int receivers() const { return p_.receivers.count; }

    void resize(Evaluation& here) const {
        here.receptions.resize(p_.slots * receivers());
        here.squared.resize(p_.slots * receivers() * p_.uavs);
        here.distance.resize(here.squared.size());
        if (several_) here.node_rates.resize(p_.slots * p_.nodes());
    }

    // Find the derivatives of the objective by the rates of a slot, and the weights of the rates'
    // Hessians in its own; return the weight of the leak's.
    double weigh(std::size_t n, const Iterate& iterate, double mu) {
        const int G = p_.nodes();
        double weight = several_ ? 0.0 : 1.0, central = weight;
        for (int k = 0; k < G; ++k) {
            weights_[k] = central_[k] = -1.0;
            if (!several_) continue;
            const double share = iterate.shares[n * G + k] / p_.receivers.weights[k];
            weight += iterate.node_duals[k] * share;
            central += mu / iterate.evaluation.node_slacks[k] * share;
            weights_[k] = -iterate.node_duals[k] * share;
            central_[k] = -mu / iterate.evaluation.node_slacks[k] * share;
        }
        const double* duals =
            leak_.weigh(n, &iterate.evaluation.receptions[n * receivers() + G], iterate, mu);
        for (int k = G; k < receivers(); ++k) {
            weights_[k] = weight * duals[k - G];
            central_[k] = central * leak_.central()[k - G];
        }
        return weight;
    }

    const BarrierProblem& p_;
    Signals<UAVS, Model> signals_;
    Leak<UAVS> leak_;
    const bool several_;           // Whether there are several ground nodes.
    Reals weights_, central_;      // Of the rates of a slot, (K).
    Reals gradients_;              // Of all rates, (N, K, V).
    Reals block_, leak_gradient_;  // Of a slot, (V, V) and (V).
    Evaluation scratch_;
};

}  // namespace kernel
