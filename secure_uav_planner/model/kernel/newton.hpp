// The barrier problem that Newton's method solves, in the units of a Grid, and its iterates.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <memory>
#include <vector>

#include "link_gains.hpp"
#include "energy.hpp"
#include "limit.hpp"

namespace kernel {

// The ground nodes, the eavesdroppers, and ground nodes again that hear what is sent to the other
// ones, K in all.
struct Receivers {
    int count;
    std::vector<int> listeners;  // The numbers of the latter among the ground nodes.
    Reals weights;    // Of the ground nodes, which come first, (G).
    Reals offsets;    // Of their mean rates, in nats, (G).
    Reals positions;  // (N, K, 2).
    Reals radii;      // What the guarantee adds to a jammer's distance, (N, K).
};

// Places that stand for the discs of the eavesdroppers, P for each; see joint/exchange.py.
struct Places {
    std::vector<char> followed;  // Whether they move along with the UAVs, (N, E P).
    Reals offsets;               // From the centres of their discs, (N, E P, 2).
    Reals radii;                 // Of their discs, (N, E P).
};

// A problem on a grid: (P1) with places, or (P2) without.
struct BarrierProblem {
    std::size_t slots;
    int uavs;
    Reals starts, goals;      // (U, 2).
    std::vector<char> fixed;  // UAVs whose positions are no variables, (U).
    Reals peaks;              // (U).
    std::vector<std::shared_ptr<const Limit>> limits;
    Receivers receivers;
    std::shared_ptr<const LinkGains> gains;
    Places places;
    double rate_unit = 1.0;  // In nats.
    std::shared_ptr<const EnergyCost> energy;  // Or none.
    bool colluding = false;  // Whether the SINRs of eavesdroppers, or of places, add up.

    int nodes() const { return int(receivers.weights.size()); }
    int listeners() const { return int(receivers.listeners.size()); }
    // All that the leak counts with: the eavesdroppers and, behind them, the listeners.
    int hearers() const { return receivers.count - nodes(); }
    int eavesdroppers() const { return hearers() - listeners(); }
    // The shares that vary in a slot: the first node has what the others leave.
    int shares() const { return nodes() - 1; }
    // The number of slacks of all shares, (N, G), where any vary.
    std::size_t share_slacks() const { return shares() ? slots * nodes() : 0; }
    // The number of variables: powers and positions, (N, U, 3), and shares, (N, G - 1).
    std::size_t variables() const { return slots * (3 * uavs + shares()); }

    // Fill the points of flights, or their moves along a step, (N + 2, U, 2).
    void fill_path(const double* x, Reals& path, bool moves = false) const {
        const std::size_t width = 2 * uavs;
        path.assign((slots + 2) * width, 0.0);
        if (!moves) {
            std::copy(starts.begin(), starts.end(), path.begin());
            std::copy(goals.begin(), goals.end(), path.end() - width);
        }
        for (std::size_t i = 0; i < slots * uavs; ++i)
            std::copy(x + 3 * i + 1, x + 3 * i + 3, &path[width + 2 * i]);
    }

    // The number of rows of the Hessian's band below its diagonal.
    int bandwidth() const {
        int rows = 3 * uavs - 1;
        for (const auto& limit : limits) rows = std::max(rows, limit->vectors().bandwidth());
        return rows;
    }
};

// What a receiver receives: the transmitter's signal, and interference with noise.
struct Reception {
    double signal, interference;

    double total() const { return interference + signal; }
    double sinr() const { return signal / interference; }
    bool is_weak() const { return signal < 1e-2 * interference; }
    // The rate in nats, accurate to rounding where it is small.
    double rate() const { return is_weak() ? std::log1p(sinr()) : std::log(1.0 + sinr()); }
};

// The barrier function at one x, and its intermediate results.
struct Evaluation {
    double value = 0.0;                 // Infinite outside the limits.
    Reals squared, distance;            // The guarantee's d^2, and its rounded d, (N, K, U).
    std::vector<Reception> receptions;  // (N, K).
    Reals leak_slacks;                  // Where the largest of several counts, (N, E) by leak.
    Reals node_rates, node_slacks;      // Of several nodes, over their weights, (N, G), (G).
    // Of every Limit, of the peaks, (N, U, 2), of the average powers, (U), and of the shares.
    std::vector<Slacks> slacks;
    double value_without_lines = 0.0;   // The value without the limits that have lines.
};

// The iterate of one start.
struct Iterate {
    double* x = nullptr;        // (N, U, 3), in an array of the caller.
    double* shares = nullptr;   // Of the slots, for the ground nodes, (N, G), likewise.
    double* mu = nullptr;       // Likewise, in units of rates.
    bool* finished = nullptr;   // Likewise.
    int steps_at_mu = 0;
    std::vector<Reals> duals;   // As the slacks.
    Reals leak_duals;           // Likewise.
    Reals node_duals;           // Likewise, (G).
    bool is_evaluated = false;  // True if `evaluation` is that at x and mu.
    Evaluation evaluation;
};

enum class Outcome { stepped, failed, stopped };

// Newton's method on one start after the other, in the same working memory.
class Newton {
public:
    virtual ~Newton() = default;
    // Set the shares and the duals to their central values.
    virtual void initialise(Iterate& iterate) = 0;
    // Take a step; `stop` is looked at between its parts.
    virtual Outcome take_step(Iterate& iterate, double final_mu,
                              const std::atomic<bool>& stop) = 0;
    // Find the mean rate against the receivers, losing slots silenced, in nats.
    virtual double evaluate_rate(const Iterate& iterate) = 0;
    // Find the barrier function at x, its gradient, (N, U, 3), and that of the shares behind it,
    // (N, G - 1), and the lower triangles of the objective's Hessian slot by slot.
    virtual double evaluate(Iterate& iterate, double* gradient, double* hessian) = 0;
};

// Make a Newton for a problem, which must outlive it.
std::unique_ptr<Newton> make_newton(const BarrierProblem& problem);

}  // namespace kernel
