#include "newton.hpp"

namespace kernel {

namespace {

template <int UAVS>
std::unique_ptr<Newton> free_space(const Problem& problem) {
    return std::make_unique<NewtonOf<UAVS, FreeSpace>>(problem);
}

}  // namespace

std::unique_ptr<Newton> make_newton(const Problem& problem) {
    if (!dynamic_cast<const FreeSpace*>(problem.channel.get()))
        return std::make_unique<NewtonOf<0, Channel>>(problem);
    switch (problem.uavs) {
        case 1: return free_space<1>(problem);
        case 2: return free_space<2>(problem);
        case 3: return free_space<3>(problem);
        case 4: return free_space<4>(problem);
        default: return free_space<0>(problem);
    }
}

}  // namespace kernel
