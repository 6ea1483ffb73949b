// The energies of flights with a limit of acceleration, by Simpson's rule in each slot.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "vectors.hpp"

namespace kernel {

// Numbers of a rotary wing's power, each multiplied by the length of a slot and divided by the
// limit of the energy. With the square s of a move's length, the power is
// blade_slope s + induced / sqrt(sqrt(1 + r^2) + r) + drag s^1.5, r = induced_slope s.
struct PowerTerms {
    double blade_slope, induced, induced_slope, drag;

    double value(double s) const {
        const double r = induced_slope * s;
        return blade_slope * s + induced / std::sqrt(std::sqrt(1.0 + r * r) + r)
            + drag * s * std::sqrt(s);
    }
    // The first derivative of the power by s, the square of a move's length.
    double first(double s) const {
        const double r = induced_slope * s, root = std::sqrt(1.0 + r * r);
        return blade_slope - 0.5 * induced * induced_slope / (root * std::sqrt(root + r))
            + 1.5 * drag * std::sqrt(s);
    }
    // s times the second derivative of the power by s, the square of a move's length; finite at 0.
    double scaled_second(double s) const {
        const double r = induced_slope * s, square = 1.0 + r * r, root = std::sqrt(square);
        return induced * induced_slope * r / std::sqrt(root + r)
            * (0.25 / square + 0.5 * r / (square * root)) + 0.75 * drag * std::sqrt(s);
    }
};

// The energies of all UAVs, each as a share of its limit.
class Energies {
public:
    // `moves` (U, S): S differences of positions for each UAV. `weights` (U, S): weights of the
    // moves. `terms` (U): power curve of each UAV. `constants` (U): constant part of each energy.
    Energies(Vectors moves, Reals weights, std::vector<PowerTerms> terms, Reals constants)
        : moves_(std::move(moves)), weights_(std::move(weights)), terms_(std::move(terms)),
          constants_(std::move(constants)) {}

    const Vectors& moves() const { return moves_; }

    // Fill `energies`, (U), of the UAVs on a path, (M, U, 2), as shares of their limits: a UAV's
    // constant plus the sum of weight * power(|move|^2) over its S moves. These are the moves of
    // Simpson's rule: from point to point, and means of two successive ones (limits/energy.py).
    void compute_energies(const double* path, Reals& energies) const {
        energies = constants_;
        visit(path, [&](std::size_t i, Point move, std::size_t uav) {
            energies[uav] += weights_[i] * terms_[uav].value(dot(move, move));
        });
    }

    // Add to `gradient`, (N, U, 3), the gradient of each UAV's energy by its own variables, the
    // only ones that change it. By a move it is 2 weight power'(s) move, with s = |move|^2.
    void add_gradient(const double* path, double* gradient) const {
        visit(path, [&](std::size_t i, Point move, std::size_t uav) {
            const double slope = 2.0 * weights_[i] * terms_[uav].first(dot(move, move));
            moves_.add_gradient(i, slope * move, gradient);
        });
    }

    // Add to the band the Hessians of the energies times their duals, (U). By a move, the Hessian
    // of power(s), s = |move|^2, has the eigenvalue 2 power' across the move and 2 power' + 4 s
    // power'' along it. Negative eigenvalues are replaced by 0.
    void add_curvature(const double* path, const Reals& duals, const Band& band) const {
        visit(path, [&](std::size_t i, Point move, std::size_t uav) {
            const PowerTerms& terms = terms_[uav];
            const double s = dot(move, move), weight = weights_[i] * duals[uav];
            const double across = std::max(0.0, 2.0 * terms.first(s));
            const double along = std::max(0.0, 2.0 * terms.first(s) + 4.0 * terms.scaled_second(s));
            const double excess = s > 0.0 ? weight * (along - across) / s : 0.0;
            moves_.add_curvature(i, weight * across + excess * move.x * move.x,
                                 excess * move.x * move.y,
                                 weight * across + excess * move.y * move.y, band);
        });
    }

private:
    // Call function(i, move, uav) for every move i on a path; moves are sorted by UAV.
    template <typename Function>
    void visit(const double* path, Function function) const {
        std::vector<Point> moves;
        moves_.compute_vectors(path, false, moves);
        const std::size_t moves_of_uav = moves.size() / terms_.size();
        for (std::size_t i = 0; i < moves.size(); ++i)
            function(i, moves[i], i / moves_of_uav);
    }

    const Vectors moves_;
    const Reals weights_;
    const std::vector<PowerTerms> terms_;
    const Reals constants_;
};

}  // namespace kernel
