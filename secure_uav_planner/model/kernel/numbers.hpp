// Numbers that the kernel's headers share.
#pragma once

#include <limits>

namespace kernel {

constexpr double TINY = 1e-300;  // Least divisor, so that no quotient of zeros is NaN.
constexpr double INFINITE = std::numeric_limits<double>::infinity();

}  // namespace kernel
