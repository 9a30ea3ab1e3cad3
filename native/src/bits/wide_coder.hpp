// Binary range coder for hot loops, with a window of 64 bits that moves by four bytes, and probabilities of 15 bits.
//
// A decision takes a multiplication, a comparison and two conditional moves. The window moves once in about forty
// decisions. So one core can run several of these coders at once, one for each stream, and they do not wait for each
// other or for mispredicted branches. README.md in this folder derives the invariants. The end of a stream is as in
// bits/rangecoder.hpp, of up to four bytes.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/error.hpp"

namespace lidarcodec {

// A probability is that of a one, in steps of 2^-15: 1 to 32767.
inline constexpr int kWideProbabilityBits = 15;
inline constexpr std::uint64_t kWideMove = std::uint64_t{1} << 32;  // the window moves when the range falls below

// The end of a stream whose last interval is [low, low + range), modulo 2^64: the number with the fewest bytes, highest
// first.
struct WideEnd {
  std::uint64_t value;
  std::size_t bytes;  // 0 to 4 are written, the others are 0
  bool carries;       // the number lies beyond the window

  WideEnd(std::uint64_t low, std::uint64_t range) : value(low), bytes(0), carries(false) {
    for (;; ++bytes) {
      const std::uint64_t below = bytes == 0 ? ~std::uint64_t{0} : (std::uint64_t{1} << (64 - 8 * bytes)) - 1;
      value = (low + below) & ~below;
      if (value - low < range) break;
    }
    carries = value < low;
  }
};

// The part of a coder that changes with every decision. Callers hold it, so that it stays in registers.
struct WideInterval {
  std::uint64_t at = 0;  // encoder: lower end of the interval; decoder: how far the code lies above that
  std::uint64_t range = ~std::uint64_t{0};
};

class WideEncoder {
 public:
  // A one or a zero, 0 or 1. `make_room` comes first.
  void encode(WideInterval& interval, std::uint32_t bit, std::uint32_t probability) {
    const std::uint64_t bound = (interval.range >> kWideProbabilityBits) * probability;
    std::uint64_t zero = std::uint64_t{bit} - 1;  // a mask, because a branch would often be mispredicted
    asm("" : "+r"(zero));                         // and compilers that know what it is make a branch of it
    const std::uint64_t skipped = bound & zero;
    interval.at += skipped;
    if (interval.at < skipped) [[unlikely]]
      carry();
    interval.range = bound + ((interval.range - 2 * bound) & zero);
    if (interval.range < kWideMove) [[unlikely]] {
      push(interval.at, 4);
      interval.at <<= 32;
      interval.range <<= 32;
    }
  }

  // `bits` equally likely bits, 0 to 16 of them; takes as much room as three decisions. `make_room` comes first.
  void encode_plain(WideInterval& interval, std::uint32_t value, std::uint32_t bits) {
    interval.range >>= bits;
    const std::uint64_t skipped = interval.range * value;
    interval.at += skipped;
    if (interval.at < skipped) [[unlikely]]
      carry();
    if (interval.range < kWideMove) {
      push(interval.at, 4);
      interval.at <<= 32;
      interval.range <<= 32;
    }
  }

  // Allocates memory for so many more decisions.
  void make_room(std::size_t decisions) { out_.resize(written_ + 2 * decisions + 8); }

  // The bytes of all decisions. Nothing may be encoded after it.
  const std::vector<std::uint8_t>& finish(const WideInterval& interval) {
    const WideEnd end(interval.at, interval.range);
    if (end.carries) carry();
    make_room(0);
    push(end.value, end.bytes);
    out_.resize(written_);
    return out_;
  }

 private:
  void push(std::uint64_t value, std::size_t bytes) {
    for (std::size_t i = 0; i < bytes; ++i) out_[written_++] = static_cast<std::uint8_t>(value >> (56 - 8 * i));
  }

  // The interval lies below 1, so a byte below 255 exists.
  void carry() {
    std::size_t at = written_;
    while (++out_[--at] == 0) {
    }
  }

  std::vector<std::uint8_t> out_;
  std::size_t written_ = 0;
};

class WideDecoder {
 public:
  WideDecoder() = default;  // of an empty stream

  // Reads `size` bytes, never one more.
  WideDecoder(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}

  // Raises Section if no encoder can have written the first eight bytes.
  WideInterval start() {
    WideInterval interval;
    interval.at = static_cast<std::uint64_t>(next()) << 32;
    interval.at |= next();
    if (interval.at == ~std::uint64_t{0})
      throw Error(ErrorCode::Section, "a coded stream cannot begin with eight bytes of 255");
    return interval;
  }

  // Raises Truncated if it needs more zeros after the end than an encoder leaves out.
  std::uint32_t decode(WideInterval& interval, std::uint32_t probability) {
    const std::uint64_t bound = (interval.range >> kWideProbabilityBits) * probability;
    const bool bit = split(interval, bound);
    if (interval.range < kWideMove) [[unlikely]] {
      interval.at = interval.at << 32 | next();
      interval.range <<= 32;
    }
    return bit;
  }

  // Raises Truncated as `decode` does, and Section if no encoder can have written the value.
  std::uint32_t decode_plain(WideInterval& interval, std::uint32_t bits) {
    interval.range >>= bits;
    const std::uint64_t value = interval.at / interval.range;
    if (value >> bits != 0) throw Error(ErrorCode::Section, "a coded stream has a value beyond its interval");
    interval.at -= value * interval.range;
    if (interval.range < kWideMove) {
      interval.at = interval.at << 32 | next();
      interval.range <<= 32;
    }
    return static_cast<std::uint32_t>(value);
  }

  // Raises Section unless the stream ends here, in the bytes that `WideEncoder::finish` writes.
  void finish(const WideInterval& interval) const {
    const WideEnd end(window_ - interval.at, interval.range);
    if (window_ != end.value || size_ != read_ - 8 + end.bytes)
      throw Error(ErrorCode::Section, "the end of a coded stream does not fit its decisions", size_);
  }

 private:
  // Keeps the part of the interval that holds the code, below `bound` or from it on; true: the lower part. In assembly,
  // because compilers use a branch, which would often be mispredicted, or twice as many instructions.
  static bool split(WideInterval& interval, std::uint64_t bound) {
#if defined(__x86_64__)
    std::uint64_t at = interval.at, range = interval.range;
    bool bit;
    asm("sub %[bound], %[range]\n\t"
        "sub %[bound], %[at]\n\t"
        "cmovb %[before], %[at]\n\t"
        "cmovb %[bound], %[range]"
        : [at] "+&r"(at), [range] "+&r"(range), "=@ccb"(bit)
        : [before] "r"(interval.at), [bound] "r"(bound));
    interval = {at, range};
    return bit;
#else
    const bool bit = interval.at < bound;
    const std::uint64_t zero = std::uint64_t{bit} - 1;  // a mask, as in `encode`
    interval.at -= bound & zero;
    interval.range = bound + ((interval.range - 2 * bound) & zero);
    return bit;
#endif
  }

  // The next four bytes, highest first; zeros after the end.
  std::uint32_t next() {
    std::uint32_t word = 0;
    if (read_ + 4 <= size_) {
      for (std::size_t i = 0; i < 4; ++i) word = word << 8 | data_[read_ + i];
    } else {
      if (read_ >= size_ + 8) throw Error(ErrorCode::Truncated, "a coded stream ends too early", size_);
      for (std::size_t i = 0; i < 4; ++i) word = word << 8 | (read_ + i < size_ ? data_[read_ + i] : 0u);
    }
    read_ += 4;
    window_ = window_ << 32 | word;
    return word;
  }

  const std::uint8_t* data_ = nullptr;
  std::size_t size_ = 0;
  std::size_t read_ = 0;      // with the zeros after the end
  std::uint64_t window_ = 0;  // the last eight bytes read
};

}  // namespace lidarcodec
