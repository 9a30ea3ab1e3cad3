// Binary range coder: 32-bit range, carry resolved in the bytes already written, 16-bit probabilities.
//
// The code value is a number in [0, 1) written byte by byte. `low` and `range` hold the interval of all values that
// begin like the decisions so far, seen through a window of 32 bits; range stays above 2^24 by moving the window on a
// byte at a time. The encoder ends with the fewest bytes that name a value of the last interval (at most one more than
// the window has moved on), zeros understood after them. The decoder therefore knows where a stream must end, and
// refuses one that is cut, longer, or ends in any other value: most damage is noticed at no cost.
//
// Same names and same order as tests/reference/range_coder.py, which gives the same bytes.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/error.hpp"

namespace lidarcodec {

inline constexpr std::uint32_t kRangeTop = 1u << 24;
inline constexpr std::uint32_t kRangeStart = 0xFFFFFFFFu;
// A probability is that of a one, in steps of 2^-16: 1 to 65535.
inline constexpr int kProbabilityBits = 16;

class RangeEncoder {
 public:
  // Appends to `out`, which must outlive the encoder; bytes already there are never touched.
  explicit RangeEncoder(std::vector<std::uint8_t>& out) : out_(&out) {}

  void encode(bool bit, std::uint32_t probability) {
    const auto bound =
        static_cast<std::uint32_t>((static_cast<std::uint64_t>(range_) * probability) >> kProbabilityBits);
    if (bit) {
      range_ = bound;
    } else {
      low_ += bound;
      range_ -= bound;
    }
    while (range_ < kRangeTop) {
      low_ = moved_on(*out_, low_);
      range_ <<= 8;
    }
  }

  // The `count` low bits of `value`, highest first, each as likely one as zero.
  void encode_bits(std::uint64_t value, int count) {
    while (count-- > 0) encode((value >> count) & 1u, 1u << (kProbabilityBits - 1));
  }

  // Ends the stream. Nothing may be encoded after it.
  void finish() {
    low_ = carried(*out_, low_);
    if (low_ == 0) return;
    if (low_ + range_ > 0x100000000u) {
      carried(*out_, 0x100000000u);
    } else {
      out_->push_back(static_cast<std::uint8_t>((low_ + kRangeTop - 1) >> 24));
    }
  }

 private:
  // The value is below 1, so there is always a byte that takes the carry.
  static std::uint64_t carried(std::vector<std::uint8_t>& out, std::uint64_t low) {
    if (low >> 32 == 0) return low;
    std::size_t at = out.size();
    while (++out[--at] == 0) {
    }
    return low & 0xFFFFFFFFu;
  }

  // Writes a byte. Apart, and without the rest of the coder, so that loops that code have registers for what they need more often.
  [[gnu::noinline]] static std::uint64_t moved_on(std::vector<std::uint8_t>& out, std::uint64_t low) {
    low = carried(out, low);
    out.push_back(static_cast<std::uint8_t>(low >> 24));
    return (low << 8) & 0xFFFFFFFFu;
  }

  std::vector<std::uint8_t>* out_;
  std::uint64_t low_ = 0;
  std::uint32_t range_ = kRangeStart;
};

class RangeDecoder {
 public:
  // Reads `size` bytes, never one more; raises Section if no encoder can have written the first four.
  RangeDecoder(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {
    for (int i = 0; i < 4; ++i) next();
    code_ = window_;
    if (code_ == kRangeStart)
      throw Error(ErrorCode::Section, "a range coded stream cannot begin with four bytes of 255");
  }

  // Raises Truncated as soon as more bytes are needed than an encoder leaves out.
  bool decode(std::uint32_t probability) {
    const auto bound =
        static_cast<std::uint32_t>((static_cast<std::uint64_t>(range_) * probability) >> kProbabilityBits);
    const bool bit = code_ < bound;
    if (bit) {
      range_ = bound;
    } else {
      code_ -= bound;
      range_ -= bound;
    }
    while (range_ < kRangeTop) {
      code_ = code_ << 8 | next();
      range_ <<= 8;
    }
    return bit;
  }

  std::uint64_t decode_bits(int count) {
    std::uint64_t value = 0;
    while (count-- > 0) value = value << 1 | static_cast<std::uint64_t>(decode(1u << (kProbabilityBits - 1)));
    return value;
  }

  // Raises Section unless the stream ends here, in the bytes that `RangeEncoder::finish` writes.
  void finish() const {
    const std::size_t moved = read_ - 4;
    if (size_ > moved + 1) throw Error(ErrorCode::Section, "bytes after the end of a range coded stream", moved + 1);
    if (size_ == moved) return;  // the four bytes of the window are understood zeros: nothing to choose
    const std::uint32_t low = window_ - code_;
    const bool needed = low != 0 && static_cast<std::uint64_t>(low) + range_ <= 0x100000000u;
    if (!needed || code_ >= kRangeTop) {
      throw Error(ErrorCode::Section, "a range coded stream does not end as its decisions say", moved);
    }
  }

 private:
  std::uint32_t next() {
    std::uint32_t byte = 0;
    if (read_ < size_) {
      byte = data_[read_];
    } else if (read_ >= size_ + 4) {
      end_too_early(size_);
    }
    ++read_;
    window_ = window_ << 8 | byte;
    return byte;
  }

  [[noreturn, gnu::noinline]] static void end_too_early(std::size_t size) {
    throw Error(ErrorCode::Truncated, "a range coded stream ends too early", size);
  }

  const std::uint8_t* data_;
  std::size_t size_;
  std::size_t read_ = 0;  // understood zeros included
  std::uint32_t window_ = 0;
  std::uint32_t code_ = 0;
  std::uint32_t range_ = kRangeStart;
};

// One way to write a model for both directions: `bit(value, p)` encodes value and returns it, or decodes and returns.
class BitWriter {
 public:
  static constexpr bool kReads = false;
  explicit BitWriter(std::vector<std::uint8_t>& out) : coder_(out) {}
  bool bit(bool value, std::uint32_t probability) {
    coder_.encode(value, probability);
    return value;
  }
  std::uint64_t bits(std::uint64_t value, int count) {
    coder_.encode_bits(value, count);
    return value;
  }
  void finish() { coder_.finish(); }

 private:
  RangeEncoder coder_;
};

class BitReader {
 public:
  static constexpr bool kReads = true;
  BitReader(const std::uint8_t* data, std::size_t size) : coder_(data, size) {}
  bool bit(bool, std::uint32_t probability) { return coder_.decode(probability); }
  std::uint64_t bits(std::uint64_t, int count) { return coder_.decode_bits(count); }
  void finish() { coder_.finish(); }

 private:
  RangeDecoder coder_;
};

}  // namespace lidarcodec
