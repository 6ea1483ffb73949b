// Arrays of numbers.
#pragma once

#include <vector>

namespace kernel {

using Reals = std::vector<double>;

}  // namespace kernel
