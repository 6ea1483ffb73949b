#include "starts.hpp"

#include <algorithm>
#include <chrono>
#include <future>
#include <thread>

namespace kernel {

namespace {

// Products of the steps of all starts below which threads cost more than they gain, those of a
// single start, which a thread makes no faster, below which others need not be let in, and those
// of several steps that are short together.
constexpr double WORTH_THREADS = 1e6, LONG = 5e6, SHORT = 2e7;
// How often the caller looks whether to stop.
constexpr std::chrono::milliseconds LOOK{10};

}  // namespace

void Starts::add(double* x, double* mu, bool* finished) {
    states_.emplace_back();
    State& state = states_.back();
    state.x = x;
    state.mu = mu;
    state.finished = finished;
    worker(0).begin(state);
}

void Starts::rates(double* found) {
    for (const State& state : states_) *found++ = worker(0).rate(state);
}

void Starts::model(double* values, double* gradients, double* hessians) {
    for (State& state : states_) {
        *values++ = worker(0).model(state, gradients, hessians);
        gradients += variables();
        hessians += variables() * 3 * problem_.uavs;
    }
}

void Starts::exchange(Places places, Reals positions) {
    problem_.places = std::move(places);
    problem_.receivers.positions = std::move(positions);
    for (State& state : states_) state.known = false;
}

Newton& Starts::worker(std::size_t number) {
    while (workers_.size() <= number) workers_.push_back(make_newton(problem_));
    return *workers_[number];
}

void Starts::work(std::size_t number, double final) {
    Newton& newton = *workers_[number];
    while (!stop_) {
        const std::size_t index = next_++;
        if (index >= states_.size()) return;
        for (auto& failed : failed_) {
            if (stop_) return;
            if (newton.iterate(states_[index], final, stop_) == Outcome::failed) ++failed;
        }
    }
}

double Starts::cost() const {
    const double row = 3.0 * problem_.uavs, high = below_ + row;
    return double(states_.size()) * double(problem_.slots)
        * (high * high + 4.0 * row * row * problem_.receivers.count);
}

Taken Starts::advance(int steps, double final, const std::function<void()>& wait) {
    const double step = cost();
    steps = int(std::clamp(SHORT / step, 1.0, double(std::max(1, steps))));
    stop_ = false;
    next_ = 0;
    failed_ = std::vector<std::atomic<std::size_t>>(steps);
    worker(0);
    if (step * steps < (states_.size() > 1 ? WORTH_THREADS : LONG)) work(0, final);
    else on_all_cores(final, wait);
    return {steps, *std::max_element(failed_.begin(), failed_.end())};
}

void Starts::on_all_cores(double final, const std::function<void()>& wait) {
    const std::size_t count = std::min<std::size_t>(
        states_.size(), std::max(1u, std::thread::hardware_concurrency()));
    worker(count - 1);
    // Where this throws, what runs ends first: these join their threads.
    std::vector<std::future<void>> running;
    try {
        for (std::size_t number = 0; number < count; ++number)
            running.push_back(std::async(std::launch::async, &Starts::work, this, number, final));
        for (std::future<void>& one : running) {
            while (one.wait_for(LOOK) != std::future_status::ready) wait();
            one.get();
        }
    } catch (...) {
        stop_ = true;
        throw;
    }
}

}  // namespace kernel
