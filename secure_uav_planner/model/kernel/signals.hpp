// Powers received from the UAVs in a slot, and the derivatives of a receiver's rate.
//
// A rate is log(1 + S + J) - log(1 + J): the logarithm of the total received power minus the
// logarithm of interference and noise. By the chain rule, both logarithms need only the gain's two
// derivatives by the squared distance and the derivatives of the squared distance by the position.
#pragma once

#include <algorithm>
#include <cmath>

#include "newton.hpp"
#include "numbers.hpp"

namespace kernel {

constexpr double LEAST_SQUARE = 1e-30;  // Added to d^2, so that its root has a gradient.
constexpr double ON_EDGE = 1.0 - 1e-6;  // Least distance from the centre, in radii, on the edge.
constexpr double FLATTEST = 0.01;  // Least curvature of a place, over its largest derivative.

// UAVS is the number of UAVs if it is known when compiling, or 0 for any number. Model is the
// channel model, or LinkGains for any model.
template <int UAVS, class Model>
class Signals {
public:
    explicit Signals(const BarrierProblem& problem)
        : p_(problem), gains_(static_cast<const Model&>(*problem.gains)),
          receivers_(problem.receivers.count), signals_(problem.uavs),
          space_(2 * 3 * problem.uavs), place_space_(4 * 3 * problem.uavs) {}

    // Fill the K receptions in slot n of `here`, and their distances; return the first reception.
    // `x` (N, U, 3) has power and place of each UAV; UAV 0 transmits. Interference includes the
    // noise, which is 1. `soft` rounds kinks at distance 0; see find_guaranteed_distance.
    const Reception* receive(const double* x, std::size_t n, double soft,
                             Evaluation& here) const {
        for (int k = 0; k < receivers_; ++k) {
            Reception& reception = here.receptions[n * receivers_ + k];
            reception.interference = 1.0;
            for (int u = 0; u < uavs(); ++u) {
                const double* uav = x + (n * uavs() + u) * 3;
                const std::size_t i = (n * receivers_ + k) * uavs() + u;
                find_guaranteed_distance(
                    uav, n, k, u, soft, here.distance[i], here.squared[i]);
                const double power = gains_.gain(k * uavs() + u, here.squared[i]) * uav[0];
                if (u)
                    reception.interference += power;
                else
                    reception.signal = power;
            }
        }
        return &here.receptions[n * receivers_];
    }

    // Find the gradient (V) of receiver k's rate by the variables of slot n, which are power, x and
    // y of each UAV. Add `weight` times the rate's Hessian (V, V), lower triangle, to `hessian`.
    // With total T = 1 + S + J and interference I = 1 + J, the rate is log T - log I, its gradient
    // T'/T - I'/I, and its Hessian T''/T - I''/I - (T'/T) (T'/T)^T + (I'/I) (I'/I)^T.
    //
    // Receiver k may be the worst place in an eavesdropper's disc, which moves when UAVs move. The
    // Hessian includes this move if `moves_along` is set.
    void differentiate(const Iterate& iterate, std::size_t n, int k, double weight,
                       double* __restrict gradient, double* __restrict hessian) {
        const int V = 3 * uavs();
        const Reception& at = iterate.evaluation.receptions[n * receivers_ + k];
        const double total = at.total();
        double* of_total = space_.data();  // T'/T, and behind it I'/I.
        double* of_interference = of_total + V;
        for (int u = 0; u < uavs(); ++u) {
            const Signal signal = signals_[u] = find_signal(iterate, n, k, u);
            const double along = signal.slope * signal.power;
            const double received[3] = {signal.gain, along * signal.dx, along * signal.dy};
            for (int j = 0; j < 3; ++j) {
                of_total[3 * u + j] = received[j] / total;
                of_interference[3 * u + j] = u ? received[j] / at.interference : 0.0;
            }
            const double factor = weight / total - (u ? weight / at.interference : 0.0);
            const double mixed = factor * signal.slope, isotropic = mixed * signal.power;
            const double outer = factor * signal.power * signal.curvature;
            // The UAV's diagonal block, rows and columns power, x and y: row i begins at i V.
            double* block = hessian + 3 * u * (V + 1);
            block[V] += mixed * signal.dx;
            block[2 * V] += mixed * signal.dy;
            block[V + 1] += isotropic + outer * signal.dx * signal.dx;
            block[2 * V + 1] += outer * signal.dx * signal.dy;
            block[2 * V + 2] += isotropic + outer * signal.dy * signal.dy;
        }
        for (int j = 0; j < V; ++j) {
            gradient[j] = of_total[j] - of_interference[j];
            const double less = weight * of_total[j], more = weight * of_interference[j];
            for (int m = 0; m <= j; ++m)
                hessian[j * V + m] += more * of_interference[m] - less * of_total[m];
        }
        const int eve = k - p_.nodes();
        if (p_.places.moves_along.empty() || eve < 0 || eve >= p_.eavesdroppers()) return;
        const std::size_t place = n * p_.eavesdroppers() + eve;
        if (p_.places.moves_along[place]) add_place_curvature(at, place, weight, hessian);
    }

private:
    // A UAV's signal at a receiver. The gradient of the gain is slope * (dx, dy), and its Hessian
    // slope * I + curvature * (dx, dy) (dx, dy)^T.
    struct Signal {
        double dx, dy, power, gain, slope, curvature;
    };

    int uavs() const { return UAVS ? UAVS : p_.uavs; }

    const double* position(std::size_t n, int k) const {
        return &p_.receivers.positions[2 * (n * receivers_ + k)];
    }

    // What the guarantee adds to the distance of UAV u from receiver k: minus the radius of the
    // receiver's disc for the transmitter (u = 0), and the radius for a jammer.
    double edge(std::size_t n, int k, int u) const {
        const double radius = p_.receivers.radii[n * receivers_ + k];
        return u ? radius : -radius;
    }

    // Set `squared` to the guarantee's squared distance ([d + edge]^+)^2, with the horizontal
    // distance d of UAV u, at (x[1], x[2]), from receiver k in slot n. `edge` is -radius of the
    // receiver's disc for the transmitter (nearest place), and +radius for a jammer (farthest).
    // Set `distance` to d, or to 0 if `edge` is 0. `soft`, a squared length, rounds two kinks at
    // d = 0. For a jammer `distance` is sqrt(d^2 + soft), and `squared` is d^2 + 2 edge distance +
    // edge^2. If the gain has a kink itself (KINKED), `soft` is then added to `squared`.
    void find_guaranteed_distance(const double* x, std::size_t n, int k, int u, double soft,
                                  double& distance, double& squared) const {
        const double* place = position(n, k);
        const double dx = x[1] - place[0], dy = x[2] - place[1];
        const double edge = this->edge(n, k, u);
        squared = dx * dx + dy * dy;
        distance = 0.0;
        if (edge != 0.0) {
            distance = std::sqrt(squared + ((edge > 0.0 ? soft : 0.0) + LEAST_SQUARE));
            squared = distance > -edge ? squared + edge * (2.0 * distance + edge) : 0.0;
        }
        if constexpr (Model::KINKED) squared += soft;
    }

    // Return UAV u's signal at receiver k in slot n: offset (dx, dy) from the receiver, power and
    // gain. By the UAV's position the gain has the gradient slope (dx, dy), and the Hessian
    // slope I + curvature (dx, dy) (dx, dy)^T. It is a function of s = ([d + edge]^+)^2, s of d^2.
    Signal find_signal(const Iterate& iterate, std::size_t n, int k, int u) const {
        const std::size_t i = (n * receivers_ + k) * uavs() + u;
        const double* x = iterate.x + (n * uavs() + u) * 3;
        const double* place = position(n, k);
        const double edge = this->edge(n, k, u);
        const Gain gain = gains_.derivatives(k * uavs() + u, iterate.evaluation.squared[i]);
        // The derivative of ([d + edge]^+)^2 by d^2, and minus twice its second derivative.
        double stretch = 1.0, curvature = 0.0;
        if (edge != 0.0) {
            const double distance = iterate.evaluation.distance[i];
            const bool outside = distance > -edge;
            stretch = outside ? 1.0 + edge / distance : 0.0;
            curvature = outside ? edge / (distance * distance * distance) : 0.0;
        }
        return {x[1] - place[0], x[2] - place[1], x[0], gain.value, 2.0 * gain.first * stretch,
                4.0 * gain.second * stretch * stretch - 2.0 * gain.first * curvature};
    }

    // Add to the Hessian, times a weight, the curvature of a rate that comes from the worst place
    // of an eavesdropper's disc moving along with the UAVs. `place` is n E + e for slot n and
    // eavesdropper e. Needs the signals at this place, which differentiate finds.
    //
    // For f(x) = max_w g(x, w) the Hessian is g_xx - g_xw g_ww^-1 g_wx at the worst place w; this
    // adds the second term. For a place on the edge of its disc, w moves along the edge only, whose
    // curvature is part of g_ww. Without this term, places and UAVs that follow each other may
    // swing more with every step.
    //
    // A rate depends on offsets only, so a move of the receiver equals the opposite move of all
    // UAVs: derivatives by the place are minus the sum of the derivatives by the UAVs' positions.
    void add_place_curvature(const Reception& at, std::size_t place, double weight,
                             double* hessian) {
        const int V = 3 * uavs();
        const double *of_total = space_.data(), *of_interference = of_total + V;
        double* mixed = place_space_.data();  // g_xw, (V, 2). Its sum by UAVs, by_place, is -g_ww.
        double total[2] = {}, interference[2] = {}, by_place[2][2] = {};
        for (int u = 0; u < uavs(); ++u)
            for (int axis = 0; axis < 2; ++axis) {
                total[axis] += of_total[3 * u + 1 + axis];
                interference[axis] += of_interference[3 * u + 1 + axis];
            }
        for (int u = 0; u < uavs(); ++u) {
            const Signal& signal = signals_[u];
            const double factor = 1.0 / at.total() - (u ? 1.0 / at.interference : 0.0);
            const double by_power = factor * signal.slope, isotropic = by_power * signal.power;
            const double outer = factor * signal.power * signal.curvature;
            const double offset[2] = {signal.dx, signal.dy};
            for (int axis = 0; axis < 2; ++axis) {
                const double second[3] = {
                    by_power * offset[axis],
                    outer * signal.dx * offset[axis] + (axis == 0 ? isotropic : 0.0),
                    outer * signal.dy * offset[axis] + (axis == 1 ? isotropic : 0.0)};
                for (int j = 0; j < 3; ++j) {
                    const int i = 3 * u + j;
                    mixed[2 * i + axis] = of_total[i] * total[axis]
                        - of_interference[i] * interference[axis] - second[j];
                    if (j) by_place[j - 1][axis] += mixed[2 * i + axis];
                }
            }
        }
        const double slope[2] = {interference[0] - total[0], interference[1] - total[1]};
        const double* offset = &p_.places.offsets[2 * place];
        const double radius = p_.places.radii[place];
        const double distance = std::sqrt(offset[0] * offset[0] + offset[1] * offset[1]);
        double largest = 0.0;
        for (const auto& row : by_place)
            for (const double entry : row) largest = std::max(largest, std::fabs(entry));
        const double least = FLATTEST * largest + TINY;
        // Add g_xw v v^T g_wx / curvature for moves of the place along v = (x, y), where the
        // curvature is -v^T g_ww v.
        const auto add = [&](double x, double y, double curvature) {
            const double scale = 1.0 / std::sqrt(std::max(curvature, least));
            double* row = mixed + 2 * V;
            for (int j = 0; j < V; ++j)
                row[j] = (mixed[2 * j] * x + mixed[2 * j + 1] * y) * scale;
            for (int j = 0; j < V; ++j)
                for (int m = 0; m <= j; ++m) hessian[j * V + m] += weight * row[j] * row[m];
        };
        if (distance >= ON_EDGE * radius) {
            const double inverse = 1.0 / std::max(distance, TINY);
            const double x = -offset[1] * inverse, y = offset[0] * inverse;
            const double along = (by_place[0][0] * x + by_place[0][1] * y) * x
                + (by_place[1][0] * x + by_place[1][1] * y) * y;
            add(x, y, along + (slope[0] * y - slope[1] * x) / std::max(radius, TINY));
            return;
        }
        // A place inside its disc moves along both eigenvectors of the Hessian by the place.
        const double mean = 0.5 * (by_place[0][0] + by_place[1][1]);
        const double half = 0.5 * (by_place[0][0] - by_place[1][1]);
        const double spread = std::hypot(half, by_place[1][0]);
        const double angle = 0.5 * std::atan2(by_place[1][0], half);
        add(std::cos(angle), std::sin(angle), mean + spread);
        add(-std::sin(angle), std::cos(angle), mean - spread);
    }

    const BarrierProblem& p_;
    const Model& gains_;
    const int receivers_;
    std::vector<Signal> signals_;  // Signals of the UAVs at the receiver of the last differentiate.
    Reals space_, place_space_;
};

}  // namespace kernel
