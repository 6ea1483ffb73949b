// The objective with several ground nodes: to maximise the least of the nodes' weighted means.
//
// The weighted mean of a node is (offset + mean over the slots of share (rate - leak)) / weight.
// The least of these means is smoothed: it is the maximum over eta of
// eta + mu sum log((mean - eta) / mu). The barrier function has minus N times this maximum.
#pragma once

#include <algorithm>

#include "epigraph.hpp"
#include "linear.hpp"
#include "newton.hpp"

namespace kernel {

constexpr double SHARES_MU_FACTOR = 0.25;  // Decrease of the barrier parameter in find_shares.
constexpr double PRICE_FACTOR = 4.0;  // Largest factor by which find_shares changes a price a step.
constexpr int SHARE_STEPS = 3;        // Steps in find_shares for each barrier parameter.

class MaxMin {
public:
    explicit MaxMin(const BarrierProblem& problem)
        : weights_(problem.receivers.weights), offsets_(problem.receivers.offsets),
          slots_(problem.slots), nodes_(problem.nodes()),
          size_(3 * problem.uavs), rate_unit_(problem.rate_unit),
          gradients_(slots_ * nodes_ * size_), changes_(nodes_) {}

    // Return N offset / weight of each node, (G): the part of N times its mean without shares.
    Reals sum_offsets() const {
        Reals sums(offsets_);
        for (int k = 0; k < nodes_; ++k) sums[k] *= double(slots_) / weights_[k];
        return sums;
    }

    // Return -N times the smoothed least mean, max over eta of eta + mu sum log((mean - eta) / mu).
    // Set here.node_slacks to mean - eta of each node at the best eta, which is below all means.
    // The mean of a node is (offset + mean over the slots of share (rate - leak)) / weight. Both
    // `shares` and here.node_rates, which are (rate - leak) / weight, are (N, G).
    double evaluate(const double* shares, double mu, Evaluation& here) const {
        Reals& slacks = here.node_slacks;
        slacks = sum_offsets();
        for (std::size_t i = 0; i < slots_ * nodes_; i += nodes_)
            for (int k = 0; k < nodes_; ++k) slacks[k] += shares[i + k] * here.node_rates[i + k];
        // Minus the means, because solve_epigraph smooths the largest value.
        for (double& slack : slacks) slack /= -double(slots_);
        LogSum gaps;
        const double minus_eta = solve_epigraph(slacks.data(), nodes_, mu, gaps);
        return double(slots_) * (minus_eta - mu * gaps.total());
    }

    // Fill the shares, (N, G), that nearly minimise the barrier function for the rates in
    // here.node_rates. In the dual problem each node has a price, and the prices add up to 1. For
    // given prices, each slot has shares of its own. Newton's method moves the prices, SHARE_STEPS
    // times for each barrier parameter `level`, which falls to mu by the factor SHARES_MU_FACTOR.
    void find_shares(double mu, const Evaluation& here, double* shares) const {
        Reals prices(nodes_, 1.0 / nodes_);
        for (double level = std::max(mu, rate_unit_); ;
             level = std::max(mu, SHARES_MU_FACTOR * level)) {
            for (int step = 0; step < SHARE_STEPS; ++step)
                if (!move_prices(level, here, prices, shares)) break;
            if (level == mu) break;
        }
        for (std::size_t n = 0; n < slots_; ++n) share_slot(n, mu, here, prices, shares);
    }

    // Extend the objective's derivatives in slot n from x to the slot's G - 1 variable shares; the
    // first share is 1 minus their sum. `rates` and `leaks` (G, V) are the nodes' gradients, and
    // `block` (V, V) is the Hessian in x. Fill the `gradient` by shares, (G - 1), and the `hessian`
    // in x and shares, (V + G - 1, V + G - 1). Keep gradients_ of (rate - leak) / weight.
    void add_shares(std::size_t n, const Iterate& iterate, double mu, const double* rates,
                    const double* leaks, const double* block, double* gradient, double* hessian) {
        const int V = size_, W = V + nodes_ - 1;
        double* by_node = &gradients_[n * nodes_ * V];
        for (int k = 0; k < nodes_; ++k)
            for (int j = 0; j < V; ++j)
                by_node[k * V + j] = (rates[k * V + j] - leaks[k * V + j]) / weights_[k];
        std::fill(hessian, hessian + W * W, 0.0);
        for (int j = 0; j < V; ++j) std::copy_n(block + j * V, j + 1, hessian + j * W);
        const auto find_slope = [&](int k) {
            const Evaluation& here = iterate.evaluation;
            return mu / here.node_slacks[k] * here.node_rates[n * nodes_ + k];
        };
        for (int k = 1; k < nodes_; ++k) {
            gradient[k - 1] = find_slope(0) - find_slope(k);
            for (int j = 0; j < V; ++j)
                hessian[(V + k - 1) * W + j] =
                    iterate.node_duals[0] * by_node[j] - iterate.node_duals[k] * by_node[k * V + j];
        }
    }

    // Fill the nodes' G dense rows of the linear system and their ratios slack / (N dual). Row k is
    // the gradient of node k's weighted mean, which `evaluate` defines, minus an average of all
    // nodes' gradients with the weights 1 / ratio; this eliminates eta. The variables are x and in
    // each slot S = G - 1 shares. Node k's entry for variable i is rows[i R + k].
    void fill_rows(const Iterate& iterate, int R, double* rows, double* ratios) const {
        const int G = nodes_, V = size_, S = G - 1;
        double total = 0.0;
        for (int k = 0; k < G; ++k) {
            ratios[k] =
                iterate.evaluation.node_slacks[k] / (double(slots_) * iterate.node_duals[k]);
            total += 1.0 / ratios[k];
        }
        const auto centre = [&](double* entries) {
            double average = 0.0;
            for (int k = 0; k < G; ++k) average += entries[k] / ratios[k];
            for (int k = 0; k < G; ++k) entries[k] -= average / total;
        };
        for (std::size_t n = 0; n < slots_; ++n) {
            const double* weighted_rates = &iterate.evaluation.node_rates[n * G];
            for (int j = 0; j < V; ++j) {
                double* entries = rows + (n * V + j) * R;
                for (int k = 0; k < G; ++k)
                    entries[k] = iterate.shares[n * G + k] * gradients_[(n * G + k) * V + j]
                        / double(slots_);
                centre(entries);
            }
            // A variable share of node 1 + s takes from node 0's share, 1 minus the variable ones.
            for (int s = 0; s < S; ++s) {
                double* entries = rows + (slots_ * V + n * S + s) * R;
                std::fill(entries, entries + G, 0.0);
                entries[0] = -weighted_rates[0] / double(slots_);
                entries[1 + s] = weighted_rates[1 + s] / double(slots_);
                centre(entries);
            }
        }
    }

    // Find the Newton step of the nodes' duals for a step of the variables, and lower the step
    // length `length` so that the duals stay positive. rows[i R + k]: variable i, node k.
    void find_dual_changes(const Iterate& iterate, const double* step, double mu, int R,
                           const double* rows, double& length) {
        const int G = nodes_;
        Reals slopes(G, 0.0);  // Slopes of minus the means, up to a constant: rows are centred.
        for (std::size_t i = 0; i < slots_ * (size_ + G - 1); ++i)
            for (int k = 0; k < G; ++k) slopes[k] -= rows[i * R + k] * step[i];
        find_epigraph_changes(G, mu, iterate.evaluation.node_slacks.data(),
                              iterate.node_duals.data(), slopes.data(), changes_.data(), length);
    }

    void move_duals(Iterate& iterate, double length) const {
        move_epigraph_duals(nodes_, length, changes_.data(), iterate.node_duals.data());
    }

private:
    // Set the shares of slot n, of all shares (N, G), to the best for the nodes' prices, (G):
    // share k is proportional to mu / (t - price_k rate_k) with the t of solve_epigraph.
    void share_slot(std::size_t n, double mu, const Evaluation& here, const Reals& prices,
                    double* shares) const {
        double* share = shares + n * nodes_;
        for (int k = 0; k < nodes_; ++k) share[k] = prices[k] * here.node_rates[n * nodes_ + k];
        LogSum gaps;
        solve_epigraph(share, nodes_, mu, gaps);
        double sum = 0.0;
        for (int k = 0; k < nodes_; ++k) sum += share[k] = mu / share[k];
        for (int k = 0; k < nodes_; ++k) share[k] /= sum;
    }

    // Set the shares of all slots, (N, G), to the best for the nodes' prices, (G). Then move each
    // price by a Newton step, by at most the factor PRICE_FACTOR, and scale the prices to sum 1.
    // Return false, with the prices as they are, if the system of the step is singular.
    bool move_prices(double mu, const Evaluation& here, Reals& prices, double* shares) const {
        const int G = nodes_, H = G + 1;
        const Reals offsets = sum_offsets();
        // Newton's system for the prices; its last row keeps the sum of the prices. The derivative
        // of share k by price j is share_k^2 rate_j ([k = j] - share_j^2 / squares) / mu.
        Reals matrix(H * H, 0.0), right(H, 0.0);
        for (int k = 0; k < G; ++k) right[k] = -offsets[k];
        for (std::size_t n = 0; n < slots_; ++n) {
            share_slot(n, mu, here, prices, shares);
            const double *share = shares + n * G, *rate = &here.node_rates[n * G];
            double squares = 0.0;
            for (int k = 0; k < G; ++k) squares += share[k] * share[k];
            for (int k = 0; k < G; ++k) {
                right[k] -= share[k] * rate[k];
                for (int j = 0; j < G; ++j)
                    matrix[k * H + j] += rate[k] * rate[j] * share[k]
                        * ((j == k ? share[k] : 0.0)
                           - share[k] * share[j] / squares * share[j]) / mu;
            }
        }
        for (int k = 0; k < G; ++k) {
            right[k] += double(slots_) * mu / prices[k];
            matrix[k * H + k] += double(slots_) * mu / (prices[k] * prices[k]);
            matrix[k * H + G] = matrix[G * H + k] = 1.0;
        }
        if (!solve_dense(matrix.data(), right.data(), H)) return false;
        double sum = 0.0;
        for (int k = 0; k < G; ++k)
            sum += prices[k] = std::clamp(prices[k] + right[k], prices[k] / PRICE_FACTOR,
                                          prices[k] * PRICE_FACTOR);
        for (double& price : prices) price /= sum;
        return true;
    }

    const Reals &weights_, &offsets_;
    const std::size_t slots_;
    const int nodes_, size_;
    const double rate_unit_;
    Reals gradients_;  // Gradients of (rate - leak) / weight of each node, (N, G, V).
    Reals changes_;    // Newton step of the duals, (G).
};

}  // namespace kernel
