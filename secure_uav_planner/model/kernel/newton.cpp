#include "newton.hpp"

namespace kernel {

namespace {

template <class Model>
std::unique_ptr<Newton> newton_of(const Problem& problem) {
    switch (problem.uavs) {
        case 1: return std::make_unique<NewtonOf<1, Model>>(problem);
        case 2: return std::make_unique<NewtonOf<2, Model>>(problem);
        case 3: return std::make_unique<NewtonOf<3, Model>>(problem);
        case 4: return std::make_unique<NewtonOf<4, Model>>(problem);
        default: return std::make_unique<NewtonOf<0, Model>>(problem);
    }
}

}  // namespace

std::unique_ptr<Newton> make_newton(const Problem& problem) {
    const Channel* channel = problem.channel.get();
    if (dynamic_cast<const FreeSpace*>(channel)) return newton_of<FreeSpace>(problem);
    if (dynamic_cast<const PathLoss*>(channel)) return newton_of<PathLoss>(problem);
    return std::make_unique<NewtonOf<0, Channel>>(problem);
}

}  // namespace kernel
