// Frequencies of rests, which encoder and decoder learn alike (docs/wire-format-clouds.md, "Rests").
//
// A rest below 16 is a token of its own. Of a larger one the token says how many bits it has, and the bits below the
// highest one stand beside the coded tokens.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

namespace lidarcodec {

inline constexpr std::uint32_t kRestBits = 28;  // most of a rest
inline constexpr std::uint32_t kMostRest = (std::uint32_t{1} << kRestBits) - 1;
inline constexpr std::size_t kMostRestContexts = 64;

inline constexpr std::uint32_t kDirectTokens = 16, kDirectBits = 4;
inline constexpr std::uint32_t kMostTokens = kDirectTokens + kRestBits - kDirectBits;
inline constexpr std::uint32_t kFrequencyBits = 11, kFrequencies = 1u << kFrequencyBits;

// 0, -1, 1, -2 as 0, 1, 2, 3; kMostRest + 1 of a number that is no rest.
inline std::uint32_t zigzag(std::int64_t value) {
  const auto found = (static_cast<std::uint64_t>(value) << 1) ^ static_cast<std::uint64_t>(value >> 63);
  return found > kMostRest ? kMostRest + 1 : static_cast<std::uint32_t>(found);
}

inline std::int64_t unzigzag(std::uint32_t value) {
  return static_cast<std::int64_t>(value >> 1) ^ -static_cast<std::int64_t>(value & 1);
}

inline std::uint32_t token_of(std::uint32_t rest) {
  return rest < kDirectTokens ? rest
                              : kDirectTokens - kDirectBits - 1 + static_cast<std::uint32_t>(std::bit_width(rest));
}

// Bits of a rest below its highest one that stand beside its token.
inline std::uint32_t bits_beside(std::uint32_t token) {
  return token < kDirectTokens ? 0 : token - kDirectTokens + kDirectBits;
}

// What is known of the tokens of one context.
class RestTable {
 public:
  explicit RestTable(std::uint32_t tokens) : tokens_(tokens) {
    for (std::uint32_t token = 0; token < tokens_; ++token) counts_[token] = kFirst >> std::min(token, kFirstFalls);
    build();
  }

  std::uint32_t frequency(std::uint32_t token) const { return frequency_[token]; }
  std::uint32_t start(std::uint32_t token) const { return start_[token]; }
  // Token of a number below kFrequencies; only after `look_up_too`.
  std::uint32_t token_at(std::uint32_t slot) const { return token_at_[slot]; }

  // Learns of a token.
  void take(std::uint32_t token) {
    ++counts_[token];
    if (--left_ == 0) {
      period_ = std::min(2 * period_, kLongestPeriod);
      build();
    }
  }

  // Makes `token_at` known from now on.
  void look_up_too() {
    token_at_.resize(kFrequencies + kFilled);
    fill();
  }

 private:
  static constexpr std::uint32_t kFirst = 32, kFirstFalls = 5, kFirstPeriod = 16, kLongestPeriod = 128,
                                 kMostCount = 1024, kFilled = 8;

  void build() {
    left_ = period_;
    std::uint32_t total = 0, best = 0;
    for (std::uint32_t token = 0; token < tokens_; ++token) {
      total += counts_[token];
      if (counts_[token] > counts_[best]) best = token;
    }
    const std::uint32_t spare = kFrequencies - tokens_;
    std::uint32_t used = 0;
    for (std::uint32_t token = 0; token < tokens_; ++token) {
      frequency_[token] = 1 + counts_[token] * spare / total;
      used += frequency_[token];
    }
    frequency_[best] += kFrequencies - used;
    std::uint32_t start = 0;
    for (std::uint32_t token = 0; token < tokens_; ++token) {
      start_[token] = start;
      start += frequency_[token];
    }
    if (!token_at_.empty()) fill();
    if (total > kMostCount)
      for (std::uint32_t token = 0; token < tokens_; ++token) counts_[token] = (counts_[token] + 1) / 2;
  }

  // Eight places at a time; what is written beyond those of a token is written over by the next one.
  void fill() {
    std::uint8_t* at = token_at_.data();
    for (std::uint32_t token = 0; token < tokens_; ++token) {
      const std::uint64_t eight = 0x0101010101010101 * std::uint64_t{token};
      for (std::uint32_t place = 0; place < frequency_[token]; place += kFilled)
        std::memcpy(at + place, &eight, kFilled);
      at += frequency_[token];
    }
  }

  std::uint32_t tokens_;
  std::uint32_t period_ = kFirstPeriod, left_ = kFirstPeriod;
  std::array<std::uint32_t, kMostTokens> counts_{}, frequency_{}, start_{};
  std::vector<std::uint8_t> token_at_;
};

}  // namespace lidarcodec
