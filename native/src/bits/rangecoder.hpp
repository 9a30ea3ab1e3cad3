// Binary range coder with a range of 32 bits and probabilities of 16 bits. Carries are added to the bytes already
// written.
//
// README.md in this folder derives the invariants, why no carry is lost, and what a decision costs. The encoder ends
// with the fewest bytes that name a number of the last interval when zeros follow them. The decoder therefore knows how
// a stream must end, and refuses one that is cut, longer, or has another end: most damage is found at no cost.
//
// tests/reference/range_coder.py has the same names in the same order, and gives the same bytes.
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
      low_ = renormalised(*out_, low_);
      range_ <<= 8;
    }
  }

  // The `count` low bits of `value`, highest first, each with the probability 1/2.
  void encode_bits(std::uint64_t value, int count) {
    while (count-- > 0) encode((value >> count) & 1u, 1u << (kProbabilityBits - 1));
  }

  // Ends the stream. Nothing may be encoded after it.
  void finish() {
    low_ = with_carry(*out_, low_);
    if (low_ == 0) return;
    if (low_ + range_ > 0x100000000u) {
      with_carry(*out_, 0x100000000u);
    } else {
      out_->push_back(static_cast<std::uint8_t>((low_ + kRangeTop - 1) >> 24));
    }
  }

 private:
  // Adds the carry, if any, to the bytes; gives the rest of `low`. The interval lies below 1, so a byte below 255
  // exists.
  static std::uint64_t with_carry(std::vector<std::uint8_t>& out, std::uint64_t low) {
    if (low >> 32 == 0) return low;
    std::size_t at = out.size();
    while (++out[--at] == 0) {
    }
    return low & 0xFFFFFFFFu;
  }

  // Writes the upper byte of `low`; gives `low` in the moved window. Not inlined, so that coding loops have more
  // registers.
  [[gnu::noinline]] static std::uint64_t renormalised(std::vector<std::uint8_t>& out, std::uint64_t low) {
    low = with_carry(out, low);
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

  // Raises Truncated if it needs more zeros after the end than an encoder leaves out.
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
    if (size_ == moved)
      return;  // the four bytes of the window are zeros after the end: any interval with a 0 in it may end so
    const std::uint32_t low = window_ - code_;
    const bool needed = low != 0 && static_cast<std::uint64_t>(low) + range_ <= 0x100000000u;
    if (!needed || code_ >= kRangeTop) {
      throw Error(ErrorCode::Section, "the end of a range coded stream does not fit its decisions", moved);
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
  std::size_t read_ = 0;  // with the zeros after the end
  std::uint32_t window_ = 0;
  std::uint32_t code_ = 0;
  std::uint32_t range_ = kRangeStart;
};

// A model is written once for both directions: `bit(value, p)` encodes the value and returns it, or returns a decoded
// one.
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
