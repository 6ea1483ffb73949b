// Numbers that the kernel's headers share.
#pragma once

#include <limits>

namespace kernel {

constexpr double TINY = 1e-300;  // What a divisor is at least.
constexpr double INFINITE = std::numeric_limits<double>::infinity();

}  // namespace kernel
