// Sums of logarithms, and the smoothed largest of several values: the minimum over t of
// t - mu sum log(t - value), the epigraph form.
#pragma once

#include <algorithm>
#include <cmath>

#include "limit.hpp"

namespace kernel {

// A sum of logarithms of positive numbers, faster by taking the logarithm of products of many.
class LogSum {
public:
    // Add the logarithm of a value, as a factor of product_, whose logarithm flush() adds to sum_
    // before it overflows. The sum is not finite if the value is not positive.
    void add(double value) {
        if (!(value > 1e-100 && value < 1e100)) {
            sum_ += std::log(value);
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

// Return the minimiser t of t - mu sum log(t - value), whose minimum is the smoothed largest of the
// values. Replace the values by their slacks t - value, and add each log(slack / mu) to `gaps`.
// Newton's method solves sum mu / (t - value) = 1 from the left of its root, so without
// overshooting. In the loop, t is (t - largest value) / mu.
inline double solve_epigraph(double* values, int count, double mu, LogSum& gaps) {
    // STEPS suffice for 16 values, because a step far from the root doubles t. With more values
    // further steps are taken until the sum exceeds 1 by at most NEAR; one step from there is
    // exact to rounding.
    constexpr int STEPS = 8;
    constexpr double NEAR = 1e-8;
    const double largest = *std::max_element(values, values + count);
    double t = 1.0, before = 0.0, sum = 0.0;
    for (int step = 0; t != before && (step < STEPS || sum > 1.0 + NEAR); ++step) {
        double squares = 0.0;
        before = t;
        sum = 0.0;
        for (int i = 0; i < count; ++i) {
            const double inverse = 1.0 / (t + (largest - values[i]) / mu);
            sum += inverse;
            squares += inverse * inverse;
        }
        t += (sum - 1.0) / squares;
    }
    t = largest + mu * t;
    for (int i = 0; i < count; ++i) {
        values[i] = t - values[i];
        gaps.add(values[i] / mu);
    }
    return t;
}

// Fill `changes`, the Newton step of the duals of values with slacks t - value by solve_epigraph. A
// dual changes by mu / slack - dual - dual / slack * (change of t - slope), where `slopes` are the
// derivatives of the values along the step. The change of t brings the sum of the duals to 1. Lower
// the step length `length` so that the duals stay positive.
inline void find_epigraph_changes(int count, double mu, const double* slacks, const double* duals,
                                  const double* slopes, double* changes, double& length) {
    double sum = 0.0, total = 0.0, weighted = 0.0;
    for (int i = 0; i < count; ++i) {
        const double ratio = duals[i] / slacks[i];
        sum += mu / slacks[i];
        total += ratio;
        weighted += ratio * slopes[i];
    }
    const double change_of_t = (sum - 1.0 + weighted) / total;
    for (int i = 0; i < count; ++i) {
        changes[i] = mu / slacks[i] - duals[i] - duals[i] / slacks[i] * (change_of_t - slopes[i]);
        limit_step(length, duals[i], changes[i]);
    }
}

// Add `length` times the changes to the duals, then divide the duals by their sum.
inline void move_epigraph_duals(int count, double length, const double* changes, double* duals) {
    double sum = 0.0;
    for (int i = 0; i < count; ++i) sum += duals[i] += length * changes[i];
    for (int i = 0; i < count; ++i) duals[i] /= sum;
}

}  // namespace kernel
