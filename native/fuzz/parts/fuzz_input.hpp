// Takes small numbers off the front of a fuzzer's input; the rest is the section under test.
#pragma once
#include <bit>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

class FuzzInput {
 public:
  FuzzInput(const std::uint8_t* data, std::size_t size) : data_(data), end_(data + size) {}

  std::uint8_t byte() { return data_ < end_ ? *data_++ : std::uint8_t{0}; }

  // 0 to limit - 1, limit up to 65536.
  std::uint32_t below(std::uint32_t limit) {
    const std::uint32_t high = byte();
    return (high << 8 | byte()) % limit;
  }

  std::vector<std::uint8_t> rest() const { return {data_, end_}; }

 private:
  const std::uint8_t* data_;
  const std::uint8_t* end_;
};

// Numbers out of what is left of the input, over and over.
class Numbers {
 public:
  explicit Numbers(std::vector<std::uint8_t> bytes) : bytes_(std::move(bytes)) {
    if (bytes_.empty()) bytes_.push_back(0);
  }

  std::uint32_t next(unsigned count) {
    std::uint32_t value = 0;
    for (unsigned i = 0; i < count; ++i) value = value << 8 | bytes_[at_++ % bytes_.size()];
    return value;
  }

  // Any float at all, infinite ones and those that are no number too.
  float any() { return std::bit_cast<float>(next(4)); }

 private:
  std::vector<std::uint8_t> bytes_;
  std::size_t at_ = 0;
};
