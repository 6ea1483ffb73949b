// The barrier problem that Newton's method solves, in the units of a Grid, and its iterates.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <memory>
#include <vector>

#include "channel.hpp"
#include "energy.hpp"
#include "limit.hpp"

namespace kernel {

constexpr double FRACTION_TO_BOUNDARY = 0.995;  // How far towards a limit a step may go.

// The ground nodes and the eavesdroppers, K in all.
struct Receivers {
    int count;
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
struct Problem {
    std::size_t slots;
    int uavs;
    Reals starts, goals;      // (U, 2).
    std::vector<char> fixed;  // UAVs whose positions are no variables, (U).
    Reals peaks;              // (U).
    std::vector<std::shared_ptr<const Limit>> limits;
    Receivers receivers;
    std::shared_ptr<const Channel> channel;
    Places places;
    double rate_unit = 1.0;  // In nats.
    std::shared_ptr<const EnergyCost> energy;  // Or none.
    bool colluding = false;  // Whether the SINRs of eavesdroppers, or of places, add up.

    int nodes() const { return int(receivers.weights.size()); }

    // The number of rows of the Hessian's band below its diagonal.
    int bandwidth() const {
        int rows = 3 * uavs - 1;
        for (const auto& limit : limits) rows = std::max(rows, limit->bandwidth());
        return rows;
    }
};

// A sum of logarithms of positive numbers; the logarithm of a product of many is taken at once.
class LogSum {
public:
    void add(double value) {
        if (!(value > 1e-100 && value < 1e100)) {
            sum_ += std::log(value);  // Not finite where the value is not positive.
            return;
        }
        product_ *= value;
        if (!(product_ > 1e-150 && product_ < 1e150)) flush();
    }
    double total() {
        flush();
        return sum_;
    }

private:
    void flush() {
        sum_ += std::log(product_);
        product_ = 1.0;
    }
    double product_ = 1.0, sum_ = 0.0;
};

// The barrier function at one x, and its intermediate results.
struct Evaluation {
    double value = 0.0;                // Infinite outside the limits.
    Reals squared, distance;           // The guarantee's d^2, and its rounded d, (N, K, U).
    Reals total, interference;         // (N, K).
    Reals leaks, largest_leaks;        // (N, E), (N); not kept for a single eavesdropper.
    Reals node_rates, node_slacks;     // Of several ground nodes, (N, G), (G).
    // Of every Limit, of the peaks, (N, U, 2), and of the shares, which several nodes have.
    std::vector<Slacks> slacks;
    Reals mean_slacks;                 // Of the average powers, (U).
    double value_without_lines = 0.0;  // The value without the limits that have lines.
};

// The iterate of one start.
struct Iterate {
    double* x = nullptr;        // (N, U, 3), in an array of the caller.
    double* shares = nullptr;   // Of the slots, for the ground nodes, (N, G), likewise.
    double* mu = nullptr;       // Likewise, in units of rates.
    bool* finished = nullptr;   // Likewise.
    int steps_at_mu = 0;
    std::vector<Reals> duals;   // As the slacks.
    Reals mean_duals;           // (U).
    Reals leak_duals;           // (N, E), or empty before the first step.
    Reals node_duals;           // (G), likewise.
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
std::unique_ptr<Newton> make_newton(const Problem& problem);

}  // namespace kernel
