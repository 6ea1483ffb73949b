// Arrays of numbers.
#pragma once

#include <cstddef>
#include <vector>

namespace kernel {

// Memory of large arrays: a little of what is given back is kept for the next solve. The system
// would clear it first, page by page, which takes as long as several Newton steps.
void* take_memory(std::size_t bytes);
void give_memory(void* block, std::size_t bytes) noexcept;

template <typename T>
struct Memory {
    using value_type = T;
    Memory() = default;
    template <typename Other>
    Memory(const Memory<Other>&) {}
    T* allocate(std::size_t count) { return static_cast<T*>(take_memory(count * sizeof(T))); }
    void deallocate(T* block, std::size_t count) noexcept {
        give_memory(block, count * sizeof(T));
    }
    bool operator==(const Memory&) const { return true; }
    bool operator!=(const Memory&) const { return false; }
};

using Reals = std::vector<double, Memory<double>>;

}  // namespace kernel
