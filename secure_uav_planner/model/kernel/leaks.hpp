// The leak of a slot, from the rates of its hearers: eavesdroppers, or places in their discs, and
// listeners.
#pragma once

#include <algorithm>
#include <cmath>

#include "epigraph.hpp"
#include "newton.hpp"

namespace kernel {

// A sum of rates minus mu times the sum of logarithms in `gaps`.
class RateSum {
public:
    void add(double rate) { sum_ += rate; }
    // Add the rate log(1 + SINR) of a reception, by log1p if it is weak, with SINR < 0.01.
    void add(const Reception& at) {
        if (at.is_weak())
            sum_ += at.rate();
        else
            logs_.add(1.0 + at.sinr());
    }
    // Subtract the rate log(total / interference) of a reception, by log1p if it is weak.
    void subtract(const Reception& at) {
        if (at.is_weak())
            sum_ -= at.rate();
        else
            logs_.add(at.interference / at.total());
    }
    // Return the sum plus a constant.
    double total(double mu, double constant = 0.0) {
        return sum_ + (logs_.total() + constant) - mu * gaps.total();
    }

    LogSum gaps;

private:
    double sum_ = 0.0;
    LogSum logs_;
};

// How a leak follows from the rates of its hearers: the rate of a single hearer, the largest of
// several rates, or log(1 + sum of the SINRs). The largest is smoothed: it is the minimum over t of
// t - mu sum log(t - rate).
enum class LeakKind { single, largest, colluding };

// The leak of what one ground node is sent, in every slot. `at` and gradients of rates cover all
// hearers of a slot, of whom a Leak uses E. UAVS is the number of UAVs if it is known when
// compiling, or 0 for any number.
template <int UAVS>
class Leak {
public:
    // The leak of what ground node `node` is sent, to all hearers except this node. `begin` is the
    // index of this leak's first slack in Evaluation::leak_slacks, which all leaks share.
    Leak(const BarrierProblem& problem, int node, std::size_t begin)
        : slots_(problem.slots), begin_(begin), own_(find_own(problem, node)),
          eves_(problem.hearers() - (own_ < problem.hearers())), uavs_(problem.uavs),
          by_rates_(eves_, 1.0), slopes_(eves_), mean_(size()), row_(size()) {
        if (problem.hearers() == 1)
            kind_ = LeakKind::single;
        else
            kind_ = problem.colluding ? LeakKind::colluding : LeakKind::largest;
        if (kind_ == LeakKind::largest) changes_.resize(slots_ * eves_);
    }

    // The index among all hearers of hearer e of this leak.
    int hearer(int e) const { return e < own_ ? e : e + 1; }
    int count() const { return eves_; }
    // The index behind the last slack of this leak.
    std::size_t end() const { return begin_ + slots_ * eves_; }

    // Return a slot's leak in nats, without smoothing: the largest rate of a hearer, or
    // log(1 + sum of the SINRs) if hearers collude. `at` has the receptions of all hearers.
    double compute_exact(const Reception* at) const {
        if (kind_ == LeakKind::colluding) {
            double sinrs = 0.0;
            for (int e = 0; e < eves_; ++e) sinrs += at[hearer(e)].sinr();
            return std::log1p(sinrs);
        }
        double largest = at[hearer(0)].rate();
        for (int e = 1; e < eves_; ++e) largest = std::max(largest, at[hearer(e)].rate());
        return largest;
    }

    // Add the leak of slot n to a sum. The largest of several rates is smoothed, and its slacks
    // t - rate are put into here.leak_slacks.
    void add_leak(std::size_t n, const Reception* at, double mu, Evaluation& here,
                  RateSum& sum) const {
        if (kind_ == LeakKind::single) return sum.add(at[0]);
        if (kind_ == LeakKind::colluding) return sum.add(compute_exact(at));
        if (here.leak_slacks.size() < end()) here.leak_slacks.resize(end());
        double* slacks = &here.leak_slacks[first_slack(n)];
        for (int e = 0; e < eves_; ++e) slacks[e] = at[hearer(e)].rate();
        sum.add(solve_epigraph(slacks, eves_, mu, sum.gaps));
    }

    // Derivatives of the leak by the E hearers' rates, in the last slot of differentiate_by_rates.
    const Reals& by_rates() const { return by_rates_; }

    // Set by_rates_, the derivatives of slot n's leak by the rates r_e of its E hearers. Return the
    // weights (E) of the rates' Hessians in the leak's Hessian. For the largest rate, derivatives
    // are mu / slack_e, and weights are the slacks' duals (primal-dual method). For colluding
    // hearers, both are e^r_e / (1 + sum of the SINRs). For a single hearer, both are 1.
    const double* differentiate_by_rates(std::size_t n, const Reception* at,
                                         const Iterate& iterate, double mu) {
        if (kind_ == LeakKind::largest) {
            for (int e = 0; e < eves_; ++e)
                by_rates_[e] = mu / iterate.evaluation.leak_slacks[first_slack(n) + e];
            return &iterate.leak_duals[first_slack(n)];
        }
        if (kind_ == LeakKind::colluding) {
            const double inverse = std::exp(-compute_exact(at));
            for (int e = 0; e < eves_; ++e)
                by_rates_[e] = at[hearer(e)].total() / at[hearer(e)].interference * inverse;
        }
        return by_rates_.data();
    }

    // Add to `hessian`, (V, V), `weight` times the part of the leak's Hessian that comes from the
    // gradients g_e (V) of the hearers' rates. For the largest rate it is the sum of
    // w_e (g_e - mean) (g_e - mean)^T with w_e = dual / slack and mean = sum w_e g_e / sum w_e. For
    // colluding hearers it is sum w_e g_e g_e^T - mean mean^T, with mean = sum w_e g_e and the
    // leak's derivatives w_e by the rates, from differentiate_by_rates for slot n. For a single
    // hearer it is 0. `gradients` cover all hearers.
    void add_curvature(std::size_t n, const Iterate& iterate, double weight,
                       const double* gradients, double* hessian) {
        if (kind_ == LeakKind::single) return;
        std::fill(mean_.begin(), mean_.end(), 0.0);
        if (kind_ == LeakKind::colluding) {
            for (int e = 0; e < eves_; ++e) {
                const double* gradient = gradients + hearer(e) * size();
                add_scaled(by_rates_[e], gradient, mean_.data());
                add_outer(weight * by_rates_[e], gradient, hessian);
            }
            return add_outer(-weight, mean_.data(), hessian);
        }
        const double* slacks = &iterate.evaluation.leak_slacks[first_slack(n)];
        const double* duals = &iterate.leak_duals[first_slack(n)];
        double sum = 0.0;
        for (int e = 0; e < eves_; ++e) {
            sum += duals[e] / slacks[e];
            add_scaled(duals[e] / slacks[e], gradients + hearer(e) * size(), mean_.data());
        }
        for (double& mean : mean_) mean /= sum;
        for (int e = 0; e < eves_; ++e) {
            const double* gradient = gradients + hearer(e) * size();
            for (int j = 0; j < size(); ++j) row_[j] = gradient[j] - mean_[j];
            add_outer(weight * (duals[e] / slacks[e]), row_.data(), hessian);
        }
    }

    // Find the Newton step of the duals for a step of x, (N, V), and lower the step length `length`
    // so that the duals stay positive. `gradients` of the rates of all hearers, (V) each, begin
    // `stride` numbers apart in successive slots. Only the smoothed largest rate has duals.
    void find_dual_changes(const Iterate& iterate, const double* step, double mu,
                           const double* gradients, std::size_t stride, double& length) {
        if (kind_ != LeakKind::largest) return;
        for (std::size_t n = 0; n < slots_; ++n) {
            for (int e = 0; e < eves_; ++e) {
                const double* gradient = gradients + n * stride + hearer(e) * size();
                slopes_[e] = 0.0;
                for (int j = 0; j < size(); ++j) slopes_[e] += gradient[j] * step[n * size() + j];
            }
            const std::size_t i = first_slack(n);
            find_epigraph_changes(eves_, mu, &iterate.evaluation.leak_slacks[i],
                                  &iterate.leak_duals[i], slopes_.data(), &changes_[n * eves_],
                                  length);
        }
    }

    void move_duals(Iterate& iterate, double length) const {
        for (std::size_t i = 0; i < changes_.size(); i += eves_)
            move_epigraph_duals(eves_, length, &changes_[i], &iterate.leak_duals[begin_ + i]);
    }

private:
    int size() const { return 3 * (UAVS ? UAVS : uavs_); }
    std::size_t first_slack(std::size_t n) const { return begin_ + n * eves_; }

    // A ground node's index among the hearers, or the number of hearers if it does not listen.
    static int find_own(const BarrierProblem& problem, int node) {
        const std::vector<int>& listeners = problem.receivers.listeners;
        return problem.eavesdroppers()
            + int(std::find(listeners.begin(), listeners.end(), node) - listeners.begin());
    }

    void add_scaled(double factor, const double* row, double* __restrict sum) const {
        for (int j = 0; j < size(); ++j) sum[j] += factor * row[j];
    }

    void add_outer(double weight, const double* row, double* __restrict hessian) const {
        for (int j = 0; j < size(); ++j)
            for (int m = 0; m <= j; ++m) hessian[j * size() + m] += weight * row[j] * row[m];
    }

    const std::size_t slots_, begin_;
    const int own_, eves_, uavs_;
    LeakKind kind_;
    Reals by_rates_, slopes_, changes_, mean_, row_;  // (E), (E), (N, E), (V), (V).
};

}  // namespace kernel
