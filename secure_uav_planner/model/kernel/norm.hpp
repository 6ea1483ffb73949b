// Limits on the length of differences of a UAV's points: speed and acceleration.
#pragma once

#include "limit.hpp"

namespace kernel {

// c = 1 - |d|^2 / r^2; a d that is ignored has c = 1.
//
// Of order 1, d is the move from a point to the next; of order 2 the difference of one move and
// the next, where moves before the start and after the goal are given.
class NormLimit : public Limit {
public:
    // The squares r^2 are (U), what is ignored (N + order, U), and the outer moves (2, U, 2).
    NormLimit(std::size_t slots, int order, const Reals& squares, std::vector<char> ignored,
              Reals outer_moves);

    std::size_t count() const override { return ignored_.size(); }
    int bandwidth() const override { return order_ * 3 * uavs_ + 1; }
    void find_slacks(const double* path, Terms& found) const override;
    void add_gradient(const Terms& here, double mu, double* gradient) const override;
    void find_slopes(const Terms& here, const double* moves, Slopes& found) const override;
    void shorten(const Terms& here, const Slopes& step, double share,
                 double* longest) const override;
    void add_curvature(const Terms& here, const Reals& duals, const Band& band) const override;

private:
    void differences(const double* path, const double* outer, Reals& found) const;
    const double* stencil() const;

    const int order_;
    Reals squares_;  // Of every d, as in ignored_.
    std::vector<char> ignored_;
    Reals outer_moves_, still_;
};

}  // namespace kernel
