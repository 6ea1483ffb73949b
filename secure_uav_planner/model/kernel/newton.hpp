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

// K receivers in this order: G ground nodes, the eavesdroppers, and as listeners those ground nodes
// again that hear what the other nodes are sent.
struct Receivers {
    int count;                   // K.
    std::vector<int> listeners;  // The index among the ground nodes of each listener.
    Reals weights;    // Weights of the ground nodes, (G).
    Reals offsets;    // Offsets of the ground nodes' mean rates in nats, (G).
    Reals positions;  // (N, K, 2).
    Reals radii;      // What the guarantee adds to a jammer's distance, (N, K).
};

// P places in the disc of each eavesdropper, which represent the disc; see joint/exchange.py.
struct Places {
    std::vector<char> moves_along;  // Whether a place moves along with the UAVs, (N, E P).
    Reals offsets;               // Place minus centre of its disc, (N, E P, 2).
    Reals radii;                 // Radius of the place's disc, (N, E P).
};

// A problem on a grid: (P1) with places, or (P2) without.
struct BarrierProblem {
    std::size_t slots;
    int uavs;
    Reals starts, goals;      // (U, 2).
    std::vector<char> fixed;  // Whether a UAV's positions stay as they are, (U).
    Reals peaks;              // Peak powers, (U).
    std::vector<std::shared_ptr<const Limit>> limits;
    Receivers receivers;
    std::shared_ptr<const LinkGains> gains;
    Places places;
    double rate_unit = 1.0;  // The unit of rates, in nats.
    std::shared_ptr<const Energies> energies;  // Null if no energy is limited.
    bool colluding = false;  // Whether the SINRs of eavesdroppers, or of places, add up.

    int nodes() const { return int(receivers.weights.size()); }
    int listeners() const { return int(receivers.listeners.size()); }
    // The number of receivers to which a slot may leak: eavesdroppers, then listeners.
    int hearers() const { return receivers.count - nodes(); }
    int eavesdroppers() const { return hearers() - listeners(); }
    // The number of variable shares in a slot; the first node has 1 minus their sum.
    int shares() const { return nodes() - 1; }
    // The number of slacks of shares: all shares, (N, G), or 0 for a single node.
    std::size_t share_slacks() const { return shares() ? slots * nodes() : 0; }
    // The number of variables: powers and positions, (N, U, 3), and shares, (N, G - 1).
    std::size_t variables() const { return slots * (3 * uavs + shares()); }

    // Fill `path`, (N + 2, U, 2), with the starts, the positions of x, (N, U, 3), and the goals.
    // With `moves`, x is a step: the path's entries are then moves, 0 for starts and goals.
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

    // Rows of the Hessian's band below its diagonal: at least 3 U - 1, which hold a slot's block.
    int bandwidth() const {
        int rows = 3 * uavs - 1;
        for (const auto& limit : limits) rows = std::max(rows, limit->vectors().bandwidth());
        return rows;
    }
};

// Powers at a receiver, over the noise power: the signal, and interference plus noise.
struct Reception {
    double signal, interference;

    double total() const { return interference + signal; }
    double sinr() const { return signal / interference; }
    bool is_weak() const { return signal < 1e-2 * interference; }
    // The rate in nats, to full relative accuracy also if it is small.
    double rate() const { return is_weak() ? std::log1p(sinr()) : std::log(1.0 + sinr()); }
};

// The barrier function at one x, and its intermediate results.
struct Evaluation {
    double value = 0.0;                 // Infinite outside the limits.
    Reals squared, distance;            // The guarantee's d^2, and its softened d, (N, K, U).
    std::vector<Reception> receptions;  // (N, K).
    Reals leak_slacks;   // Slacks t - rate, (N, E) for each leak; only if the largest rate leaks.
    Reals node_rates;    // (Rate - leak) / weight, (N, G); only with several nodes.
    Reals node_slacks;   // Slacks mean - eta, (G); only with several nodes.
    // Slacks of every Limit, of the peaks (N, U, 2), of the average powers (U), of the energies
    // (U), and of the shares.
    std::vector<Slacks> slacks;
    double value_without_lines = 0.0;   // The value without the limits that have lines.
};

// The iterate of one start.
struct Iterate {
    // Pointers into arrays of the caller.
    double* x = nullptr;        // Powers and positions, (N, U, 3).
    double* shares = nullptr;   // Fractions of the slots for the ground nodes, (N, G).
    double* mu = nullptr;       // Barrier parameter in units of rates.
    bool* finished = nullptr;   // Whether the start has converged or stalled.
    bool* over = nullptr;       // Whether each energy has a price in place of a barrier, (U).
    double* prices = nullptr;   // Prices of the energies in units of rates per limit, (U).
    int steps_at_mu = 0;        // Number of steps with the present mu.
    std::vector<Reals> duals;   // Duals of `slacks` in Evaluation, with their shapes.
    Reals leak_duals;           // Duals of `leak_slacks`; their sum is 1 in each slot of a leak.
    Reals node_duals;           // Duals of `node_slacks`, (G); their sum is 1.
    bool is_evaluated = false;  // Whether `evaluation` belongs to the present x and mu.
    Evaluation evaluation;
};

enum class Outcome { stepped, failed, stopped };

// Newton's method on one start after the other, in the same working memory.
class Newton {
public:
    virtual ~Newton() = default;
    // Set the shares to the best for x, and the duals to their central values.
    virtual void initialise(Iterate& iterate) = 0;
    // Take a step. Once `stop` is true it ends early and leaves x, shares and mu as they are.
    virtual Outcome take_step(Iterate& iterate, double final_mu,
                              const std::atomic<bool>& stop) = 0;
    // Return the least weighted mean secrecy rate in nats, with 0 for negative rates.
    virtual double evaluate_rate(const Iterate& iterate) = 0;
    // Find the barrier function at x and its derivatives. `gradient` is by x, (N, U, 3), and behind
    // it by the shares, (N, G - 1). `hessian` has the objective's lower triangles, slot by slot.
    virtual double evaluate(Iterate& iterate, double* gradient, double* hessian) = 0;
};

// Make a Newton for a problem, which must outlive it.
std::unique_ptr<Newton> make_newton(const BarrierProblem& problem);

}  // namespace kernel
