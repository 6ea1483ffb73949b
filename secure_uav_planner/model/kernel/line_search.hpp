// A line search by Armijo's rule along a Newton step.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>

#include "constraints.hpp"
#include "newton.hpp"

namespace kernel {

constexpr double POWER_FACTOR = 10.0;  // Largest factor by which a power changes in a step.
// CLIPPED_TRIALS stop every power and flight at its own limit; UNIFORM_TRIALS go along the step.
constexpr int CLIPPED_TRIALS = 3, UNIFORM_TRIALS = 17;
constexpr double ROUNDING = 1e-12;  // Relative change of the barrier function that is rounding.
constexpr double ARMIJO = 1e-4;     // Fraction of the expected decrease that suffices.

template <int UAVS>
class LineSearch {
public:
    explicit LineSearch(const BarrierProblem& problem)
        : x(problem.slots * problem.uavs * 3), shares(problem.share_slacks()), p_(problem),
          lengths_(problem.uavs) {}

    // Return the length of the first trial at which the barrier function, up to rounding, falls by
    // ARMIJO times the expected decrease. Return 0 if no trial does, or once `stop` is true. The
    // trial stays in `x` and `shares`, where `evaluate` evaluates the barrier function. `slope` is
    // the derivative of the barrier function along the step. The first CLIPPED_TRIALS stop every
    // power and every flight at its own limit, and so go much farther than to the first limit.
    // The UNIFORM_TRIALS after them have one length for all variables, within all limits.
    template <typename Evaluate>
    double search(const Iterate& iterate, const Reals& step, const Reals& gradient, double slope,
                  const Constraints<UAVS>& constraints, const std::atomic<bool>& stop,
                  Evaluate evaluate) {
        const double uniform = constraints.limit_lengths(iterate, step.data(), lengths_);
        const double value = iterate.evaluation.value;
        const double bound = value + ROUNDING * std::fabs(value);
        for (int trial = 0; trial < CLIPPED_TRIALS + UNIFORM_TRIALS; ++trial) {
            if (stop) return 0.0;
            double length = std::ldexp(1.0, -trial), expected;
            if (trial < CLIPPED_TRIALS) {
                expected = move_clipped(iterate, step, gradient, constraints, length);
            } else {
                length = uniform * std::ldexp(1.0, CLIPPED_TRIALS - trial);
                expected = length * slope;
                move_uniformly(iterate, step, constraints, length);
            }
            if (expected < 0.0 && evaluate() <= bound + ARMIJO * expected) return length;
        }
        return 0.0;
    }

    Reals x, shares;  // The last trial, (N, U, 3) and (N, G); shares are empty for one node.

private:
    // Set the trial to the iterate plus the step times one length for all variables.
    void move_uniformly(const Iterate& iterate, const Reals& step,
                        const Constraints<UAVS>& constraints, double length) {
        for (std::size_t i = 0; i < x.size(); ++i) x[i] = iterate.x[i] + length * step[i];
        for (std::size_t i = 0; i < shares.size(); ++i)
            shares[i] = iterate.shares[i] + length * constraints.share_slopes()[i];
    }

    // Set the trial to the iterate plus `length` times the step, but stop every power, every flight
    // and the shares of every slot at its own limit. A power changes by at most the factor
    // POWER_FACTOR. Return gradient . (trial - iterate), the expected change of the barrier
    // function. `step` and `gradient` have x, (N, U, 3), and behind it shares, (N, G - 1).
    double move_clipped(const Iterate& iterate, const Reals& step, const Reals& gradient,
                        const Constraints<UAVS>& constraints, double length) {
        const double lowest = std::max(1.0 - FRACTION_TO_BOUNDARY, 1.0 / POWER_FACTOR);
        double expected = 0.0;
        std::size_t i = 0;
        for (std::size_t n = 0; n < p_.slots; ++n)
            for (int u = 0; u < p_.uavs; ++u, i += 3) {
                const double* from = iterate.x + i;
                const double highest =
                    std::min(from[0] * POWER_FACTOR,
                             from[0] + FRACTION_TO_BOUNDARY * (p_.peaks[u] - from[0]));
                x[i] = std::min(std::max(from[0] + length * step[i], from[0] * lowest), highest);
                for (int axis = 1; axis < 3; ++axis)
                    x[i + axis] = from[axis] + length * step[i + axis] * lengths_[u];
                for (int j = 0; j < 3; ++j) expected += gradient[i + j] * (x[i + j] - from[j]);
            }
        double of_shares = 0.0;
        for (std::size_t first = 0; first < shares.size(); first += p_.nodes()) {
            const double* from = iterate.shares + first;
            const double* changes = &constraints.share_slopes()[first];
            double in_slot = length;
            for (int k = 0; k < p_.nodes(); ++k) limit_step(in_slot, from[k], changes[k]);
            for (int k = 0; k < p_.nodes(); ++k) {
                shares[first + k] = from[k] + in_slot * changes[k];
                if (k > 0) of_shares += in_slot * changes[k] * gradient[i++];
            }
        }
        return expected + of_shares;
    }

    const BarrierProblem& p_;
    Reals lengths_;  // Step length of each UAV's flight, (U).
};

}  // namespace kernel
