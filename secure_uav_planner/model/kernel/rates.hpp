// The rates of all slots with their derivatives, and the duals of the leaks.
//
// A rate is log(1 + S + J) - log(1 + J): the logarithm of the total received power less that of
// interference and noise. By the chain rule, both need only the gain's two derivatives by the
// squared distance and that distance's by the position.
#pragma once

#include <algorithm>
#include <cmath>

#include "newton.hpp"
#include "numbers.hpp"

namespace kernel {

constexpr double LEAST_SQUARE = 1e-30;  // Added to d^2, whose root then has a gradient.
constexpr double SOFTENING = 0.3;  // Rounding of the kink above an eavesdropper, in sqrt(mu).
constexpr double ON_EDGE = 1.0 - 1e-6;  // Distance of a place from the centre, in radii.
constexpr double FLATTEST = 0.01;  // Least curvature of a place, as a share of the largest.

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

// For a number of UAVs and a channel model that are known when compiling, or for any (UAVS = 0,
// Channel).
template <int UAVS, class Model>
class Rates {
public:
    explicit Rates(const Problem& problem)
        : p_(problem), channel_(static_cast<const Model&>(*problem.channel)),
          slots_(problem.slots), count_(problem.uavs),
          eves_(problem.receivers.count - 1), largest_counts_(eves_ > 1 && !problem.colluding),
          colluding_(eves_ > 1 && problem.colluding) {
        const std::size_t v = 3 * count_;
        space_.resize(4 * v);
        place_space_.resize(4 * v);
        if (eves_ == 1) return;
        leak_slopes_.resize(eves_);
        leak_gradients_.resize(slots_ * eves_ * v);
        central_duals_.resize(slots_ * eves_);
        dual_changes_.resize(slots_ * eves_);
    }

    // The mean rate, losing slots silenced, in nats.
    double find_mean(const double* all) const {
        const int U = uavs(), K = receivers();
        double sum = 0.0;
        for (std::size_t n = 0; n < slots_; ++n) {
            double ground = 0.0, leak = -INFINITE, sinrs = 0.0;
            for (int k = 0; k < K; ++k) {
                double received = 0.0, interference = 1.0;
                for (int u = 0; u < U; ++u) {
                    const double* x = all + (n * U + u) * 3;
                    double distance, squared;
                    find_distance(x, n, k, u, 0.0, distance, squared);
                    (u ? interference : received) += channel_.gain(k * U + u, squared) * x[0];
                }
                if (k && colluding_) {
                    sinrs += received / interference;
                    continue;
                }
                const double rate = find_rate(received, interference);
                if (k == 0) ground = rate;
                else leak = std::max(leak, rate);
            }
            if (colluding_) leak = std::log1p(sinrs);
            sum += std::max(ground - leak, 0.0);
        }
        return sum / double(slots_);
    }

    // Find the rates at an x, and return their part of the barrier function.
    double evaluate(const double* x, double mu, Evaluation& here) const {
        const int U = uavs(), K = receivers();
        const double softening = SOFTENING * std::sqrt(mu / p_.rate_unit);
        const double soft = softening * softening;
        here.squared.resize(slots_ * K * U);
        here.distance.resize(slots_ * K * U);
        here.total.resize(slots_ * K);
        here.interference.resize(slots_ * K);
        here.leaks.resize(slots_ * eves_);
        here.largest_leaks.resize(slots_);
        LogSum leak_less_ground, gaps;  // Of all slots.
        double value = 0.0;
        for (std::size_t n = 0; n < slots_; ++n) {
            double sinrs = 0.0;
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
                if (k && colluding_) {
                    sinrs += received / interference;
                } else if (k && largest_counts_) {
                    here.leaks[n * eves_ + k - 1] = find_rate(received, interference);
                } else if (received < 1e-2 * interference) {  // More accurate for small ratios.
                    const double rate = std::log1p(received / interference);
                    value += k ? rate : -rate;
                } else {
                    leak_less_ground.add(k ? 1.0 + received / interference
                                           : interference / (interference + received));
                }
            }
            if (colluding_) {
                value += here.largest_leaks[n] = std::log1p(sinrs);
            } else if (largest_counts_) {
                const double* leaks = &here.leaks[n * eves_];
                const double largest = solve_epigraph(leaks, mu);
                here.largest_leaks[n] = largest;
                value += largest;
                for (int e = 0; e < eves_; ++e) gaps.add((largest - leaks[e]) / mu);
            }
        }
        value += leak_less_ground.total() + (largest_counts_ ? 0.0 : mu * double(slots_));
        return value - mu * gaps.total();
    }

    // Find gradient and Hessian of the objective, and what update_duals needs.
    void differentiate(Iterate& iterate, double mu, double* gradients, double* hessians) {
        const Evaluation& here = iterate.evaluation;
        const int U = uavs(), K = receivers(), V = size();
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
            double* hessian = hessians + n * V * V;
            std::fill(gradient, gradient + V, 0.0);
            std::fill(hessian, hessian + V * V, 0.0);
            for (int k = 0; k < K; ++k) {
                double weight = k ? 1.0 : -1.0, central = weight;
                const std::size_t i = n * eves_ + k - 1;
                if (k && colluding_) {
                    weight = central = central_duals_[i] = here.total[n * K + k]
                        / here.interference[n * K + k] * std::exp(-here.largest_leaks[n]);
                } else if (k && largest_counts_) {
                    weight = iterate.leak_duals[i];
                    central = central_duals_[i] = mu / (here.largest_leaks[n] - here.leaks[i]);
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
                if (!k || eves_ == 1) continue;
                for (int j = 0; j < V; ++j)
                    leak_gradients_[i * V + j] = total_slope[j] - interference_slope[j];
                if (!p_.places.followed.empty() && p_.places.followed[i])
                    add_place_curvature(
                        iterate, n, k, weight, total_slope, interference_slope, hessian);
            }
            if (largest_counts_) add_epigraph_curvature(iterate, n, mean, hessian);
            if (colluding_) add_colluding_curvature(n, mean, hessian);
        }
    }

    // Move the leaks' duals, whose sum is 1 in each slot, along with a step of x, as far as all
    // duals stay positive; `length` is that of the duals of the limits.
    void update_duals(Iterate& iterate, const double* step, double& length) {
        if (!largest_counts_) return;
        for (std::size_t n = 0; n < slots_; ++n) find_dual_changes(iterate, n, step, length);
        for (std::size_t n = 0; n < slots_; ++n) {
            double* duals = &iterate.leak_duals[n * eves_];
            double sum = 0.0;
            for (int e = 0; e < eves_; ++e)
                sum += duals[e] += length * dual_changes_[n * eves_ + e];
            for (int e = 0; e < eves_; ++e) duals[e] /= sum;
        }
    }

private:
    int uavs() const { return UAVS ? UAVS : count_; }
    int size() const { return 3 * uavs(); }
    int receivers() const { return eves_ + 1; }

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

    // The t that minimises t - mu sum_e log(t - leak_e), by Newton's method on sum mu / (t -
    // leak_e) = 1 from the left of its root, so without overshooting.
    double solve_epigraph(const double* leaks, double mu) const {
        const double largest = *std::max_element(leaks, leaks + eves_);
        double t = 1.0;
        for (int step = 0; step < 8; ++step) {
            double sum = 0.0, squares = 0.0;
            for (int e = 0; e < eves_; ++e) {
                const double inverse = 1.0 / (t + (largest - leaks[e]) / mu);
                sum += inverse;
                squares += inverse * inverse;
            }
            t += (sum - 1.0) / squares;
        }
        return largest + mu * t;
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
        find_place_rows(p_.places, i - n - 1, V, mixed, slope, rows);
        for (const double* row : {rows, rows + V})
            for (int j = 0; j < V; ++j)
                for (int m = 0; m <= j; ++m) hessian[j * V + m] += weight * row[j] * row[m];
    }

    // Add the curvature of the largest of several leaks, t being eliminated.
    void add_epigraph_curvature(const Iterate& iterate, std::size_t n, double* mean,
                                double* hessian) const {
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
            const double ratio = find_dual_ratio(iterate, n, e);
            for (int j = 0; j < V; ++j) row[j] = leak_gradients_[i * V + j] - mean[j];
            for (int j = 0; j < V; ++j)
                for (int k = 0; k <= j; ++k) hessian[j * V + k] += ratio * row[j] * row[k];
        }
    }

    // Add the curvature of log(1 + sum of SINRs) on top of that of each leak, weighted by its
    // share (1 + SINR_e) / (1 + sum of SINRs).
    void add_colluding_curvature(std::size_t n, double* mean, double* hessian) const {
        const int V = size();
        std::fill(mean, mean + V, 0.0);
        for (int e = 0; e < eves_; ++e) {
            const double share = central_duals_[n * eves_ + e];
            const double* gradient = &leak_gradients_[(n * eves_ + e) * V];
            for (int j = 0; j < V; ++j) {
                mean[j] += share * gradient[j];
                for (int k = 0; k <= j; ++k)
                    hessian[j * V + k] += share * gradient[j] * gradient[k];
            }
        }
        for (int j = 0; j < V; ++j)
            for (int k = 0; k <= j; ++k) hessian[j * V + k] -= mean[j] * mean[k];
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
        double central = 0.0, ratios = 0.0, weighted = 0.0;
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            double slope = 0.0;
            for (int j = 0; j < V; ++j) slope += leak_gradients_[i * V + j] * step[n * V + j];
            const double ratio = find_dual_ratio(iterate, n, e);
            leak_slopes_[e] = slope;
            central += central_duals_[i];
            ratios += ratio;
            weighted += ratio * slope;
        }
        const double largest = (central - 1.0 + weighted) / ratios;
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            const double ratio = find_dual_ratio(iterate, n, e);
            const double change =
                central_duals_[i] - iterate.leak_duals[i] - ratio * (largest - leak_slopes_[e]);
            dual_changes_[i] = change;
            limit_step(length, iterate.leak_duals[i], change, FRACTION_TO_BOUNDARY);
        }
    }

    const Problem& p_;
    const Model& channel_;
    const std::size_t slots_;
    const int count_, eves_;
    const bool largest_counts_, colluding_;  // Of several eavesdroppers, which leaks count.
    Reals space_, place_space_, leak_slopes_;
    Reals leak_gradients_, central_duals_, dual_changes_;  // (N, E, 3 U), (N, E), (N, E).
};

}  // namespace kernel
