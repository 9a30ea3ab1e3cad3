// Takes small numbers off the front of a fuzzer's input; the rest is the section under test.
#pragma once
#include <cstddef>
#include <cstdint>
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
