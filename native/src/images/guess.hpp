// The expectation of a number: predictions, weighted by how well each did around here. The plain forms of the functions
// define the results; those for SSE2 give the same ones.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "bits/cells.hpp"

namespace lidarcodec {

// One number for each prediction; where there are six, the last two are free, so that they fill vectors.
using PerPrediction = std::array<std::int32_t, 8>;

inline constexpr std::int32_t kMostError = 32767;

// Errors of each prediction, or sums of them that end at 65535.
struct alignas(16) PredictionErrors {
  std::array<std::uint16_t, 8> of{};
};

// Weight of a prediction whose errors have a logarithm that is higher by i quarters of an octave than the least one:
// 64 / 2^(0.6875 i), but for lines between powers of two, rounded down. Those are the upper bits of a float.
inline constexpr std::int16_t kFirstWeight = 133 << 7, kWeightStep = 88;
constexpr std::int32_t prediction_weight(std::int32_t i) {
  return static_cast<std::int32_t>(std::bit_cast<float>((kFirstWeight - kWeightStep * i) << 16));
}

// 2^24 / i, rounded, of the sums that eight weights can have.
inline constexpr auto kWeightShares = [] {
  std::array<std::int32_t, 8 * 64 + 1> shares{};
  for (std::int32_t i = 1; i <= 8 * 64; ++i) shares[static_cast<std::size_t>(i)] = ((1 << 24) + i / 2) / i;
  return shares;
}();

// The clamped gradient: the middle one of left, above, and left + above - left_above.
inline std::int32_t clamped_gradient(std::int32_t left, std::int32_t above, std::int32_t left_above) {
  const std::int32_t low = std::min(left, above), high = std::max(left, above);
  return std::min(std::max(left + above - left_above, low), high);
}

struct Guess {
  std::int32_t eighths;  // the expected number, in eighths
  std::uint32_t least;   // logarithm of the errors of the best prediction
};

// all: the sum of weights; sum: that of weighted differences from base.
inline Guess guess_from(std::int32_t base, std::int32_t sum, std::int32_t all, int least) {
  const std::int64_t share = (std::int64_t{sum} * kWeightShares[static_cast<std::size_t>(all)]) >> 21;
  return {base * 8 + static_cast<std::int32_t>(share), static_cast<std::uint32_t>(least)};
}

#if defined(LIDARCODEC_SSE2_CELLS)

inline __m128i lanes_of(const PredictionErrors& errors) {
  return _mm_load_si128(reinterpret_cast<const __m128i*>(errors.of.data()));
}
inline PredictionErrors errors_from(__m128i lanes) {
  PredictionErrors errors;
  _mm_store_si128(reinterpret_cast<__m128i*>(errors.of.data()), lanes);
  return errors;
}
inline __m128i differences(const PerPrediction& predictions, std::int32_t from) {
  const __m128i base = _mm_set1_epi32(from);
  const auto* p = reinterpret_cast<const __m128i*>(predictions.data());
  return _mm_packs_epi32(_mm_sub_epi32(_mm_loadu_si128(p), base), _mm_sub_epi32(_mm_loadu_si128(p + 1), base));
}
inline PredictionErrors operator+(const PredictionErrors& a, const PredictionErrors& b) {
  return errors_from(_mm_adds_epu16(lanes_of(a), lanes_of(b)));
}

// Lanes of the predictions that are not free.
inline constexpr PredictionErrors kFirstSix = {{65535, 65535, 65535, 65535, 65535, 65535, 0, 0}};

// As the plain forms below.
template <std::size_t N>
inline Guess guess_of(const PerPrediction& predictions, const PredictionErrors& sums) {
  const __m128i zero = _mm_setzero_si128(), four = _mm_set1_epi32(4), of = lanes_of(sums);
  const auto log = [&](__m128i x) {
    return _mm_srai_epi32(_mm_castps_si128(_mm_cvtepi32_ps(_mm_add_epi32(x, four))), 21);
  };
  const __m128i logs = _mm_packs_epi32(log(_mm_unpacklo_epi16(of, zero)), log(_mm_unpackhi_epi16(of, zero)));
  __m128i least = logs;
  if constexpr (N < 8) least = _mm_shuffle_epi32(least, 0x24);  // the first two in place of those that are free
  least = _mm_min_epi16(least, _mm_shuffle_epi32(least, 0x4E));
  least = _mm_min_epi16(least, _mm_shuffle_epi32(least, 0xB1));
  least = _mm_min_epi16(least, _mm_srai_epi32(least, 16));  // the upper half is 0: logs are positive here
  least = _mm_or_si128(least, _mm_slli_epi32(least, 16));
  const __m128i high = _mm_sub_epi16(_mm_set1_epi16(kFirstWeight),
                                     _mm_mullo_epi16(_mm_sub_epi16(logs, least), _mm_set1_epi16(kWeightStep)));
  const auto weight = [](__m128i bits) { return _mm_cvttps_epi32(_mm_castsi128_ps(bits)); };
  __m128i weights = _mm_packs_epi32(weight(_mm_unpacklo_epi16(zero, high)), weight(_mm_unpackhi_epi16(zero, high)));
  if constexpr (N < 8) weights = _mm_and_si128(weights, _mm_load_si128(reinterpret_cast<const __m128i*>(&kFirstSix)));
  const auto best = static_cast<std::uint32_t>(_mm_movemask_epi8(_mm_cmpeq_epi16(logs, least)));
  const std::int32_t base = predictions[static_cast<std::size_t>(std::countr_zero(best)) / 2];
  const __m128i sum = _mm_madd_epi16(differences(predictions, base), weights);
  const __m128i all = _mm_madd_epi16(weights, _mm_set1_epi16(1));
  __m128i both = _mm_add_epi32(_mm_unpacklo_epi32(sum, all), _mm_unpackhi_epi32(sum, all));
  both = _mm_add_epi32(both, _mm_shuffle_epi32(both, 0x4E));
  return guess_from(base, _mm_cvtsi128_si32(both), _mm_cvtsi128_si32(_mm_shuffle_epi32(both, 0x55)),
                    static_cast<std::int16_t>(_mm_cvtsi128_si32(least)) - (129 << 2));
}

inline PredictionErrors errors_of(const PerPrediction& predictions, std::int32_t value) {
  const __m128i off = differences(predictions, value);
  return errors_from(_mm_max_epi16(off, _mm_subs_epi16(_mm_setzero_si128(), off)));
}

#else

inline PredictionErrors operator+(const PredictionErrors& a, const PredictionErrors& b) {
  PredictionErrors sum;
  for (std::size_t i = 0; i < 8; ++i) sum.of[i] = static_cast<std::uint16_t>(std::min(a.of[i] + b.of[i], 65535));
  return sum;
}

// The mean of the first N predictions, weighted by 1 / errors^2.75. sums: of the errors around. The first of the best
// predictions is the base: others count as at most 32,768 from it.
template <std::size_t N>
inline Guess guess_of(const PerPrediction& predictions, const PredictionErrors& sums) {
  std::array<std::int32_t, 8> logs;
  for (std::size_t i = 0; i < 8; ++i)
    logs[i] = (std::bit_cast<std::int32_t>(static_cast<float>(sums.of[i] + 4)) >> 21) - (129 << 2);
  std::int32_t least = logs[0];
  for (std::size_t i = 1; i < N; ++i) least = std::min(least, logs[i]);
  const auto best = static_cast<std::size_t>(std::find(logs.begin(), logs.end(), least) - logs.begin());
  const std::int32_t base = predictions[best];
  std::int32_t sum = 0, all = 0;
  for (std::size_t i = 0; i < N; ++i) {
    const std::int32_t weight = prediction_weight(logs[i] - least);
    sum += weight * std::clamp(predictions[i] - base, -32768, 32767);
    all += weight;
  }
  return guess_from(base, sum, all, least);
}

inline PredictionErrors errors_of(const PerPrediction& predictions, std::int32_t value) {
  PredictionErrors errors;
  for (std::size_t i = 0; i < 8; ++i) {
    const std::int32_t off = value - predictions[i];
    errors.of[i] = static_cast<std::uint16_t>(std::min(off < 0 ? -off : off, kMostError));
  }
  return errors;
}

#endif

}  // namespace lidarcodec
