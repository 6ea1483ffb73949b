// Several starts of a problem, advanced side by side on all cores.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <vector>

#include "start.hpp"

namespace kernel {

// How many steps were taken, and how many of the starts failed in the worst of them.
struct Taken {
    int steps;
    std::size_t failed;
};

class Starts {
public:
    explicit Starts(Problem problem)
        : problem_(std::move(problem)), below_(problem_.bandwidth()) {}
    Starts(const Starts&) = delete;

    // Add a start whose arrays stay where they are; see State.
    void add(double* x, double* mu, bool* finished);
    // Take up to so many steps from every start, as many as are short together, and tell how many.
    // `wait` is called now and then meanwhile, if it takes long; what it throws ends the step of
    // the starts that have not gone it.
    Taken advance(int steps, double final, const std::function<void()>& wait);
    void rates(double* found);
    // Find for every start what Newton::model does.
    void model(double* values, double* gradients, double* hessians);
    // Go on with places that have been exchanged, as many as before.
    void exchange(Places places, Reals positions);

    const Problem& problem() const { return problem_; }
    std::size_t count() const { return states_.size(); }

private:
    Newton& worker(std::size_t number);
    void work(std::size_t number, double final);
    void on_all_cores(double final, const std::function<void()>& wait);
    std::size_t variables() const { return problem_.slots * problem_.uavs * 3; }
    double cost() const;

    Problem problem_;
    const int below_;
    std::vector<State> states_;
    std::vector<std::unique_ptr<Newton>> workers_;
    std::atomic<bool> stop_{false};
    std::atomic<std::size_t> next_{0};
    std::vector<std::atomic<std::size_t>> failed_;  // Starts that failed, for every step.
};

}  // namespace kernel
