// One start of a Barrier, and what a Newton step of it needs.
#pragma once

#include <atomic>
#include <cmath>
#include <memory>

#include "problem.hpp"

namespace kernel {

// The sum of logarithms of positive numbers, by the logarithm of products of many.
class LogSum {
public:
    void add(double value) {
        if (!(value > 1e-100 && value < 1e100)) {
            sum_ += std::log(value);  // Of what is not positive it is not finite.
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

// The barrier function at one x, and what it was computed from.
struct Evaluation {
    double value = 0.0;             // Infinite outside the limits.
    Reals squared, distance;        // The guarantee's d^2, and d with its kink rounded, (N, K, U).
    Reals total, interference;      // (N, K).
    Reals leaks, largest;           // (N, E), (N); of one eavesdropper not kept.
    std::vector<Terms> limits;      // Of every Limit, and last of the peaks, (N, U, 2).
    Reals mean_slacks;              // Of the average powers, (U).
    double without_lines = 0.0;     // The value without the limits that choose lines.
};

// What stays of a start from one step to the next.
struct State {
    double* x = nullptr;       // (N, U, 3), in an array of the caller.
    double* mu = nullptr;      // Likewise.
    bool* finished = nullptr;  // Likewise.
    int age = 0;
    std::vector<Reals> duals;  // Of the slacks of every Limit, and last of the peaks.
    Reals mean_duals;          // (U).
    Reals shares;              // Duals of the leaks, (N, E), or empty before the first step.
    bool known = false;        // Whether `here` is the evaluation at x and mu.
    Evaluation here;
};

enum class Outcome { stepped, failed, stopped };

// Newton's method on one start after the other; what it works with is used again.
class Newton {
public:
    virtual ~Newton() = default;
    // Set the duals to their central values.
    virtual void begin(State& state) = 0;
    // Take a step; `stop` is looked at between its parts.
    virtual Outcome iterate(State& state, double final, const std::atomic<bool>& stop) = 0;
    // The mean rate against the receivers, losing slots silenced, in nats.
    virtual double rate(const State& state) = 0;
    // The barrier function at x, its gradient (N, U, 3), and the Hessian of the objective slot by
    // slot, of which the lower triangles count, (N, 3 U, 3 U).
    virtual double model(State& state, double* gradient, double* hessian) = 0;
};

// Return a Newton for a problem, which must outlive it.
std::unique_ptr<Newton> make_newton(const Problem& problem);

}  // namespace kernel
