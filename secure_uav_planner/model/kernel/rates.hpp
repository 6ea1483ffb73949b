// The rates of all slots with their derivatives, and the duals of the leaks.
//
// A rate is log(1 + S + J) - log(1 + J): the logarithm of the total received power less that of
// interference and noise. By the chain rule, both need only the gain's two derivatives by the
// squared distance and that distance's by the position.
#pragma once

#include <algorithm>
#include <cmath>

#include "linear.hpp"
#include "newton.hpp"
#include "numbers.hpp"

namespace kernel {

constexpr double LEAST_SQUARE = 1e-30;  // Added to d^2, whose root then has a gradient.
constexpr double SOFTENING = 0.3;  // Rounding of the kink above an eavesdropper, in sqrt(mu).
constexpr double ON_EDGE = 1.0 - 1e-6;  // Distance of a place from the centre, in radii.
constexpr double FLATTEST = 0.01;  // Least curvature of a place, as a share of the largest.
// When shares are first found: decrease of the barrier parameter, steps for each and their range.
constexpr double SHARES_MU_FACTOR = 0.25, PRICE_FACTOR = 4.0;
constexpr int SHARE_STEPS = 3;

// log(1 + received / interference), accurate to rounding for a small ratio.
inline double find_rate(double received, double interference) {
    const double ratio = received / interference;
    return ratio < 1e-2 ? std::log1p(ratio) : std::log(1.0 + ratio);
}

// Find two rows (2, V) whose outer products are added to the Hessian of a leak because its place
// moves along with the UAVs. `mixed`, (V, 2), is the leak's derivative by variables and place,
// `slope` that by the place.
//
// For f(x) = max_w g(x, w) it is -g_xw g_ww^-1 g_wx at the worst place w, which is on top of g_xx;
// for a place on the edge of its disc, that along the edge, whose curvature counts too. Without
// it, places and UAVs that follow each other in turn may swing ever further.
inline void find_place_rows(const Places& places, std::size_t index, int variables,
                            const double* mixed, const double* slope, double* rows) {
    double hessian[2][2] = {};
    for (int j = 0; j < variables; ++j)
        if (j % 3)
            for (int axis = 0; axis < 2; ++axis) hessian[j % 3 - 1][axis] += mixed[2 * j + axis];
    double largest = 0.0;
    for (const auto& row : hessian)
        for (const double entry : row) largest = std::max(largest, std::fabs(entry));
    const double least = FLATTEST * largest + TINY;
    const double* offset = &places.offsets[2 * index];
    const double radius = places.radii[index];
    const double distance = std::sqrt(offset[0] * offset[0] + offset[1] * offset[1]);
    const auto set_row = [&](int number, double x, double y, double curvature) {
        const double scale = 1.0 / std::sqrt(std::max(curvature, least));
        for (int j = 0; j < variables; ++j)
            rows[number * variables + j] = (mixed[2 * j] * x + mixed[2 * j + 1] * y) * scale;
    };
    if (distance >= ON_EDGE * radius) {
        const double inverse = 1.0 / std::max(distance, TINY);
        const double x = -offset[1] * inverse, y = offset[0] * inverse;
        const double along = (hessian[0][0] * x + hessian[0][1] * y) * x
            + (hessian[1][0] * x + hessian[1][1] * y) * y;
        set_row(0, x, y, along + (slope[0] * y - slope[1] * x) / std::max(radius, TINY));
        std::fill(rows + variables, rows + 2 * variables, 0.0);
        return;
    }
    // Along the eigenvectors.
    const double mean = 0.5 * (hessian[0][0] + hessian[1][1]);
    const double half = 0.5 * (hessian[0][0] - hessian[1][1]);
    const double spread = std::hypot(half, hessian[1][0]);
    const double angle = 0.5 * std::atan2(hessian[1][0], half);
    set_row(0, std::cos(angle), std::sin(angle), mean + spread);
    set_row(1, -std::sin(angle), std::cos(angle), mean - spread);
}

// The t that minimises t - mu sum log(t - value), by Newton's method on sum mu / (t - value) = 1
// from the left of its root, so without overshooting.
inline double solve_epigraph(const double* values, int count, double mu) {
    const double largest = *std::max_element(values, values + count);
    double t = 1.0;
    for (int step = 0; step < 8; ++step) {
        double sum = 0.0, squares = 0.0;
        for (int i = 0; i < count; ++i) {
            const double inverse = 1.0 / (t + (largest - values[i]) / mu);
            sum += inverse;
            squares += inverse * inverse;
        }
        t += (sum - 1.0) / squares;
    }
    return largest + mu * t;
}

// Find the Newton step of the duals of the largest of several values, t being eliminated;
// `slopes` are the values' along the step, `ratios` the duals divided by their slacks.
inline void find_epigraph_changes(int count, const double* central, const double* duals,
                                  const double* ratios, const double* slopes, double* changes,
                                  double& length) {
    double sum = 0.0, total = 0.0, weighted = 0.0;
    for (int i = 0; i < count; ++i) {
        sum += central[i];
        total += ratios[i];
        weighted += ratios[i] * slopes[i];
    }
    const double largest = (sum - 1.0 + weighted) / total;
    for (int i = 0; i < count; ++i) {
        changes[i] = central[i] - duals[i] - ratios[i] * (largest - slopes[i]);
        limit_step(length, duals[i], changes[i], FRACTION_TO_BOUNDARY);
    }
}

// Move duals, whose sum is 1.
inline void move_epigraph_duals(int count, double length, const double* changes, double* duals) {
    double sum = 0.0;
    for (int i = 0; i < count; ++i) sum += duals[i] += length * changes[i];
    for (int i = 0; i < count; ++i) duals[i] /= sum;
}

// The objective is the sum of all slots' leaks less r_0, or, with several ground nodes, minus N
// times the least of their weighted means, each an offset and that of the rates in its shares of
// the slots. That has -N mu log(mean - eta) for every node, and eta is eliminated, as t is from the
// leaks.
//
// For a number of UAVs and a channel model that are known when compiling, or for any (UAVS = 0,
// Channel).
template <int UAVS, class Model>
class Rates {
public:
    explicit Rates(const Problem& problem)
        : p_(problem), channel_(static_cast<const Model&>(*problem.channel)),
          slots_(problem.slots), count_(problem.uavs), nodes_(problem.nodes()),
          eves_(problem.receivers.count - nodes_), several_(nodes_ > 1),
          largest_counts_(eves_ > 1 && !problem.colluding),
          colluding_(eves_ > 1 && problem.colluding) {
        const std::size_t v = 3 * count_;
        space_.resize(4 * v);
        place_space_.resize(4 * v);
        ratios_.resize(std::max(eves_, nodes_));
        node_space_.resize(nodes_);
        node_changes_.resize(nodes_);
        if (several_) {
            block_.resize(v * v);
            common_gradient_.resize(v);
            node_gradients_.resize(slots_ * nodes_ * v);
        }
        if (eves_ == 1) return;
        leak_slopes_.resize(eves_);
        leak_gradients_.resize(slots_ * eves_ * v);
        central_duals_.resize(slots_ * eves_);
        dual_changes_.resize(slots_ * eves_);
    }

    // The mean rate, or the least of the weighted ones, losing slots silenced, in nats.
    double find_mean(const double* all, const double* shares) {
        const int U = uavs(), K = receivers(), G = nodes_;
        Reals sums = sum_offsets();
        for (std::size_t n = 0; n < slots_; ++n) {
            double leak = -INFINITE, sinrs = 0.0;
            for (int k = 0; k < K; ++k) {
                double received = 0.0, interference = 1.0;
                for (int u = 0; u < U; ++u) {
                    const double* x = all + (n * U + u) * 3;
                    double distance, squared;
                    find_distance(x, n, k, u, 0.0, distance, squared);
                    (u ? interference : received) += channel_.gain(k * U + u, squared) * x[0];
                }
                if (k >= G && colluding_) {
                    sinrs += received / interference;
                    continue;
                }
                const double rate = find_rate(received, interference);
                if (k < G) node_space_[k] = rate;
                else leak = std::max(leak, rate);
            }
            if (colluding_) leak = std::log1p(sinrs);
            for (int k = 0; k < G; ++k)
                sums[k] += shares[n * G + k] * std::max(node_space_[k] - leak, 0.0);
        }
        for (int k = 0; k < G; ++k) sums[k] /= double(slots_) * weight(k);
        return *std::min_element(sums.begin(), sums.end());
    }

    // Find the rates at an x, and return their part of the barrier function.
    double evaluate(const double* x, const double* shares, double mu, Evaluation& here) const {
        const int U = uavs(), K = receivers(), G = nodes_;
        const double softening = SOFTENING * std::sqrt(mu / p_.rate_unit);
        const double soft = softening * softening;
        here.squared.resize(slots_ * K * U);
        here.distance.resize(slots_ * K * U);
        here.total.resize(slots_ * K);
        here.interference.resize(slots_ * K);
        here.leaks.resize(slots_ * eves_);
        here.largest_leaks.resize(slots_);
        here.node_rates.resize(several_ ? slots_ * G : 0);
        LogSum leak_less_ground, gaps;  // Of all slots.
        double value = 0.0;
        for (std::size_t n = 0; n < slots_; ++n) {
            double sinrs = 0.0, leak = 0.0;
            for (int k = 0; k < K; ++k) {
                double received = 0.0, interference = 1.0;
                for (int u = 0; u < U; ++u) {
                    const double* at = x + (n * U + u) * 3;
                    const std::size_t i = (n * K + k) * U + u;
                    find_distance(at, n, k, u, soft, here.distance[i], here.squared[i]);
                    (u ? interference : received) +=
                        channel_.gain(k * U + u, here.squared[i]) * at[0];
                }
                here.interference[n * K + k] = interference;
                here.total[n * K + k] = interference + received;
                if (k >= G && colluding_) {
                    sinrs += received / interference;
                } else if (k >= G && largest_counts_) {
                    here.leaks[n * eves_ + k - G] = find_rate(received, interference);
                } else if (several_) {
                    (k < G ? here.node_rates[n * G + k] : leak) =
                        find_rate(received, interference);
                } else if (received < 1e-2 * interference) {  // More accurate for small ratios.
                    const double rate = std::log1p(received / interference);
                    value += k ? rate : -rate;
                } else {
                    leak_less_ground.add(k ? 1.0 + received / interference
                                           : interference / (interference + received));
                }
            }
            if (colluding_) {
                leak = here.largest_leaks[n] = std::log1p(sinrs);
            } else if (largest_counts_) {
                const double* leaks = &here.leaks[n * eves_];
                leak = here.largest_leaks[n] = solve_epigraph(leaks, eves_, mu);
                LogSum gaps_here;
                for (int e = 0; e < eves_; ++e)
                    (several_ ? gaps_here : gaps).add((leak - leaks[e]) / mu);
                if (several_) leak -= mu * gaps_here.total();
            }
            if (several_)
                for (int k = 0; k < G; ++k) here.node_rates[n * G + k] -= leak;
            else if (eves_ > 1)
                value += leak;
        }
        if (several_) return weigh_nodes(shares, mu, here);
        value += leak_less_ground.total() + (largest_counts_ ? 0.0 : mu * double(slots_));
        return value - mu * gaps.total();
    }

    // Find the shares, (N, G), that maximise the barrier function for the rates of an evaluation,
    // by Newton's method on its dual, in which a node's rates have a price.
    void find_shares(double mu, const Evaluation& here, double* shares) const {
        const int G = nodes_, H = G + 1;
        const Reals offsets = sum_offsets();
        Reals prices(G, 1.0 / G), gains(G), matrix(H * H), right(H);
        const auto share_slot = [&](std::size_t n, double level) {
            for (int k = 0; k < G; ++k)
                gains[k] = prices[k] * here.node_rates[n * G + k] / weight(k);
            const double t = solve_epigraph(gains.data(), G, level);
            double sum = 0.0;
            for (int k = 0; k < G; ++k) sum += shares[n * G + k] = level / (t - gains[k]);
            for (int k = 0; k < G; ++k) shares[n * G + k] /= sum;
        };
        for (double level = std::max(mu, p_.rate_unit); ;
             level = std::max(mu, SHARES_MU_FACTOR * level)) {
            for (int step = 0; step < SHARE_STEPS; ++step) {
                std::fill(matrix.begin(), matrix.end(), 0.0);
                for (int k = 0; k < G; ++k) right[k] = -offsets[k] / weight(k);
                right[G] = 0.0;
                for (std::size_t n = 0; n < slots_; ++n) {
                    share_slot(n, level);
                    const double *share = shares + n * G, *rate = &here.node_rates[n * G];
                    double squares = 0.0;
                    for (int k = 0; k < G; ++k) squares += share[k] * share[k];
                    for (int k = 0; k < G; ++k) {
                        right[k] -= share[k] * rate[k] / weight(k);
                        for (int j = 0; j < G; ++j)
                            matrix[k * H + j] += rate[k] / weight(k) * rate[j] / weight(j)
                                * share[k] * ((j == k ? share[k] : 0.0)
                                              - share[k] * share[j] / squares * share[j]) / level;
                    }
                }
                for (int k = 0; k < G; ++k) {
                    right[k] += double(slots_) * level / prices[k];
                    matrix[k * H + k] += double(slots_) * level / (prices[k] * prices[k]);
                    matrix[k * H + G] = matrix[G * H + k] = 1.0;
                }
                if (!solve_dense(matrix.data(), right.data(), H)) break;
                double sum = 0.0;
                for (int k = 0; k < G; ++k)
                    sum += prices[k] = std::clamp(prices[k] + right[k], prices[k] / PRICE_FACTOR,
                                                  prices[k] * PRICE_FACTOR);
                for (double& price : prices) price /= sum;
            }
            if (level == mu) break;
        }
        for (std::size_t n = 0; n < slots_; ++n) share_slot(n, mu);
    }

    // Find gradient and Hessian of the objective, and what update_duals needs.
    void differentiate(Iterate& iterate, double mu, double* gradients, double* hessians) {
        const Evaluation& here = iterate.evaluation;
        const int U = uavs(), K = receivers(), V = size(), G = nodes_;
        if (several_ && iterate.node_duals.empty())
            for (const double slack : here.node_slacks) iterate.node_duals.push_back(mu / slack);
        if (largest_counts_ && iterate.leak_duals.empty()) {
            iterate.leak_duals.resize(slots_ * eves_);
            for (std::size_t n = 0; n < slots_; ++n)
                for (int e = 0; e < eves_; ++e)
                    iterate.leak_duals[n * eves_ + e] =
                        mu / (here.largest_leaks[n] - here.leaks[n * eves_ + e]);
        }
        double* total_slope = space_.data();  // Of the logarithms of total and interference, (V).
        double* interference_slope = total_slope + V;
        double* mean = interference_slope + V;  // Two rows.
        for (std::size_t n = 0; n < slots_; ++n) {
            double* gradient = gradients + n * V;
            double* hessian = several_ ? block_.data() : hessians + n * V * V;
            std::fill(gradient, gradient + V, 0.0);
            std::fill(hessian, hessian + V * V, 0.0);
            std::fill(common_gradient_.begin(), common_gradient_.end(), 0.0);
            double leak_weight = 1.0, leak_central = 1.0;
            if (several_) leak_weight = leak_central = 0.0;
            for (int k = 0; k < K; ++k) {
                double weight = k < G ? -1.0 : leak_weight;
                double central = k < G ? -1.0 : leak_central, part = 1.0;
                const std::size_t i = n * eves_ + k - G;
                if (k < G && several_) {
                    const double share = iterate.shares[n * G + k] / this->weight(k);
                    weight = -iterate.node_duals[k] * share;
                    central = -mu / here.node_slacks[k] * share;
                    leak_weight -= weight;
                    leak_central -= central;
                } else if (k >= G && colluding_) {
                    part = central_duals_[i] = here.total[n * K + k]
                        / here.interference[n * K + k] * std::exp(-here.largest_leaks[n]);
                    weight *= part;
                    central *= part;
                } else if (k >= G && largest_counts_) {
                    part = central_duals_[i] = mu / (here.largest_leaks[n] - here.leaks[i]);
                    weight *= iterate.leak_duals[i];
                    central *= part;
                }
                for (int u = 0; u < U; ++u)
                    add_signal(iterate, n, k, u, weight, total_slope + 3 * u,
                               interference_slope + 3 * u, hessian + 3 * u * (V + 1));
                for (int j = 0; j < V; ++j) {
                    gradient[j] += central * (total_slope[j] - interference_slope[j]);
                    const double less = weight * total_slope[j];
                    const double more = weight * interference_slope[j];
                    for (int m = 0; m <= j; ++m)
                        hessian[j * V + m] += more * interference_slope[m] - less * total_slope[m];
                }
                if (several_)
                    for (int j = 0; j < V; ++j) {
                        const double slope = total_slope[j] - interference_slope[j];
                        if (k < G) node_gradients_[(n * G + k) * V + j] = slope;
                        else common_gradient_[j] += part * slope;
                    }
                if (k < G || eves_ == 1) continue;
                for (int j = 0; j < V; ++j)
                    leak_gradients_[i * V + j] = total_slope[j] - interference_slope[j];
                if (!p_.places.followed.empty() && p_.places.followed[i])
                    add_place_curvature(
                        iterate, n, k, weight, total_slope, interference_slope, hessian);
            }
            if (largest_counts_)
                add_epigraph_curvature(iterate, n, leak_weight, mean, hessian);
            if (colluding_) add_colluding_curvature(n, leak_weight, mean, hessian);
            if (several_) add_shares(iterate, n, mu, gradients, hessians);
        }
    }

    // Fill the rows of the nodes, those of the variables being R long, and their ratios: the
    // gradients of the slacks, less their mean because eta is eliminated.
    void fill_rows(const Iterate& iterate, int R, double* rows, double* ratios) const {
        const int G = nodes_, V = size(), S = G - 1;
        const Evaluation& here = iterate.evaluation;
        double total = 0.0;
        for (int k = 0; k < G; ++k) {
            ratios[k] = here.node_slacks[k] / (double(slots_) * iterate.node_duals[k]);
            total += 1.0 / ratios[k];
        }
        const auto centre = [&](double* row) {
            double mean = 0.0;
            for (int k = 0; k < G; ++k) mean += row[k] / ratios[k];
            for (int k = 0; k < G; ++k) row[k] -= mean / total;
        };
        for (std::size_t n = 0; n < slots_; ++n) {
            const double *shares = iterate.shares + n * G, *rates = &here.node_rates[n * G];
            for (int j = 0; j < V; ++j) {
                double* row = rows + (n * V + j) * R;
                for (int k = 0; k < G; ++k)
                    row[k] = shares[k] * node_gradients_[(n * G + k) * V + j]
                        / (double(slots_) * weight(k));
                centre(row);
            }
            for (int s = 0; s < S; ++s) {
                double* row = rows + (slots_ * V + n * S + s) * R;
                std::fill(row, row + G, 0.0);
                row[0] = -rates[0] / (double(slots_) * weight(0));
                row[1 + s] = rates[1 + s] / (double(slots_) * weight(1 + s));
                centre(row);
            }
        }
    }

    // Move the duals of leaks and nodes, whose sums are 1, along with a step, as far as all duals
    // stay positive; `length` is that of the duals of the limits, `rows` as in fill_rows.
    void update_duals(Iterate& iterate, const double* step, double mu, int R, const double* rows,
                      double& length) {
        if (largest_counts_)
            for (std::size_t n = 0; n < slots_; ++n) find_dual_changes(iterate, n, step, length);
        if (several_) find_node_changes(iterate, step, mu, R, rows, length);
        if (largest_counts_)
            for (std::size_t n = 0; n < slots_; ++n)
                move_epigraph_duals(eves_, length, &dual_changes_[n * eves_],
                                    &iterate.leak_duals[n * eves_]);
        if (several_)
            move_epigraph_duals(nodes_, length, node_changes_.data(), iterate.node_duals.data());
    }

private:
    int uavs() const { return UAVS ? UAVS : count_; }
    int size() const { return 3 * uavs(); }
    int receivers() const { return nodes_ + eves_; }
    double weight(int k) const { return p_.receivers.weights[k]; }

    // The offsets of the nodes' means, summed over the slots.
    Reals sum_offsets() const {
        Reals sums = p_.receivers.offsets;
        for (double& sum : sums) sum *= double(slots_);
        return sums;
    }

    const double* receiver(std::size_t n, int k) const {
        return &p_.receivers.positions[2 * (n * receivers() + k)];
    }

    // What the guarantee adds to the distance of a UAV from a receiver.
    double edge(std::size_t n, int k, int u) const {
        const double radius = p_.receivers.radii[n * receivers() + k];
        return u ? radius : -radius;
    }

    // Find the distance d from a UAV to a receiver, and ([d + edge]^+)^2. The kink at d = 0 is
    // rounded: of jammers d becomes sqrt(d^2 + soft), which only raises it and so lowers the rate.
    // A gain with a kink of its own is that of (d + edge)^2 + soft.
    void find_distance(const double* x, std::size_t n, int k, int u, double soft,
                       double& distance, double& squared) const {
        const double* at = receiver(n, k);
        const double dx = x[1] - at[0], dy = x[2] - at[1];
        const double edge = this->edge(n, k, u);
        squared = dx * dx + dy * dy;
        distance = 0.0;
        if (edge != 0.0) {
            distance = std::sqrt(squared + ((edge > 0.0 ? soft : 0.0) + LEAST_SQUARE));
            // Without the softening in its first term.
            squared = distance > -edge ? squared + edge * (2.0 * distance + edge) : 0.0;
        }
        if constexpr (Model::KINKED) squared += soft;
    }

    // A UAV's signal at a receiver. The gradient of the gain is slope * (dx, dy), and its Hessian
    // slope * I + curvature * (dx, dy) (dx, dy)^T.
    struct Signal {
        double dx, dy, power, gain, slope, curvature;
    };

    Signal find_signal(const Iterate& iterate, std::size_t n, int k, int u) const {
        const int U = uavs(), K = receivers();
        const std::size_t i = (n * K + k) * U + u;
        const double* x = iterate.x + (n * U + u) * 3;
        const double* at = receiver(n, k);
        const double edge = this->edge(n, k, u);
        const Gain gain = channel_.derivatives(k * U + u, iterate.evaluation.squared[i]);
        // The derivative of ([d + edge]^+)^2 by d^2, and minus twice its second derivative.
        double stretch = 1.0, curvature = 0.0;
        if (edge != 0.0) {
            const double distance = iterate.evaluation.distance[i];
            const bool outside = distance > -edge;
            stretch = outside ? 1.0 + edge / distance : 0.0;
            curvature = outside ? edge / (distance * distance * distance) : 0.0;
        }
        return {x[1] - at[0], x[2] - at[1], x[0], gain.value, 2.0 * gain.first * stretch,
                4.0 * gain.second * stretch * stretch - 2.0 * gain.first * curvature};
    }

    // Find a UAV's part in the gradients of both logarithms, and add its block to the Hessian.
    void add_signal(const Iterate& iterate, std::size_t n, int k, int u, double weight,
                    double* total_slope, double* interference_slope, double* block) const {
        const int V = size();
        const auto [dx, dy, power, gain, slope, curvature] = find_signal(iterate, n, k, u);
        const double total = iterate.evaluation.total[n * receivers() + k];
        const double interference = iterate.evaluation.interference[n * receivers() + k];
        const double along = slope * power;
        const double received[3] = {gain, along * dx, along * dy};
        for (int j = 0; j < 3; ++j) {
            total_slope[j] = received[j] / total;
            interference_slope[j] = u ? received[j] / interference : 0.0;
        }
        const double share = weight / total - (u ? weight / interference : 0.0);
        const double mixed = share * slope, outer = share * power * curvature;
        const double isotropic = mixed * power;
        block[V] += mixed * dx;
        block[2 * V] += mixed * dy;
        block[V + 1] += isotropic + outer * dx * dx;
        block[2 * V + 1] += outer * dx * dy;
        block[2 * V + 2] += isotropic + outer * dy * dy;
    }

    // Add the curvature from the worst place of a disc moving along with the UAVs. A rate depends
    // on offsets alone, so that a receiver's move is that of all UAVs the other way: its
    // derivatives by the place are the sum of the columns of their positions, with the sign
    // changed.
    void add_place_curvature(const Iterate& iterate, std::size_t n, int k, double weight,
                             const double* total_slope, const double* interference_slope,
                             double* hessian) {
        const int U = uavs(), V = size();
        const std::size_t i = n * receivers() + k;
        const Evaluation& here = iterate.evaluation;
        double* mixed = place_space_.data();  // (V, 2).
        double* rows = mixed + 2 * V;
        double slope[2] = {}, total[2] = {}, interference[2] = {};
        for (int u = 0; u < U; ++u)
            for (int axis = 0; axis < 2; ++axis) {
                total[axis] += total_slope[3 * u + 1 + axis];
                interference[axis] += interference_slope[3 * u + 1 + axis];
            }
        for (int u = 0; u < U; ++u) {
            const Signal signal = find_signal(iterate, n, k, u);
            const double share = 1.0 / here.total[i] - (u ? 1.0 / here.interference[i] : 0.0);
            const double by_power = share * signal.slope, isotropic = by_power * signal.power;
            const double outer = share * signal.power * signal.curvature;
            const double offset[2] = {signal.dx, signal.dy};
            for (int axis = 0; axis < 2; ++axis) {
                double* at = mixed + 6 * u + axis;
                at[0] = by_power * offset[axis];
                at[2] = outer * signal.dx * offset[axis];
                at[4] = outer * signal.dy * offset[axis];
                at[2 + 2 * axis] += isotropic;
            }
        }
        for (int j = 0; j < V; ++j)
            for (int axis = 0; axis < 2; ++axis) {
                double& entry = mixed[2 * j + axis];
                entry = total_slope[j] * total[axis]
                    - interference_slope[j] * interference[axis] - entry;
            }
        for (int axis = 0; axis < 2; ++axis) slope[axis] = interference[axis] - total[axis];
        find_place_rows(p_.places, n * eves_ + k - nodes_, V, mixed, slope, rows);
        for (const double* row : {rows, rows + V})
            for (int j = 0; j < V; ++j)
                for (int m = 0; m <= j; ++m) hessian[j * V + m] += weight * row[j] * row[m];
    }

    // Add the curvature of the largest of several leaks, t being eliminated.
    void add_epigraph_curvature(const Iterate& iterate, std::size_t n, double weight,
                                double* mean, double* hessian) const {
        const int V = size();
        double sum = 0.0;
        std::fill(mean, mean + V, 0.0);
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            const double ratio = find_dual_ratio(iterate, n, e);
            sum += ratio;
            for (int j = 0; j < V; ++j) mean[j] += ratio * leak_gradients_[i * V + j];
        }
        for (int j = 0; j < V; ++j) mean[j] /= sum;
        double* row = mean + V;
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            const double ratio = weight * find_dual_ratio(iterate, n, e);
            for (int j = 0; j < V; ++j) row[j] = leak_gradients_[i * V + j] - mean[j];
            for (int j = 0; j < V; ++j)
                for (int k = 0; k <= j; ++k) hessian[j * V + k] += ratio * row[j] * row[k];
        }
    }

    // Add the curvature of log(1 + sum of SINRs) on top of that of each leak, weighted by its
    // share (1 + SINR_e) / (1 + sum of SINRs).
    void add_colluding_curvature(std::size_t n, double weight, double* mean,
                                 double* hessian) const {
        const int V = size();
        std::fill(mean, mean + V, 0.0);
        for (int e = 0; e < eves_; ++e) {
            const double share = central_duals_[n * eves_ + e];
            const double* gradient = &leak_gradients_[(n * eves_ + e) * V];
            for (int j = 0; j < V; ++j) {
                mean[j] += share * gradient[j];
                for (int k = 0; k <= j; ++k)
                    hessian[j * V + k] += weight * share * gradient[j] * gradient[k];
            }
        }
        for (int j = 0; j < V; ++j)
            for (int k = 0; k <= j; ++k) hessian[j * V + k] -= weight * mean[j] * mean[k];
    }

    // Find the nodes' slacks, the means less eta, and return their part of the barrier function.
    double weigh_nodes(const double* shares, double mu, Evaluation& here) const {
        const int G = nodes_;
        Reals& slacks = here.node_slacks;
        slacks = sum_offsets();
        for (std::size_t n = 0; n < slots_; ++n)
            for (int k = 0; k < G; ++k)
                slacks[k] += shares[n * G + k] * here.node_rates[n * G + k];
        for (int k = 0; k < G; ++k) slacks[k] /= -double(slots_) * weight(k);
        const double largest = solve_epigraph(slacks.data(), G, mu);
        LogSum gaps;
        for (double& slack : slacks) gaps.add((slack = largest - slack) / mu);
        return double(slots_) * (largest - mu * gaps.total());
    }

    // Subtract the leak's gradient from the nodes' of a slot, find the gradient by the shares, of
    // which the first is 1 less the others, and extend the Hessian by them.
    void add_shares(const Iterate& iterate, std::size_t n, double mu, double* gradients,
                    double* hessians) {
        const int G = nodes_, V = size(), W = V + G - 1;
        const Evaluation& here = iterate.evaluation;
        double *own = &node_gradients_[n * G * V], *hessian = hessians + n * W * W;
        for (int k = 0; k < G; ++k)
            for (int j = 0; j < V; ++j) own[k * V + j] -= common_gradient_[j];
        std::fill(hessian, hessian + W * W, 0.0);
        for (int j = 0; j < V; ++j)
            std::copy(&block_[j * V], &block_[j * V] + j + 1, hessian + j * W);
        const double first = iterate.node_duals[0] / weight(0);
        const auto find_slope = [&](int k) {
            return mu / here.node_slacks[k] * here.node_rates[n * G + k] / weight(k);
        };
        for (int k = 1; k < G; ++k) {
            const double dual = iterate.node_duals[k] / weight(k);
            gradients[slots_ * V + n * (G - 1) + k - 1] = find_slope(0) - find_slope(k);
            for (int j = 0; j < V; ++j)
                hessian[(V + k - 1) * W + j] = first * own[j] - dual * own[k * V + j];
        }
    }

    // A leak's dual divided by its slack.
    double find_dual_ratio(const Iterate& iterate, std::size_t n, int e) const {
        const std::size_t i = n * eves_ + e;
        return iterate.leak_duals[i]
            / (iterate.evaluation.largest_leaks[n] - iterate.evaluation.leaks[i]);
    }

    // Find the Newton step of the leaks' duals in a slot.
    void find_dual_changes(const Iterate& iterate, std::size_t n, const double* step,
                           double& length) {
        const int V = size();
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            double slope = 0.0;
            for (int j = 0; j < V; ++j) slope += leak_gradients_[i * V + j] * step[n * V + j];
            leak_slopes_[e] = slope;
            ratios_[e] = find_dual_ratio(iterate, n, e);
        }
        find_epigraph_changes(eves_, &central_duals_[n * eves_], &iterate.leak_duals[n * eves_],
                              ratios_.data(), leak_slopes_.data(), &dual_changes_[n * eves_],
                              length);
    }

    // Find the Newton step of the nodes' duals.
    void find_node_changes(const Iterate& iterate, const double* step, double mu, int R,
                           const double* rows, double& length) {
        const int G = nodes_;
        Reals slopes(G, 0.0), central(G);
        for (std::size_t i = 0; i < slots_ * (size() + G - 1); ++i)
            for (int k = 0; k < G; ++k) slopes[k] -= rows[i * R + k] * step[i];
        for (int k = 0; k < G; ++k) {
            central[k] = mu / iterate.evaluation.node_slacks[k];
            ratios_[k] = iterate.node_duals[k] / iterate.evaluation.node_slacks[k];
        }
        find_epigraph_changes(G, central.data(), iterate.node_duals.data(), ratios_.data(),
                              slopes.data(), node_changes_.data(), length);
    }

    const Problem& p_;
    const Model& channel_;
    const std::size_t slots_;
    const int count_, nodes_, eves_;
    const bool several_;  // Whether there are several ground nodes.
    const bool largest_counts_, colluding_;  // Of several eavesdroppers, which leaks count.
    Reals space_, place_space_, leak_slopes_, ratios_, node_space_, node_changes_;
    Reals block_, common_gradient_;  // Of a slot: (3 U, 3 U), and of the leak, (3 U).
    Reals node_gradients_;           // Of the nodes' rates less the leak, (N, G, 3 U).
    Reals leak_gradients_, central_duals_, dual_changes_;  // (N, E, 3 U), (N, E), (N, E).
};

}  // namespace kernel
