// Bytes that somebody else holds, and numbers taken out of them, little endian, one after the other.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "base/error.hpp"

namespace lidarcodec {

using Bytes = std::span<const std::uint8_t>;

// A number of up to eight bytes at a place that is known to be there.
inline std::uint64_t little_endian(Bytes data, std::size_t at, std::size_t bytes) {
  std::uint64_t value = 0;
  for (std::size_t i = bytes; i-- > 0;) value = value << 8 | data[at + i];
  return value;
}

class ByteReader {
 public:
  // what: names the bytes in errors, for example "weights".
  ByteReader(Bytes data, const char* what) : data_(data), what_(what) {}

  std::size_t at() const { return at_; }
  std::size_t left() const { return data_.size() - at_; }

  // Raises Truncated if there are fewer.
  Bytes take(std::size_t count) {
    if (count > left())
      throw Error(ErrorCode::Truncated, std::string(what_) + " end before what they announce", data_.size());
    at_ += count;
    return data_.subspan(at_ - count, count);
  }
  std::uint64_t number(std::size_t bytes) { return little_endian(take(bytes), 0, bytes); }

 private:
  Bytes data_;
  const char* what_;
  std::size_t at_ = 0;
};

}  // namespace lidarcodec
