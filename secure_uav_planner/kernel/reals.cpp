#include "reals.hpp"

#include <mutex>
#include <new>

namespace kernel {

namespace {

constexpr std::size_t LARGE = std::size_t(1) << 16, MOST_KEPT = std::size_t(1) << 25;  // Bytes.

// Blocks that wait to be used again, the oldest first.
class Kept {
public:
    void* take(std::size_t bytes) {
        const std::lock_guard<std::mutex> lock(mutex_);
        for (std::size_t i = blocks_.size(); i-- > 0;)
            if (blocks_[i].bytes == bytes) return remove(i);
        return nullptr;
    }
    // Whether it is kept.
    bool give(void* block, std::size_t bytes) noexcept {
        if (bytes > MOST_KEPT) return false;
        const std::lock_guard<std::mutex> lock(mutex_);
        try {
            blocks_.push_back({block, bytes});
        } catch (const std::bad_alloc&) {
            return false;
        }
        bytes_ += bytes;
        while (bytes_ > MOST_KEPT) ::operator delete(remove(0));
        return true;
    }

private:
    struct Block {
        void* start;
        std::size_t bytes;
    };
    void* remove(std::size_t index) {
        const Block block = blocks_[index];
        blocks_.erase(blocks_.begin() + std::ptrdiff_t(index));
        bytes_ -= block.bytes;
        return block.start;
    }
    std::mutex mutex_;
    std::vector<Block> blocks_;
    std::size_t bytes_ = 0;
};

Kept& kept() {
    static Kept* blocks = new Kept;  // Never destroyed: arrays may live until the very end.
    return *blocks;
}

}  // namespace

void* take_memory(std::size_t bytes) {
    void* block = bytes < LARGE ? nullptr : kept().take(bytes);
    return block ? block : ::operator new(bytes);
}

void give_memory(void* block, std::size_t bytes) noexcept {
    if (bytes < LARGE || !kept().give(block, bytes)) ::operator delete(block);
}

}  // namespace kernel
