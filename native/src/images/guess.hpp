// The expectation of a number: predictions, weighted by how well each did around here.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

namespace lidarcodec {

// One number for each prediction; where there are six, the last two are free, so that they fill vectors.
using PerPrediction = std::array<std::int32_t, 8>;

// Weight of a prediction whose errors have a logarithm that is higher by i quarters of an octave than the least one:
// 64 * 0.62^i, rounded.
inline constexpr std::array<std::int32_t, 16> kPredictionWeights = {64, 40, 25, 15, 9, 6, 4, 2, 1, 1, 1, 0, 0, 0, 0, 0};

// 2^24 / i, rounded, of the sums that eight weights can have.
inline constexpr auto kWeightShares = [] {
  std::array<std::int32_t, 8 * 64 + 1> shares{};
  for (std::int32_t i = 1; i <= 8 * 64; ++i) shares[static_cast<std::size_t>(i)] = ((1 << 24) + i / 2) / i;
  return shares;
}();

struct Guess {
  std::int32_t eighths;  // the expected number, in eighths
  std::uint32_t least;   // logarithm of the errors of the best prediction
};

inline constexpr std::int32_t kMostError = 1 << 20;

// The mean of the first N predictions, weighted by 1 / errors^2.76. base: any number near them. sums: five errors
// around, added up, 0 in the free lanes.
template <std::size_t N>
inline Guess guess_of(std::int32_t base, const PerPrediction& predictions, const PerPrediction& sums) {
  std::array<std::int32_t, 8> logs;
  for (std::size_t i = 0; i < 8; ++i) {
    const auto bits = std::bit_cast<std::int32_t>(static_cast<float>(sums[i] + 4));
    logs[i] = (bits >> 21) - (129 << 2);  // as quarter_log
  }
  std::int32_t least = logs[0];
  for (std::size_t i = 1; i < N; ++i) least = std::min(least, logs[i]);
  std::int64_t sum = 0;
  std::int32_t all = 0;
  for (std::size_t i = 0; i < N; ++i) {
    const std::int32_t weight = kPredictionWeights[static_cast<std::size_t>(std::min(15, logs[i] - least))];
    sum += std::int64_t{weight} * (predictions[i] - base);
    all += weight;
  }
  const std::int64_t share = (sum * kWeightShares[static_cast<std::size_t>(all)]) >> 21;
  return {base * 8 + static_cast<std::int32_t>(share), static_cast<std::uint32_t>(least)};
}

inline PerPrediction errors_of(const PerPrediction& predictions, std::int32_t value) {
  PerPrediction errors;
  for (std::size_t i = 0; i < 8; ++i) {
    const std::int32_t off = value - predictions[i];
    errors[i] = std::min(off < 0 ? -off : off, kMostError);
  }
  return errors;
}

}  // namespace lidarcodec
