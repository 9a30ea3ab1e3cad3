// Whole numbers in as few bytes as they need, 7 bits a byte, the lowest first; in Python lidarcodec/entropy/varint.py.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

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

// A number, 7 bits a byte. take_number takes one below 2^32, and raises Section if it has more bytes than it needs, or
// Truncated.
inline void put_number(std::vector<std::uint8_t>& out, std::size_t value) {
  for (; value >= 128; value >>= 7) out.push_back(static_cast<std::uint8_t>(value | 128u));
  out.push_back(static_cast<std::uint8_t>(value));
}

inline std::uint32_t take_number(ByteReader& reader) {
  std::uint64_t value = 0;
  for (unsigned shift = 0; shift < 35; shift += 7) {
    const std::uint64_t byte = reader.number(1);
    value |= (byte & 127u) << shift;
    if (byte < 128 && value >> 32 == 0 && (byte != 0 || shift == 0)) return static_cast<std::uint32_t>(value);
    if (byte < 128) break;
  }
  throw Error(ErrorCode::Section, "a number in the head of planes is too large, or longer than it needs to be",
              reader.at());
}

// The same with a sign, zigzag: 0, -1, 1, -2 are 0, 1, 2, 3.
inline void put_signed(std::vector<std::uint8_t>& out, std::int32_t value) {
  put_number(out, static_cast<std::uint32_t>(value) << 1 ^ static_cast<std::uint32_t>(value >> 31));
}

inline std::int32_t take_signed(ByteReader& reader) {
  const std::uint32_t number = take_number(reader);
  return static_cast<std::int32_t>(number >> 1 ^ (0u - (number & 1u)));
}

}  // namespace lidarcodec
