// An adaptive probability of a bit, and logistic mixing of two of them. In integers, so every machine gives the same
// bytes. README.md in this folder has the derivation.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>

namespace lidarcodec {

// After n decisions the next one moves the probability by 1 / (n + 2) of the error (Krichevsky and Trofimov 1981), and
// by 1 / 255 from n = 253 on.
inline constexpr std::uint32_t kCountLimit = 253;
inline constexpr auto kRates = [] {
  std::array<std::uint32_t, kCountLimit + 1> rates{};
  for (std::uint32_t n = 0; n <= kCountLimit; ++n) rates[n] = 65536u / (n + 2);
  return rates;
}();

// The coder's smallest probability, of 65536.
inline constexpr std::uint32_t kMinProbability = 16;

// The probability of a one in the upper 22 bits, the number of decisions in the lower 10.
class BitModel {
 public:
  constexpr BitModel() = default;
  // probability: the first one, of 65536; it weighs as much as two decisions.
  constexpr explicit BitModel(std::uint32_t probability) : state_(probability << 16 | 2u) {}

  std::uint32_t probability() const { return std::clamp(state_ >> 16, kMinProbability, 65536u - kMinProbability); }

  void update(bool bit) {
    const std::uint32_t n = state_ & 1023u;
    const std::uint32_t p = state_ >> 10;
    const std::uint64_t rate = kRates[n];
    const std::uint32_t moved = bit ? p + static_cast<std::uint32_t>(((0x3FFFFFu - p) * rate) >> 16)
                                    : p - static_cast<std::uint32_t>((p * rate) >> 16);
    state_ = moved << 10 | (n + (n < kCountLimit));
  }

  std::uint32_t raw() const { return state_; }

 private:
  std::uint32_t state_ = 1u << 31;
};

// kSquash[i]: the probability, of 65536, whose log odds are (i - 2048) / 256: the logistic function, from powers of
// e^(-1/256) with 31 fractional bits.
inline constexpr auto kSquash = [] {
  std::array<std::uint16_t, 4096> squash{};
  constexpr std::uint64_t one = 1u << 31;
  constexpr std::uint64_t step = 2139111403;  // round(2^31 * e^(-1/256))
  std::uint64_t power = one;                  // e^(-d / 256)
  for (std::size_t d = 0; d <= 2048; ++d) {
    const auto up = static_cast<std::uint32_t>((one << 16) / (one + power));
    if (d < 2048) squash[2048 + d] = static_cast<std::uint16_t>(up);
    if (d > 0) squash[2048 - d] = static_cast<std::uint16_t>(65536u - up);
    power = (power * step + (one >> 1)) >> 31;
  }
  return squash;
}();

// kStretch[i]: log odds, in steps of 1/256, of the probability (i + 1/2) / 4096: the least whose kSquash is not below
// it.
inline constexpr auto kStretch = [] {
  std::array<std::int16_t, 4096> stretch{};
  std::size_t at = 0;
  for (std::uint32_t i = 0; i < 4096; ++i) {
    while (at < 4095 && kSquash[at] < i * 16 + 8) ++at;
    stretch[i] = static_cast<std::int16_t>(static_cast<int>(at) - 2048);
  }
  return stretch;
}();

// Logistic mixing (Mahoney 2005) of two models: a weighted sum of their log odds. The weights follow the gradient of
// the cost.
class Mixer {
 public:
  // The mixed probability, of 65536.
  std::uint32_t mix(const BitModel& a, const BitModel& b) {
    a_ = kStretch[a.raw() >> 20];
    b_ = kStretch[b.raw() >> 20];
    const std::int64_t sum =
        (static_cast<std::int64_t>(weight_a_) * a_ + static_cast<std::int64_t>(weight_b_) * b_) >> 16;
    mixed_ = kSquash[static_cast<std::size_t>(std::clamp<std::int64_t>(sum, -2048, 2047) + 2048)];
    return std::clamp<std::uint32_t>(mixed_, kMinProbability, 65536u - kMinProbability);
  }

  void update(bool bit) {
    const std::int32_t error = (bit ? 65536 : 0) - static_cast<std::int32_t>(mixed_);
    weight_a_ = std::clamp(weight_a_ + ((error * a_ + 0x8000) >> 16), -kMaxWeight, kMaxWeight);
    weight_b_ = std::clamp(weight_b_ + ((error * b_ + 0x8000) >> 16), -kMaxWeight, kMaxWeight);
  }

 private:
  static constexpr std::int32_t kMaxWeight = 1 << 20;  // 16.0
  std::int32_t weight_a_ = 39322, weight_b_ = 39322;   // 0.6
  std::int32_t a_ = 0, b_ = 0;
  std::uint32_t mixed_ = 0;
};

}  // namespace lidarcodec
