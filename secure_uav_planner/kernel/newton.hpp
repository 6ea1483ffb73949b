// A Newton step for a number of UAVs that is known when compiling, or for any (UAVS = 0).
//
// It does for one start what barrier.Barrier.iterate does for all; the same names mean the same.
#pragma once

#include <algorithm>
#include <array>

#include "linear.hpp"
#include "rates.hpp"
#include "start.hpp"

namespace kernel {

constexpr double FIRST_SHIFT = 1e-12;  // These four: see newton.py.
constexpr int ONE_BY_ONE = 3;
constexpr int ALL_AT_ONCE = 12;
constexpr std::array<double, 9> SHIFTS{1e-8, 1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6, 1e8};
constexpr double ROUNDING = 1e-12;     // See line_search.py.

template <int UAVS>
class NewtonOf : public Newton {
public:
    explicit NewtonOf(const Problem& problem)
        : p_(problem), slots_(problem.slots), count_(problem.uavs), rates_(problem) {
        const std::size_t n = slots_, v = 3 * count_;
        below_ = p_.below();
        lines_.resize(p_.lines.size());
        line_changes_.resize(p_.lines.size());
        line_moves_.resize(p_.lines.size());
        pieces_moved_.resize(p_.lines.size());
        gradient_.resize(n * v);
        step_.resize(n * v + below_);
        there_.resize(n * v);
        hessian_.resize(n * v * v);
        band_.resize((n * v + below_) * (below_ + 1));
        factor_.resize(band_.size());
        right_.resize((n * v + below_) * (1 + count_));
        convex_.resize(n);
        flights_.resize(count_);
        zeros_.resize(4 * count_);
        space_.resize(v * (2 * v + 4));
        for (const NormLimit& limit : p_.norms) {
            step_differences_.emplace_back((n + limit.order) * count_ * 2);
            norm_moves_.emplace_back((n + limit.order) * count_);
        }
        peak_moves_.resize(n * count_ * 2);
        mean_moves_.resize(count_);
    }

    void begin(State& state) override {
        differences(state.x, true, state.here.differences);
        margins(state.x, state.here);
        if (!p_.lines.empty()) choose_lines(state.x, state.here);
        const double mu = *state.mu;
        const auto central = [mu](const std::vector<Reals>& margins, std::vector<Reals>& duals) {
            duals = margins;
            for (Reals& of : duals)
                for (double& dual : of) dual = mu / dual;
        };
        central(state.here.norm_margins, state.norm_duals);
        central(state.here.line_margins, state.line_duals);
        const int U = uavs();
        state.peak_duals.resize(std::size_t(slots_) * U * 2);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u)
                for (int side = 0; side < 2; ++side)
                    state.peak_duals[(n * U + u) * 2 + side] = mu / peak_margin(
                        state.x[(n * U + u) * 3], u, side);
        state.mean_duals.resize(U);
        for (int u = 0; u < U; ++u)
            state.mean_duals[u] = double(slots_) * mu / state.here.mean_margins[u];
    }

    Outcome iterate(State& state, double final, const std::atomic<bool>& stop) override {
        const double mu = *state.mu;
        Evaluation& here = state.here;
        if (!p_.lines.empty()) choose_lines(state.x, here);
        if (!state.known) evaluate(state.x, mu, here);
        else add_lines(mu, here);
        if (!p_.lines.empty()) clip_duals(state, here, state.x, mu);
        if (stop) return Outcome::stopped;
        rates_.model(state, here, mu, gradient_.data(), hessian_.data());
        if (stop) return Outcome::stopped;
        add_gradient_of_limits(state.x, here, mu);
        fix(gradient_.data());
        assemble(state, here);
        if (stop) return Outcome::stopped;
        const bool solved = newton_step(state, here, stop);
        if (stop) return Outcome::stopped;
        if (!solved) std::fill(step_.begin(), step_.end(), 0.0);
        differences(step_.data(), false, step_differences_);
        if (!p_.lines.empty()) follow_path(step_.data(), false);
        for (std::size_t l = 0; l < p_.lines.size(); ++l)
            p_.lines[l]->change(lines_[l], path_.data(), uavs(), line_changes_[l],
                                pieces_moved_[l]);

        double length = 0.0;
        const bool at_end = line_search(state, here, mu, stop, length);
        if (stop) return Outcome::stopped;
        move_duals(state, here, mu, at_end);
        double along = 0.0;
        for (std::size_t i = 0; i < gradient_.size(); ++i) along += step_[i] * gradient_[i];
        if (length > 0.0) std::copy(there_.begin(), there_.end(), state.x);
        if (at_end) std::swap(here, trial_);
        state.known = true;
        update_mu(state, length, -along / (double(slots_) * mu), final);
        return solved ? Outcome::stepped : Outcome::failed;
    }

    double rate(const State& state) override { return rates_.rate(state.x); }

private:
    int uavs() const { return UAVS ? UAVS : count_; }
    int size() const { return 3 * uavs(); }

    double peak_margin(double power, int u, int side) const {
        return side ? 1.0 - power / p_.peaks[u] : power;
    }

    // The differences of every NormLimit, of a path from start to goal or of a change of it.
    void differences(const double* x, bool ends, std::vector<Reals>& found) {
        const std::size_t width = 2 * uavs();
        const double* zeros = zeros_.data();
        moves_.resize((slots_ + 1) * width);
        const double* before = ends ? p_.starts.data() : zeros;
        double* move = moves_.data();
        for (std::size_t u = 0; u < width; ++u)
            move[u] = x[u / 2 * 3 + 1 + u % 2] - before[u];
        for (std::size_t n = 1; n < slots_; ++n) {
            move += width;
            const double *here = x + n * size(), *last = here - size();
            for (int u = 0; u < uavs(); ++u) {
                move[2 * u] = here[3 * u + 1] - last[3 * u + 1];
                move[2 * u + 1] = here[3 * u + 2] - last[3 * u + 2];
            }
        }
        const double* last = x + (slots_ - 1) * size();
        const double* after = ends ? p_.goals.data() : zeros;
        move += width;
        for (std::size_t u = 0; u < width; ++u)
            move[u] = after[u] - last[u / 2 * 3 + 1 + u % 2];
        found.resize(p_.norms.size());
        for (std::size_t l = 0; l < p_.norms.size(); ++l) {
            const NormLimit& limit = p_.norms[l];
            Reals& d = found[l];
            if (limit.order == 1) {
                d = moves_;
                continue;
            }
            const std::size_t inner = slots_ * width;
            const double* outer = ends ? limit.end_moves.data() : zeros;
            d.resize(inner + 2 * width);
            for (std::size_t u = 0; u < width; ++u) d[u] = moves_[u] - outer[u];
            for (std::size_t i = 0; i < inner; ++i) d[width + i] = moves_[width + i] - moves_[i];
            for (std::size_t u = 0; u < width; ++u)
                d[inner + width + u] = outer[width + u] - moves_[inner + u];
        }
    }

    // The points of flights from start to goal, or of a change of them, (N + 2, U, 2).
    void follow_path(const double* x, bool ends) {
        const std::size_t width = 2 * uavs();
        path_.assign((slots_ + 2) * width, 0.0);
        if (ends) {
            std::copy(p_.starts.begin(), p_.starts.end(), path_.begin());
            std::copy(p_.goals.begin(), p_.goals.end(), path_.end() - width);
        }
        for (std::size_t i = 0; i < slots_ * uavs(); ++i) {
            path_[width + 2 * i] = x[3 * i + 1];
            path_[width + 2 * i + 1] = x[3 * i + 2];
        }
    }

    // Choose the lines for a step, with their c.
    void choose_lines(const double* x, Evaluation& found) {
        follow_path(x, true);
        found.line_margins.resize(p_.lines.size());
        for (std::size_t l = 0; l < p_.lines.size(); ++l) {
            p_.lines[l]->choose(path_.data(), uavs(), lines_[l]);
            p_.lines[l]->margins(lines_[l], path_.data(), uavs(), found.line_margins[l]);
        }
    }

    // Find the value with the terms of lines.
    void add_lines(double mu, Evaluation& found) const {
        LogSum lines;
        for (const Reals& margins : found.line_margins)
            for (const double margin : margins) lines.add(margin);
        const double value = found.without_lines - mu * lines.total();
        found.value = std::isfinite(value) ? value : INFINITE;
    }

    // The c of all limits but the peaks and lines, from the differences of an evaluation.
    void margins(const double* x, Evaluation& found) const {
        const int U = uavs();
        found.norm_margins.resize(p_.norms.size());
        for (std::size_t l = 0; l < p_.norms.size(); ++l) {
            const NormLimit& limit = p_.norms[l];
            const Reals& d = found.differences[l];
            Reals& c = found.norm_margins[l];
            c.resize(d.size() / 2);
            for (std::size_t m = 0; m < c.size() / U; ++m)
                for (int u = 0; u < U; ++u) {
                    const std::size_t i = m * U + u;
                    c[i] = limit.ignored[i] ? 1.0
                        : 1.0 - (d[2 * i] * d[2 * i] + d[2 * i + 1] * d[2 * i + 1])
                                / limit.square[u];
                }
        }
        found.mean_margins.assign(U, 0.0);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) found.mean_margins[u] += x[(n * U + u) * 3];
        for (double& sum : found.mean_margins) sum = 1.0 - sum / double(slots_);
    }

    void evaluate(const double* x, double mu, Evaluation& found) {
        const int U = uavs();
        double value = rates_.evaluate(x, mu, found);
        differences(x, true, found.differences);
        margins(x, found);
        LogSum limits;
        for (const Reals& margins : found.norm_margins)
            for (const double margin : margins) limits.add(margin);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u)
                for (int side = 0; side < 2; ++side)
                    limits.add(peak_margin(x[(n * U + u) * 3], u, side));
        value -= mu * limits.total();
        for (const double margin : found.mean_margins)
            value -= double(slots_) * mu * std::log(margin);
        found.without_lines = value;
        if (!p_.lines.empty()) follow_path(x, true);
        found.line_margins.resize(p_.lines.size());
        for (std::size_t l = 0; l < p_.lines.size(); ++l)
            p_.lines[l]->margins(lines_[l], path_.data(), uavs(), found.line_margins[l]);
        add_lines(mu, found);
    }

    void fix(double* change) const {
        const int U = uavs();
        for (int u = 0; u < U; ++u)
            if (p_.fixed[u])
                for (std::size_t n = 0; n < slots_; ++n)
                    change[(n * U + u) * 3 + 1] = change[(n * U + u) * 3 + 2] = 0.0;
    }

    // A NormLimit's difference m has these weights of the points m - 1 + order - 1 ... in order.
    static const double* stencil(int order) {
        static const double first[] = {-1.0, 1.0}, second[] = {1.0, -2.0, 1.0};
        return order == 1 ? first : second;
    }

    void add_gradient_of_limits(const double* x, const Evaluation& here, double mu) {
        const int U = uavs(), V = size();
        for (std::size_t l = 0; l < p_.norms.size(); ++l) {
            const NormLimit& limit = p_.norms[l];
            const double* weights = stencil(limit.order);
            const Reals& d = here.differences[l];
            const Reals& c = here.norm_margins[l];
            const std::ptrdiff_t count = slots_ + limit.order;
            for (std::ptrdiff_t m = 0; m < count; ++m)
                for (int u = 0; u < U; ++u) {
                    const std::size_t i = m * U + u;
                    if (limit.ignored[i]) continue;
                    const double force = mu / c[i] * (2.0 / limit.square[u]);
                    for (int place = 0; place <= limit.order; ++place) {
                        const std::ptrdiff_t n = m + place - limit.order;
                        if (n < 0 || n >= std::ptrdiff_t(slots_)) continue;
                        double* at = &gradient_[n * V + 3 * u + 1];
                        at[0] += weights[place] * force * d[2 * i];
                        at[1] += weights[place] * force * d[2 * i + 1];
                    }
                }
        }
        for (std::size_t l = 0; l < p_.lines.size(); ++l)
            p_.lines[l]->add_gradient(lines_[l], here.line_margins[l], mu, gradient_.data(), U);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const double power = x[(n * U + u) * 3];
                gradient_[n * V + 3 * u] += mu / here.mean_margins[u]  // (N mu / c) / N
                    - mu / power + mu / peak_margin(power, u, 1) / p_.peaks[u];
            }
    }

    // Put the Hessian with the limits' parts into the band; see newton.BandMatrix.
    void assemble(const State& state, const Evaluation& here) {
        const int U = uavs(), V = size(), height = below_ + 1;
        std::fill(band_.begin(), band_.end(), 0.0);
        for (std::size_t n = 0; n < slots_; ++n) {
            double* hessian = &hessian_[n * V * V];
            for (int u = 0; u < U; ++u)
                if (p_.fixed[u])
                    for (int axis = 3 * u + 1; axis < 3 * u + 3; ++axis) {
                        std::fill(hessian + axis * V, hessian + axis * V + V, 0.0);
                        for (int i = axis; i < V; ++i) hessian[i * V + axis] = 0.0;
                    }
            add_block(n, hessian);
            for (int u = 0; u < U; ++u) {
                const double power = state.x[(n * U + u) * 3];
                const double* dual = &state.peak_duals[(n * U + u) * 2];
                double* at = &band_[(n * V + 3 * u) * height];
                at[0] += dual[0] / power
                    + dual[1] / peak_margin(power, u, 1) / (p_.peaks[u] * p_.peaks[u]);
                if (p_.fixed[u]) at[height] = at[2 * height] = 1.0;
            }
        }
        for (std::size_t l = 0; l < p_.norms.size(); ++l) add_norm(l, state, here);
        for (std::size_t l = 0; l < p_.lines.size(); ++l)
            p_.lines[l]->add_curvature(lines_[l], here.line_margins[l], state.line_duals[l],
                                       band_.data(), height, U);
    }

    void add_block(std::size_t n, const double* block) {
        const int V = size(), height = below_ + 1;
        for (int j = 0; j < V; ++j)
            for (int i = j; i < V; ++i) band_[(n * V + j) * height + i - j] += block[i * V + j];
    }

    void add_norm(std::size_t l, const State& state, const Evaluation& here) {
        const int U = uavs(), V = size(), height = below_ + 1;
        const NormLimit& limit = p_.norms[l];
        const double* weights = stencil(limit.order);
        const std::ptrdiff_t count = slots_ + limit.order, slots = slots_;
        for (std::ptrdiff_t m = 0; m < count; ++m)
            for (int u = 0; u < U; ++u) {
                const std::size_t i = m * U + u;
                if (limit.ignored[i]) continue;
                const double* d = &here.differences[l][2 * i];
                const double dual = state.norm_duals[l][i], square = limit.square[u];
                const double outer = 4.0 * dual / (here.norm_margins[l][i] * square * square);
                const double even = 2.0 * dual / square;
                const double xx = outer * d[0] * d[0] + even, xy = outer * d[0] * d[1];
                const double yy = outer * d[1] * d[1] + even;
                for (int first = 0; first <= limit.order; ++first) {
                    const std::ptrdiff_t n = m + first - limit.order;
                    if (n < 0) continue;
                    for (int second = first; second <= limit.order; ++second) {
                        const int later = second - first;
                        if (n + later >= slots) break;
                        const double by = weights[first] * weights[second];
                        double* at = &band_[(n * V + 3 * u + 1) * height + later * V];
                        at[0] += by * xx;
                        at[1] += by * xy;
                        if (later) at[height - 1] += by * xy;
                        at[height] += by * yy;
                    }
                }
            }
    }

    // Minus the inverse of the Hessian, made positive, times the gradient; whether it was found.
    bool newton_step(const State& state, const Evaluation& here, const std::atomic<bool>& stop) {
        const int U = uavs(), V = size(), sides = 1 + U;
        const std::size_t columns = slots_ * V;
        if (any_infinite(band_.data(), band_.size()) || !factor_positive(stop)) return false;
        std::fill(right_.begin(), right_.end(), 0.0);
        for (std::size_t i = 0; i < columns; ++i) right_[i * sides] = -gradient_[i];
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u)
                right_[(n * V + 3 * u) * sides + 1 + u] = -1.0 / double(slots_);
        divide_by_lower_factor();
        // Woodbury's formula for the average powers, from what is before the factor's other half.
        double* products = space_.data();
        double* right = products + U * U;
        std::fill(products, right + U, 0.0);
        for (std::size_t i = 0; i < columns; ++i) {
            const double* row = &right_[i * sides];
            const double inverse = factor_[i * (below_ + 1)];
            for (int u = 0; u < U; ++u) {
                const double by = row[1 + u] * inverse;
                right[u] += by * row[0];
                for (int s = 0; s <= u; ++s) products[u * U + s] += by * row[1 + s];
            }
        }
        for (int u = 0; u < U; ++u) {
            for (int s = 0; s < u; ++s) products[s * U + u] = products[u * U + s];
            products[u * U + u] += here.mean_margins[u] / state.mean_duals[u];
        }
        if (!solve_small(products, right, U)) return false;
        for (std::size_t i = 0; i < columns; ++i) {
            const double* row = &right_[i * sides];
            double change = row[0];
            for (int u = 0; u < U; ++u) change -= row[1 + u] * right[u];
            step_[i] = change * factor_[i * (below_ + 1)];
        }
        with_height([this](auto below) {
            divide_by_upper<below.value>(factor_.data(), slots_ * size(), below_, step_.data());
        });
        return !any_infinite(step_.data(), columns);
    }

    // Factor the band after making it positive definite; see newton.BandMatrix._factor.
    bool factor_positive(const std::atomic<bool>& stop) {
        const int V = size(), height = below_ + 1;
        const std::ptrdiff_t slots = slots_;
        std::fill(convex_.begin(), convex_.end(), 0);
        std::ptrdiff_t left = slots;
        for (std::ptrdiff_t j = 0; j < slots * V; ++j) band_[j * height] += FIRST_SHIFT;
        std::ptrdiff_t begin = 0;  // The first column that has changed.
        for (int failures = 0; left; ++failures) {
            if (stop) return false;
            const std::ptrdiff_t failed = factor(begin);
            if (failed < 0) return true;
            std::ptrdiff_t from = 0, to = slots - 1;
            if (failures < ALL_AT_ONCE) {
                const std::ptrdiff_t width =
                    std::ptrdiff_t(1) << std::max(0, failures - ONE_BY_ONE);
                const std::ptrdiff_t near_from = std::max(from, failed / V - width);
                const std::ptrdiff_t near_to = std::min(to, failed / V + width);
                if (!std::all_of(convex_.begin() + near_from, convex_.begin() + near_to + 1,
                                 [](char is) { return is; })) {
                    from = near_from;
                    to = near_to;
                }
            }
            begin = failed;
            for (std::ptrdiff_t n = from; n <= to; ++n) {
                if (convex_[n]) continue;
                convex_[n] = 1;
                --left;
                begin = std::min(begin, n * V);
                negative_part(&hessian_[n * V * V], V, space_.data());
                add_block(n, &hessian_[n * V * V]);
            }
        }
        double scale = 1.0;
        for (std::ptrdiff_t j = 0; j < slots * V; ++j)
            scale = std::max(scale, std::fabs(band_[j * height]));
        for (const double shift : SHIFTS) {
            if (stop) return false;
            if (factor(0) < 0) return true;
            for (std::ptrdiff_t j = 0; j < slots * V; ++j) band_[j * height] += shift * scale;
        }
        return false;
    }

    // Bands of the reaches 1, with separation or without, and 2 have a height that is known when
    // compiling.
    template <typename Function>
    auto with_height(Function function) {
        constexpr int V = 3 * UAVS;
        if (UAVS && below_ == V + 1) return function(std::integral_constant<int, V + 1>());
        if (UAVS && below_ == 2 * V + 1) return function(std::integral_constant<int, 2 * V + 1>());
        if (UAVS > 1 && below_ == 2 * V - 2)
            return function(std::integral_constant<int, (UAVS > 1) ? 2 * V - 2 : 0>());
        return function(std::integral_constant<int, 0>());
    }

    std::ptrdiff_t factor(std::ptrdiff_t from) {
        return with_height([this, from](auto below) {
            return factor_band<below.value>(band_.data(), factor_.data(), slots_ * size(), below_,
                                            from);
        });
    }

    void divide_by_lower_factor() {
        with_height([this](auto below) {
            divide_by_lower<below.value, UAVS ? UAVS + 1 : 0>(
                factor_.data(), slots_ * size(), below_, right_.data(), 1 + uavs());
        });
    }

    // How far every limit lets every UAV go along the step: the least of all and those of flights.
    double reaches(const State& state, const Evaluation& here) {
        const int U = uavs();
        const double share = p_.numbers.boundary;
        double least = 1.0;
        std::fill(flights_.begin(), flights_.end(), 1.0);
        for (std::size_t l = 0; l < p_.norms.size(); ++l) {
            const NormLimit& limit = p_.norms[l];
            const Reals& d = here.differences[l];
            const Reals& by = step_differences_[l];
            for (std::size_t m = 0; m < d.size() / (2 * U); ++m)
                for (int u = 0; u < U; ++u) {
                    const std::size_t i = m * U + u;
                    if (limit.ignored[i]) continue;
                    const double square = limit.square[u];
                    const double bend =
                        (by[2 * i] * by[2 * i] + by[2 * i + 1] * by[2 * i + 1]) / square;
                    const double half =
                        (d[2 * i] * by[2 * i] + d[2 * i + 1] * by[2 * i + 1]) / square;
                    const double room = share * here.norm_margins[l][i];
                    const double most = flights_[u];
                    if ((bend * most + 2.0 * half) * most <= room) continue;
                    const double root = std::sqrt(half * half + bend * room);
                    const double length = half > 0.0 ? room / std::max(root + half, 1e-300)
                                                     : (root - half) / std::max(bend, 1e-300);
                    flights_[u] = std::min(most, length);
                }
        }
        for (std::size_t l = 0; l < p_.lines.size(); ++l)
            p_.lines[l]->longest_step(lines_[l], here.line_margins[l], line_changes_[l],
                                      pieces_moved_[l], share, flights_.data());
        for (const double length : flights_) least = std::min(least, length);
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const double power = state.x[(n * U + u) * 3], change = step_[(n * U + u) * 3];
                stop_at_zero(least, power, change, share);
                stop_at_zero(least, p_.peaks[u] - power, -change, share);
            }
        for (int u = 0; u < U; ++u)
            stop_at_zero(least, here.mean_margins[u], mean_change(u), share);
        return least;
    }

    double mean_change(int u) const {
        const int U = uavs();
        double sum = 0.0;
        for (std::size_t n = 0; n < slots_; ++n) sum += step_[(n * U + u) * 3];
        return -sum / double(slots_);
    }

    // Find where to go along the step; see line_search.py. Whether `trial_` is what is there.
    bool line_search(const State& state, const Evaluation& here, double mu,
                     const std::atomic<bool>& stop, double& length) {
        const Numbers& numbers = p_.numbers;
        const std::size_t variables = gradient_.size();
        const int U = uavs();
        double slope = 0.0;
        for (std::size_t i = 0; i < variables; ++i) slope += step_[i] * gradient_[i];
        const double uniform = reaches(state, here);
        const double enough = here.value + ROUNDING * std::fabs(here.value);
        const double lowest = std::max(1.0 - numbers.boundary, 1.0 / numbers.power_factor);
        for (int trial = 0; trial < numbers.clipped_trials + numbers.uniform_trials; ++trial) {
            if (stop) return false;
            const bool clipped = trial < numbers.clipped_trials;
            const double by = clipped ? std::ldexp(1.0, -trial)
                : uniform * std::ldexp(1.0, numbers.clipped_trials - trial);
            double expected = by * slope;
            if (clipped) {
                expected = 0.0;
                for (std::size_t n = 0; n < slots_; ++n)
                    for (int u = 0; u < U; ++u) {
                        const std::size_t i = (n * U + u) * 3;
                        const double* x = state.x + i;
                        const double most = std::min(
                            x[0] * numbers.power_factor,
                            x[0] + numbers.boundary * (p_.peaks[u] - x[0]));
                        there_[i] = std::min(std::max(x[0] + by * step_[i], x[0] * lowest), most);
                        for (int axis = 1; axis < 3; ++axis)
                            there_[i + axis] = x[axis] + by * step_[i + axis] * flights_[u];
                        for (int j = 0; j < 3; ++j)
                            expected += gradient_[i + j] * (there_[i + j] - x[j]);
                    }
            } else {
                for (std::size_t i = 0; i < variables; ++i)
                    there_[i] = state.x[i] + by * step_[i];
            }
            if (!(expected < 0.0)) continue;
            evaluate(there_.data(), mu, trial_);
            if (trial_.value <= enough + numbers.sufficient_decrease * expected) {
                length = by;
                return true;
            }
        }
        length = 0.0;
        return false;
    }

    // The Newton step of a dual, whose part of the longest step it takes into account.
    double move_of(double dual, double margin, double change, double weight, double& by) const {
        const double move = (weight - dual * change) / margin - dual;
        stop_at_zero(by, dual, move, p_.numbers.boundary);
        return move;
    }

    // Move the duals along with the step, as far as they stay positive.
    void move_duals(State& state, const Evaluation& here, double mu, bool moved) {
        const int U = uavs();
        const double slots = double(slots_);
        double by = 1.0;
        for (std::size_t l = 0; l < p_.norms.size(); ++l) {
            const NormLimit& limit = p_.norms[l];
            const Reals& d = here.differences[l];
            const Reals& change = step_differences_[l];
            for (std::size_t m = 0; m < d.size() / (2 * U); ++m)
                for (int u = 0; u < U; ++u) {
                    const std::size_t i = m * U + u;
                    const double along = limit.ignored[i] ? 0.0
                        : -2.0 / limit.square[u]
                            * (d[2 * i] * change[2 * i] + d[2 * i + 1] * change[2 * i + 1]);
                    const double margin = here.norm_margins[l][i];
                    norm_moves_[l][i] =
                        move_of(state.norm_duals[l][i], margin, along, mu, by);
                }
        }
        for (std::size_t l = 0; l < p_.lines.size(); ++l) {
            line_moves_[l].resize(p_.lines[l]->entries());
            for (std::size_t i = 0; i < line_moves_[l].size(); ++i)
                line_moves_[l][i] = move_of(state.line_duals[l][i], here.line_margins[l][i],
                                            line_changes_[l][i], mu, by);
        }
        for (std::size_t n = 0; n < slots_; ++n)
            for (int u = 0; u < U; ++u) {
                const std::size_t i = n * U + u;
                const double power = state.x[3 * i], change = step_[3 * i];
                for (int side = 0; side < 2; ++side) {
                    const double margin = peak_margin(power, u, side);
                    peak_moves_[2 * i + side] =
                        move_of(state.peak_duals[2 * i + side], margin,
                                side ? -change / p_.peaks[u] : change, mu, by);
                }
            }
        for (int u = 0; u < U; ++u) {
            const double margin = here.mean_margins[u];
            mean_moves_[u] =
                move_of(state.mean_duals[u], margin, mean_change(u), slots * mu, by);
        }
        rates_.find_moves(state, here, step_.data(), by);
        rates_.move(state, by);
        const auto go = [by](Reals& duals, const Reals& moves) {
            for (std::size_t i = 0; i < duals.size(); ++i) duals[i] += by * moves[i];
        };
        for (std::size_t l = 0; l < p_.norms.size(); ++l) go(state.norm_duals[l], norm_moves_[l]);
        for (std::size_t l = 0; l < p_.lines.size(); ++l) go(state.line_duals[l], line_moves_[l]);
        go(state.peak_duals, peak_moves_);
        go(state.mean_duals, mean_moves_);
        clip_duals(state, moved ? trial_ : here, moved ? there_.data() : state.x, mu);
    }

    // Keep the duals near their central values for some margins.
    void clip_duals(State& state, const Evaluation& now, const double* x, double mu) const {
        const int U = uavs();
        const double most = p_.numbers.dual_range;
        const auto clip = [most](double& dual, double target) {
            dual = std::min(std::max(dual, target / most), target * most);
        };
        for (std::size_t l = 0; l < p_.norms.size(); ++l)
            for (std::size_t i = 0; i < state.norm_duals[l].size(); ++i)
                clip(state.norm_duals[l][i], mu / now.norm_margins[l][i]);
        for (std::size_t l = 0; l < p_.lines.size(); ++l)
            for (std::size_t i = 0; i < state.line_duals[l].size(); ++i)
                clip(state.line_duals[l][i], mu / now.line_margins[l][i]);
        for (std::size_t i = 0; i < slots_ * U; ++i)
            for (int side = 0; side < 2; ++side)
                clip(state.peak_duals[2 * i + side],
                     mu / peak_margin(x[3 * i], int(i % U), side));
        for (int u = 0; u < U; ++u)
            clip(state.mean_duals[u], double(slots_) * mu / now.mean_margins[u]);
    }

    // Decide whether the start has finished, and lower its barrier parameter.
    void update_mu(State& state, double length, double decrement, double final) const {
        const Numbers& numbers = p_.numbers;
        const double mu = *state.mu;
        ++state.age;
        const bool stalled = state.age >= numbers.patience || length == 0.0;
        const bool centred = decrement <= numbers.centred * uavs() && length > 0.5;
        const bool still = decrement <= std::max(numbers.still, numbers.negligible / mu);
        *state.finished = mu <= final && (still || stalled);
        if ((centred || stalled) && mu > final) {
            state.age = 0;
            *state.mu = std::max(final, std::min(numbers.mu_factor * mu,
                                                 std::pow(mu, numbers.mu_power)));
            state.known = false;
        }
    }

    const Problem& p_;
    const std::size_t slots_;
    const int count_;
    Rates<UAVS> rates_;
    int below_;  // Rows of the band below its diagonal.
    Evaluation trial_;
    Reals gradient_, step_, there_, hessian_, band_, factor_, right_, space_, flights_;
    Reals zeros_, moves_, path_;
    Reals peak_moves_, mean_moves_;
    std::vector<Reals> step_differences_, norm_moves_;
    // Of every LineLimit: the lines of this step, and its change of c and of duals.
    std::vector<Lines> lines_;
    std::vector<Reals> line_changes_, line_moves_, pieces_moved_;
    std::vector<char> convex_;
};

}  // namespace kernel
