// Numbers of a few bits out of bytes, the lowest bits first, as pco packs them.
#pragma once
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "base/error.hpp"

namespace lidarcodec {

class BitReader {
 public:
  BitReader(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}

  // The next 57 bits or more, so many bits further on, without moving on. Zeros behind the last byte; or, where the
  // caller knows that eight bytes are there (Inside), without a look at it.
  template <bool Inside = false>
  std::uint64_t peek(std::size_t further = 0) const {
    const std::size_t at = at_ + further, byte = at >> 3;
    std::uint64_t word = 0;
    if (Inside || byte + sizeof(word) <= size_) {
      std::memcpy(&word, data_ + byte, sizeof(word));
      if constexpr (std::endian::native == std::endian::big) word = __builtin_bswap64(word);
    } else {
      for (std::size_t i = 0; byte + i < size_; ++i) word |= std::uint64_t{data_[byte + i]} << (8 * i);
    }
    return word >> (at & 7);
  }
  void skip(std::size_t bits) { at_ += bits; }

  // bits: 0 to 32. The caller checks now and then that it is not beyond the end.
  std::uint32_t take(unsigned bits) {
    const std::uint64_t found = peek() & ((std::uint64_t{1} << bits) - 1);
    skip(bits);
    return static_cast<std::uint32_t>(found);
  }

  // Raises Truncated if more was read than there is.
  void check() const {
    if (at_ > 8 * size_) throw Error(ErrorCode::Truncated, "pco data ends within what it announces", size_);
  }

  // Moves on to the next whole byte. Raises Truncated; Section if the bits between are not zeros.
  void align() {
    check();
    const unsigned over = static_cast<unsigned>(-at_ & 7);
    if (take(over) != 0) throw Error(ErrorCode::Section, "pco data with bits between its parts", at_ >> 3);
  }

  std::size_t bytes_read() const { return at_ >> 3; }  // of an aligned reader
  std::size_t bytes_left() const { return at_ > 8 * size_ ? 0 : size_ - (at_ >> 3); }

 private:
  const std::uint8_t* data_;
  std::size_t size_;
  std::size_t at_ = 0;  // bits
};

}  // namespace lidarcodec
