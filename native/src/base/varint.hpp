// Whole numbers in as few bytes as they need, 7 bits a byte, the lowest first; in Python lidarcodec/entropy/varint.py.
#pragma once
#include <cstdint>
#include <string>

#include "base/bytes.hpp"

namespace lidarcodec {

class VarintReader {
 public:
  // what: names the bytes in errors, for example "side information".
  VarintReader(Bytes data, const char* what) : data_(data), what_(what) {}

  std::size_t at() const { return at_; }
  std::size_t left() const { return data_.size() - at_; }

  // Raises Truncated.
  std::uint8_t byte() {
    if (left() == 0) ends();
    return data_[at_++];
  }

  // The next number. limit: up to 2^63. Raises Section if it is not from `least` to `limit`, or has more bytes than it
  // needs; Truncated.
  std::uint64_t number(std::uint64_t limit, std::uint64_t least = 0) {
    const std::size_t start = at_;
    std::uint64_t value = 0;
    for (unsigned shift = 0;; shift += 7) {
      const std::uint8_t next = byte();
      const std::uint64_t part = next & 0x7Fu;
      if (shift > 63 || (shift == 63 && part > 1)) beyond(limit, start);
      value |= part << shift;
      if (value > limit) beyond(limit, start);
      if (next >= 0x80) continue;
      if (value < least || (next == 0 && shift > 0))
        throw Error(ErrorCode::Section,
                    std::string(what_) + ": a number below " + std::to_string(least) + ", or longer than needed",
                    start);
      return value;
    }
  }

  // The next number with a sign, zigzag: from -limit to limit.
  std::int64_t signed_number(std::uint64_t limit) {
    const std::uint64_t number_ = number(2 * limit);
    const auto half = static_cast<std::int64_t>(number_ >> 1);
    return (number_ & 1) == 0 ? half : -half - 1;
  }

  // Raises Truncated if there are fewer.
  Bytes take(std::size_t count) {
    if (count > left()) ends();
    at_ += count;
    return data_.subspan(at_ - count, count);
  }
  // As many bytes as the number before them says.
  Bytes sized() { return take(number(left())); }
  Bytes rest() { return take(left()); }

  // Raises Section if there are bytes left.
  void end() const {
    if (left() != 0) throw Error(ErrorCode::Section, std::string("bytes after the end of ") + what_, at_);
  }

 private:
  [[noreturn]] void ends() const { throw Error(ErrorCode::Truncated, std::string(what_) + " ends too early", at_); }
  [[noreturn]] void beyond(std::uint64_t limit, std::size_t start) const {
    throw Error(ErrorCode::Section, std::string(what_) + ": a number over " + std::to_string(limit), start);
  }

  Bytes data_;
  const char* what_;
  std::size_t at_ = 0;
};

}  // namespace lidarcodec
