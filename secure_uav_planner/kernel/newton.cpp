#include "newton.hpp"

namespace kernel {

std::unique_ptr<Newton> make_newton(const Problem& problem) {
    switch (problem.uavs) {
        case 1: return std::make_unique<NewtonOf<1>>(problem);
        case 2: return std::make_unique<NewtonOf<2>>(problem);
        case 3: return std::make_unique<NewtonOf<3>>(problem);
        case 4: return std::make_unique<NewtonOf<4>>(problem);
        default: return std::make_unique<NewtonOf<0>>(problem);
    }
}

}  // namespace kernel
