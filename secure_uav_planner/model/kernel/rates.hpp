// The rates of all slots with their derivatives, and the largest leaks.
//
// A rate is log(1 + S + J) - log(1 + J): the logarithm of the total received power less that of
// interference and noise. By the chain rule, both need only the gain's two derivatives by the
// squared distance and that distance's by the position.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "start.hpp"

namespace kernel {

constexpr double TINY = 1e-30;  // Added to a squared distance, whose root then has a gradient.
constexpr double SOFTENING = 0.3;  // Rounding of the kink above an eavesdropper, in sqrt(mu).
constexpr double ON_EDGE = 1.0 - 1e-6;  // Distance of a place from the centre, in radii.
constexpr double FLATTEST = 0.01;  // Least curvature of a place, as a share of the largest.
constexpr double TINIEST = 1e-300;
constexpr double INFINITE = std::numeric_limits<double>::infinity();

// log(1 + received / interference), as accurate for a small ratio.
inline double rate_of(double received, double interference) {
    const double ratio = received / interference;
    return ratio < 1e-2 ? std::log1p(ratio) : std::log(1.0 + ratio);
}

// Find two rows (2, V) whose outer products, added up, are what the Hessian of a leak gains as its
// place follows the UAVs. `mixed`, (V, 2), is the leak's derivative by variables and place,
// `slope` that by the place.
//
// For f(x) = max_w g(x, w) it is -g_xw g_ww^-1 g_wx at the worst place w, which is on top of g_xx;
// for a place on the edge of its disc, that along the edge, whose curvature counts too. Without
// it, places and UAVs that follow each other in turn may swing ever further.
inline void follow(const Places& places, std::size_t index, int variables, const double* mixed,
                   const double* slope, double* rows) {
    double bend[2][2] = {};
    for (int j = 0; j < variables; ++j)
        if (j % 3)
            for (int axis = 0; axis < 2; ++axis) bend[j % 3 - 1][axis] += mixed[2 * j + axis];
    double most = 0.0;
    for (const auto& row : bend)
        for (const double entry : row) most = std::max(most, std::fabs(entry));
    const double least = FLATTEST * most + TINIEST;
    const double* offset = &places.offsets[2 * index];
    const double radius = places.radii[index % places.radii.size()];
    const double distance = std::sqrt(offset[0] * offset[0] + offset[1] * offset[1]);
    const auto add_row = [&](int number, double x, double y, double curvature) {
        const double by = 1.0 / std::sqrt(std::max(curvature, least));
        for (int j = 0; j < variables; ++j)
            rows[number * variables + j] = (mixed[2 * j] * x + mixed[2 * j + 1] * y) * by;
    };
    if (distance >= ON_EDGE * radius) {
        // Along the edge alone, whose own curvature counts too.
        const double over = 1.0 / std::max(distance, TINIEST);
        const double x = -offset[1] * over, y = offset[0] * over;
        const double along = (bend[0][0] * x + bend[0][1] * y) * x
            + (bend[1][0] * x + bend[1][1] * y) * y;
        add_row(0, x, y, along + (slope[0] * y - slope[1] * x) / std::max(radius, TINIEST));
        std::fill(rows + variables, rows + 2 * variables, 0.0);
        return;
    }
    // Along the eigenvectors.
    const double mean = 0.5 * (bend[0][0] + bend[1][1]), half = 0.5 * (bend[0][0] - bend[1][1]);
    const double spread = std::hypot(half, bend[1][0]);
    const double angle = 0.5 * std::atan2(bend[1][0], half);
    add_row(0, std::cos(angle), std::sin(angle), mean + spread);
    add_row(1, -std::sin(angle), std::cos(angle), mean - spread);
}

// For a number of UAVs that is known when compiling, or for any (UAVS = 0), and for a channel model
// that is, or for any (Channel).
template <int UAVS, class Model>
class Rates {
public:
    explicit Rates(const Problem& problem)
        : p_(problem), channel_(static_cast<const Model&>(*problem.channel)),
          slots_(problem.slots), count_(problem.uavs),
          eves_(problem.receivers.count - 1), several_(eves_ > 1 && !problem.colluding),
          colluding_(eves_ > 1 && problem.colluding) {
        const std::size_t v = 3 * count_;
        space_.resize(4 * v);
        followed_.resize(4 * v);
        if (eves_ == 1) return;
        rises_.resize(eves_);
        leak_gradients_.resize(slots_ * eves_ * v);
        leak_central_.resize(slots_ * eves_);
        leak_moves_.resize(slots_ * eves_);
    }

    // The mean rate, losing slots silenced, in nats.
    double rate(const double* all) const {
        const int U = uavs(), K = receivers();
        double sum = 0.0;
        for (std::size_t n = 0; n < slots_; ++n) {
            double ground = 0.0, leak = -INFINITE, together = 0.0;
            for (int k = 0; k < K; ++k) {
                double received = 0.0, interference = 1.0;
                for (int u = 0; u < U; ++u) {
                    const double* x = all + (n * U + u) * 3;
                    double distance, squared;
                    place(x, n, k, u, 0.0, distance, squared);
                    const double got = channel_.gain(k * U + u, squared) * x[0];
                    (u ? interference : received) += got;
                }
                if (k && colluding_) {
                    together += received / interference;
                    continue;
                }
                const double rate = rate_of(received, interference);
                if (k == 0) ground = rate;
                else leak = std::max(leak, rate);
            }
            if (colluding_) leak = std::log1p(together);
            sum += std::max(ground - leak, 0.0);
        }
        return sum / double(slots_);
    }

    // Find the rates at an x, and return their part of the barrier function.
    double evaluate(const double* x, double mu, Evaluation& found) const {
        const int U = uavs(), K = receivers();
        const double softening = SOFTENING * std::sqrt(mu);
        const double soft = softening * softening;
        found.squared.resize(slots_ * K * U);
        found.distance.resize(slots_ * K * U);
        found.total.resize(slots_ * K);
        found.interference.resize(slots_ * K);
        found.leaks.resize(slots_ * eves_);
        found.largest.resize(slots_);
        LogSum leak_less_ground, gaps;  // Of all slots.
        double value = 0.0;
        for (std::size_t n = 0; n < slots_; ++n) {
            double together = 0.0;
            for (int k = 0; k < K; ++k) {
                double received = 0.0, interference = 1.0;
                for (int u = 0; u < U; ++u) {
                    const double* at = x + (n * U + u) * 3;
                    const std::size_t i = (n * K + k) * U + u;
                    place(at, n, k, u, soft, found.distance[i], found.squared[i]);
                    (u ? interference : received) +=
                        channel_.gain(k * U + u, found.squared[i]) * at[0];
                }
                found.interference[n * K + k] = interference;
                found.total[n * K + k] = interference + received;
                if (k && colluding_) {
                    together += received / interference;
                } else if (k && several_) {
                    found.leaks[n * eves_ + k - 1] = rate_of(received, interference);
                } else if (received < 1e-2 * interference) {  // More accurate if it is small.
                    const double rate = std::log1p(received / interference);
                    value += k ? rate : -rate;
                } else {
                    leak_less_ground.add(k ? 1.0 + received / interference
                                           : interference / (interference + received));
                }
            }
            if (colluding_) {
                value += found.largest[n] = std::log1p(together);
            } else if (several_) {
                const double* leaks = &found.leaks[n * eves_];
                const double largest = epigraph(leaks, mu);
                found.largest[n] = largest;
                value += largest;
                for (int e = 0; e < eves_; ++e) gaps.add((largest - leaks[e]) / mu);
            }
        }
        value += leak_less_ground.total() + (several_ ? 0.0 : mu * double(slots_));
        return value - mu * gaps.total();
    }

    // Gradient and Hessian of the objective, and what the leaks' duals need.
    void model(State& state, const Evaluation& here, double mu, double* gradients,
               double* hessians) {
        const int U = uavs(), K = receivers(), V = size();
        if (several_ && state.shares.empty()) {
            state.shares.resize(slots_ * eves_);
            for (std::size_t n = 0; n < slots_; ++n)
                for (int e = 0; e < eves_; ++e)
                    state.shares[n * eves_ + e] =
                        mu / (here.largest[n] - here.leaks[n * eves_ + e]);
        }
        double* of_total = space_.data();
        double* of_interference = of_total + V;
        double* mean = of_interference + V;  // And a row behind it.
        for (std::size_t n = 0; n < slots_; ++n) {
            double* gradient = gradients + n * V;
            double* hessian = hessians + n * V * V;
            std::fill(gradient, gradient + V, 0.0);
            std::fill(hessian, hessian + V * V, 0.0);
            for (int k = 0; k < K; ++k) {
                const double total = here.total[n * K + k];
                const double interference = here.interference[n * K + k];
                double weight = k ? 1.0 : -1.0, pull = weight;
                if (k && colluding_) {
                    weight = pull = leak_central_[n * eves_ + k - 1] =
                        total / interference * std::exp(-here.largest[n]);
                } else if (k && several_) {
                    const std::size_t i = n * eves_ + k - 1;
                    weight = state.shares[i];
                    pull = leak_central_[i] = mu / (here.largest[n] - here.leaks[i]);
                }
                for (int u = 0; u < U; ++u)
                    receive(x_of(state, n, u), here, n, k, u, weight, total, interference,
                            of_total + 3 * u, of_interference + 3 * u, hessian + 3 * u * (V + 1));
                for (int i = 0; i < V; ++i) {
                    gradient[i] += pull * (of_total[i] - of_interference[i]);
                    const double less = weight * of_total[i], more = weight * of_interference[i];
                    for (int j = 0; j <= i; ++j)
                        hessian[i * V + j] += more * of_interference[j] - less * of_total[j];
                }
                if (!k || eves_ == 1) continue;
                const std::size_t i = n * eves_ + k - 1;
                for (int j = 0; j < V; ++j)
                    leak_gradients_[i * V + j] = of_total[j] - of_interference[j];
                if (!p_.places.followed.empty() && p_.places.followed[i])
                    add_following(state, here, n, k, weight, of_total, of_interference, hessian);
            }
            if (several_) spread_leaks(state, here, n, mean, hessian);
            if (colluding_) join_leaks(n, mean, hessian);
        }
    }

    // Move the leaks' duals, whose sum is 1 in every slot, along with a step of x; lower how far
    // duals may go.
    void move(State& state, const Evaluation& here, const double* step, double& by) {
        if (!several_) return;
        for (std::size_t n = 0; n < slots_; ++n) find_moves(state, here, n, step, by);
        for (std::size_t n = 0; n < slots_; ++n) {
            double sum = 0.0;
            for (int e = 0; e < eves_; ++e)
                sum += state.shares[n * eves_ + e] += by * leak_moves_[n * eves_ + e];
            for (int e = 0; e < eves_; ++e) state.shares[n * eves_ + e] /= sum;
        }
    }

private:
    int uavs() const { return UAVS ? UAVS : count_; }
    int size() const { return 3 * uavs(); }
    int receivers() const { return eves_ + 1; }

    const double* receiver(std::size_t n, int k) const {
        return &p_.receivers.positions[n * p_.receivers.stride + 2 * k];
    }

    // The distance d from a UAV to a receiver, and ([d + edge]^+)^2. The kink at d = 0 is rounded:
    // of jammers d becomes sqrt(d^2 + soft), which only raises it and so lowers the rate. A gain
    // with a kink of its own is that of (d + edge)^2 + soft.
    void place(const double* x, std::size_t n, int k, int u, double soft, double& distance,
               double& squared) const {
        const double* at = receiver(n, k);
        const double dx = x[1] - at[0], dy = x[2] - at[1];
        const double edge = p_.receivers.edge[k * uavs() + u];
        squared = dx * dx + dy * dy;
        distance = 0.0;
        if (edge != 0.0) {
            distance = std::sqrt(squared + ((edge > 0.0 ? soft : 0.0) + TINY));
            // Without the softening in its first term.
            squared = distance > -edge ? squared + edge * (2.0 * distance + edge) : 0.0;
        }
        if constexpr (Model::KINKED) squared += soft;
    }

    // The t that minimises t - mu sum_e log(t - leak_e), by Newton's method on sum mu / (t -
    // leak_e) = 1 from the left of its root, so without overshooting.
    double epigraph(const double* leaks, double mu) const {
        const double largest = *std::max_element(leaks, leaks + eves_);
        double t = 1.0;
        for (int round = 0; round < 8; ++round) {
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

    const double* x_of(const State& state, std::size_t n, int u) const {
        return state.x + (n * uavs() + u) * 3;
    }

    // What a receiver gets from a UAV, with derivatives. The gradient of the
    // gain is slope * (dx, dy), and its Hessian slope * I + curvature * (dx, dy) (dx, dy)^T.
    struct Signal {
        double dx, dy, power, gain, slope, curvature;
    };

    Signal signal(const double* x, const Evaluation& here, std::size_t n, int k, int u) const {
        const int U = uavs(), K = receivers();
        const std::size_t i = (n * K + k) * U + u;
        const double* at = receiver(n, k);
        const double edge = p_.receivers.edge[k * U + u];
        const Gain gain = channel_.derivatives(k * U + u, here.squared[i]);
        double stretch = 1.0, bend = 0.0;
        if (edge != 0.0) {
            const double distance = here.distance[i];
            const bool outside = distance > -edge;
            stretch = outside ? 1.0 + edge / distance : 0.0;
            bend = outside ? edge / (distance * distance * distance) : 0.0;
        }
        return {x[1] - at[0], x[2] - at[1], x[0], gain.value, 2.0 * gain.first * stretch,
                4.0 * gain.second * stretch * stretch - 2.0 * gain.first * bend};
    }

    // The part of a UAV in the derivatives of a rate.
    void receive(const double* x, const Evaluation& here, std::size_t n, int k, int u,
                 double weight, double total, double interference, double* of_total,
                 double* of_interference, double* block) const {
        const int V = size();
        const auto [dx, dy, power, gain, slope, curvature] = signal(x, here, n, k, u);
        const double along = slope * power;
        const double received[3] = {gain, along * dx, along * dy};
        for (int j = 0; j < 3; ++j) {
            of_total[j] = received[j] / total;
            of_interference[j] = u ? received[j] / interference : 0.0;
        }
        const double share = weight / total - (u ? weight / interference : 0.0);
        const double mixed = share * slope, bent = share * power * curvature;
        const double isotropic = mixed * power;
        block[V] += mixed * dx;
        block[2 * V] += mixed * dy;
        block[V + 1] += isotropic + bent * dx * dx;
        block[2 * V + 1] += bent * dx * dy;
        block[2 * V + 2] += isotropic + bent * dy * dy;
    }

    // What the Hessian gains as the worst place of a disc follows the UAVs. A rate depends on
    // offsets alone, so that a receiver's move is that of all UAVs the other way: its derivatives
    // by the place are the sum of the columns of their positions, with the sign changed.
    void add_following(const State& state, const Evaluation& here, std::size_t n, int k,
                       double weight, const double* of_total, const double* of_interference,
                       double* hessian) {
        const int U = uavs(), V = size();
        const std::size_t i = n * receivers() + k;
        double* mixed = followed_.data();  // (V, 2).
        double* rows = mixed + 2 * V;
        double slope[2] = {}, total[2] = {}, interference[2] = {};
        for (int u = 0; u < U; ++u)
            for (int axis = 0; axis < 2; ++axis) {
                total[axis] += of_total[3 * u + 1 + axis];
                interference[axis] += of_interference[3 * u + 1 + axis];
            }
        for (int u = 0; u < U; ++u) {
            const Signal of = signal(x_of(state, n, u), here, n, k, u);
            const double share = 1.0 / here.total[i] - (u ? 1.0 / here.interference[i] : 0.0);
            const double by_power = share * of.slope, isotropic = by_power * of.power;
            const double bent = share * of.power * of.curvature;
            const double offset[2] = {of.dx, of.dy};
            for (int axis = 0; axis < 2; ++axis) {
                double* at = mixed + 6 * u + axis;
                at[0] = by_power * offset[axis];
                at[2] = bent * of.dx * offset[axis];
                at[4] = bent * of.dy * offset[axis];
                at[2 + 2 * axis] += isotropic;
            }
        }
        for (int j = 0; j < V; ++j)
            for (int axis = 0; axis < 2; ++axis) {
                double& entry = mixed[2 * j + axis];
                entry = of_total[j] * total[axis] - of_interference[j] * interference[axis]
                    - entry;
            }
        for (int axis = 0; axis < 2; ++axis) slope[axis] = interference[axis] - total[axis];
        follow(p_.places, i - n - 1, V, mixed, slope, rows);
        for (const double* row : {rows, rows + V})
            for (int j = 0; j < V; ++j)
                for (int m = 0; m <= j; ++m) hessian[j * V + m] += weight * row[j] * row[m];
    }

    // The curvature of the largest of several leaks, t being eliminated.
    void spread_leaks(const State& state, const Evaluation& here, std::size_t n, double* mean,
                      double* hessian) {
        const int V = size();
        double sum = 0.0;
        std::fill(mean, mean + V, 0.0);
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            const double ratio = state.shares[i] / (here.largest[n] - here.leaks[i]);
            sum += ratio;
            for (int j = 0; j < V; ++j) mean[j] += ratio * leak_gradients_[i * V + j];
        }
        for (int j = 0; j < V; ++j) mean[j] /= sum;
        double* row = mean + V;
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            const double ratio = state.shares[i] / (here.largest[n] - here.leaks[i]);
            for (int j = 0; j < V; ++j) row[j] = leak_gradients_[i * V + j] - mean[j];
            for (int j = 0; j < V; ++j)
                for (int k = 0; k <= j; ++k) hessian[j * V + k] += ratio * row[j] * row[k];
        }
    }

    // The curvature of log(1 + sum of SINRs) on top of that of each leak, whose shares are its own
    // exponential in the whole.
    void join_leaks(std::size_t n, double* mean, double* hessian) const {
        const int V = size();
        std::fill(mean, mean + V, 0.0);
        for (int e = 0; e < eves_; ++e) {
            const double share = leak_central_[n * eves_ + e];
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

    // Find the Newton step of the leaks' duals in a slot.
    void find_moves(const State& state, const Evaluation& here, std::size_t n,
                    const double* step, double& by) {
        const int V = size();
        double central = 0.0, ratios = 0.0, risen = 0.0;
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            double rise = 0.0;
            for (int j = 0; j < V; ++j) rise += leak_gradients_[i * V + j] * step[n * V + j];
            const double ratio = state.shares[i] / (here.largest[n] - here.leaks[i]);
            rises_[e] = rise;
            central += leak_central_[i];
            ratios += ratio;
            risen += ratio * rise;
        }
        const double largest = (central - 1.0 + risen) / ratios;
        for (int e = 0; e < eves_; ++e) {
            const std::size_t i = n * eves_ + e;
            const double ratio = state.shares[i] / (here.largest[n] - here.leaks[i]);
            const double move =
                leak_central_[i] - state.shares[i] - ratio * (largest - rises_[e]);
            leak_moves_[i] = move;
            stop_at_zero(by, state.shares[i], move, BOUNDARY);
        }
    }

    const Problem& p_;
    const Model& channel_;
    const std::size_t slots_;
    const int count_, eves_;
    const bool several_, colluding_;  // Eavesdroppers, the largest leak or all of which count.
    Reals space_, followed_, rises_;
    Reals leak_gradients_, leak_central_, leak_moves_;  // (N, E, 3 U), (N, E), (N, E).
};

}  // namespace kernel
