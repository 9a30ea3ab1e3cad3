// The positions of the neighbours of a return: their differences from the last return, quantised to 0 to 15
// (model.hpp).
//
// The plain form defines the results. The forms for SSE2 and NEON give the same ones, and compute 32 positions at once.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "bits/cells.hpp"
#include "predictive/tables.hpp"

namespace lidarcodec {

// Ranges of the neighbours, in sixteenths of a cell. A group is four adjacent ones, from left to right; groups overlap
// in memory.
struct Neighbours {
  const std::int32_t* last;   // the second to the fifth last return of the row
  const std::int32_t* above;  // from the cell before this one in the row above; six are read
  const std::int32_t* upper;  // the same of the row above that; six are read
  std::int32_t base;          // the last return
  std::int32_t level;         // smoothed difference of this row from the row above, quarters of a cell
};

// Expected ranges, in sixteenths of a cell. Groups begin at the cell to the left.
struct Expected {
  const std::int32_t* here;   // in this row; five are read
  const std::int32_t* above;  // expected in the row above, and the ranges there
  const std::int32_t* came;
  std::int32_t base;  // the last return
  std::int32_t bias;  // smoothed difference of ranges from expected ones, quarters of a cell
};

inline constexpr std::size_t kPositionLanes = 32;
inline constexpr std::size_t kExpectedLanes = 16;
inline constexpr std::size_t kPositionLimitCount = 7;

// Each limit eight times: one for each lane of a vector.
struct alignas(16) LaneLimits {
  std::array<std::array<std::int16_t, 8>, kPositionLimitCount> of{};
};
inline constexpr auto kLaneLimits = [] {
  std::array<LaneLimits, kScaleClasses> all{};
  for (std::size_t c = 0; c < kScaleClasses; ++c)
    for (std::size_t k = 0; k < kPositionLimitCount; ++k) all[c].of[k].fill(kPositionLimits[c][k]);
  return all;
}();

// Differences in quarters of a cell, within 32767, in eight groups of four:
//   the last returns; the row above, corrected by the level; the row above; its gradients from a cell to the next; its
//   central differences, halved; the second row above; its vertical gradients, from the row above; its gradients.
// With expected ranges there are four more groups: this row, corrected by the bias; this row; its gradients; and the
// residuals of the row above. n is the number of limits that are at most |difference|. The position is 8 + n, or 7 - n
// if the difference is negative.

// The distances of eight ranges, in cells: upwards from the lower end of a cell, or downwards from it, where the first
// cell below is 0.
struct NearRanges {
  alignas(32) std::array<std::int32_t, 8> away;

  NearRanges() = default;
  NearRanges(const std::array<std::int32_t, 8>& ranges, std::int32_t origin, bool down) {
    for (std::size_t i = 0; i < away.size(); ++i) away[i] = ((ranges[i] - origin) >> 4) ^ (down ? -1 : 0);
  }

  // The ranges at a distance of at least `so_far`, a bit for each.
  std::uint32_t from(std::uint32_t so_far) const {
    const auto least = static_cast<std::int32_t>(so_far);
#if defined(LIDARCODEC_SSE2_CELLS)
    const __m128i below = _mm_set1_epi32(least - 1);
    std::uint32_t found = 0;
    for (std::size_t v = 0; v < 2; ++v) {
      const __m128i is = _mm_cmpgt_epi32(_mm_load_si128(reinterpret_cast<const __m128i*>(away.data() + 4 * v)), below);
      found |= static_cast<std::uint32_t>(_mm_movemask_ps(_mm_castsi128_ps(is))) << (4 * v);
    }
    return found;
#else
    std::uint32_t found = 0;
    for (std::size_t i = 0; i < away.size(); ++i) found |= static_cast<std::uint32_t>(away[i] >= least) << i;
    return found;
#endif
  }
};

struct PlainPositions {
  static std::int32_t quarters(std::int32_t sixteenths) { return sixteenths >> 2; }

  // The position of one difference.
  static std::uint8_t position_of(std::int32_t difference, std::uint32_t scale) {
    const std::int32_t d = std::clamp(difference, -32767, 32767), size = d < 0 ? -d : d;
    std::int32_t n = 0;
    for (std::size_t k = 0; k < kPositionLimitCount; ++k) n += size >= kPositionLimits[scale][k];
    return static_cast<std::uint8_t>(d < 0 ? 7 - n : 8 + n);
  }

  static void of_expected(const Expected& expected, std::uint32_t scale, std::uint8_t* positions) {
    for (std::size_t i = 0; i < 4; ++i) {
      const std::int32_t here = expected.here[i], plain = quarters(here - expected.base);
      const std::array<std::int32_t, 4> differences = {plain + expected.bias, plain,
                                                       quarters(expected.here[i + 1] - here),
                                                       quarters(expected.came[i] - expected.above[i])};
      for (std::size_t group = 0; group < differences.size(); ++group)
        positions[4 * group + i] = position_of(differences[group], scale);
    }
  }

  static void of_neighbours(const Neighbours& around, std::uint32_t scale, std::uint8_t* positions) {
    for (std::size_t i = 0; i < 4; ++i) {
      const std::int32_t above = around.above[i], upper = around.upper[i];
      const std::int32_t plain = quarters(above - around.base);
      const std::array<std::int32_t, 8> differences = {quarters(around.last[i] - around.base),
                                                       plain + around.level,
                                                       plain,
                                                       quarters(around.above[i + 1] - above),
                                                       (around.above[i + 2] - above) >> 3,
                                                       quarters(upper - around.base),
                                                       quarters(upper - above),
                                                       quarters(around.upper[i + 1] - upper)};
      for (std::size_t group = 0; group < differences.size(); ++group)
        positions[4 * group + i] = position_of(differences[group], scale);
    }
  }
};

#if defined(LIDARCODEC_SSE2_CELLS)

struct Positions {
  static __m128i four(const std::int32_t* from) { return _mm_loadu_si128(reinterpret_cast<const __m128i*>(from)); }

  // Positions of Groups vectors of differences. Two vectors give 16 bytes.
  template <std::size_t Groups>
  static void count_limits(const __m128i (&d)[Groups], std::uint32_t scale, std::uint8_t* positions) {
    __m128i sign[Groups], size[Groups], count[Groups];
    for (std::size_t v = 0; v < Groups; ++v) {
      const __m128i kept = _mm_max_epi16(d[v], _mm_set1_epi16(-32767));
      sign[v] = _mm_srai_epi16(kept, 15);
      size[v] = _mm_sub_epi16(_mm_xor_si128(kept, sign[v]), sign[v]);
      count[v] = _mm_set1_epi16(static_cast<std::int16_t>(kPositionLimitCount));
    }
    for (const auto& limit : kLaneLimits[scale].of) {
      const __m128i limits = _mm_load_si128(reinterpret_cast<const __m128i*>(limit.data()));
      for (std::size_t v = 0; v < Groups; ++v) count[v] = _mm_add_epi16(count[v], _mm_cmpgt_epi16(limits, size[v]));
    }
    for (std::size_t v = 0; v < Groups; ++v)
      count[v] = _mm_add_epi16(_mm_xor_si128(count[v], sign[v]), _mm_set1_epi16(8));
    auto* const to = reinterpret_cast<__m128i*>(positions);
    for (std::size_t v = 0; v < Groups; v += 2) _mm_storeu_si128(to + v / 2, _mm_packus_epi16(count[v], count[v + 1]));
  }

  static __m128i quarters(__m128i sixteenths) { return _mm_srai_epi32(sixteenths, 2); }

  static void of_expected(const Expected& expected, std::uint32_t scale, std::uint8_t* positions) {
    const __m128i here = four(expected.here), base = _mm_set1_epi32(expected.base);
    const __m128i plain = quarters(_mm_sub_epi32(here, base));
    const __m128i d[2] = {
        _mm_packs_epi32(_mm_add_epi32(plain, _mm_set1_epi32(expected.bias)), plain),
        _mm_packs_epi32(quarters(_mm_sub_epi32(four(expected.here + 1), here)),
                        quarters(_mm_sub_epi32(four(expected.came), four(expected.above)))),
    };
    count_limits(d, scale, positions);
  }

  static void of_neighbours(const Neighbours& around, std::uint32_t scale, std::uint8_t* positions) {
    const __m128i base = _mm_set1_epi32(around.base), level = _mm_set1_epi32(around.level);
    const __m128i above = four(around.above), next = four(around.above + 1), upper = four(around.upper);
    const __m128i plain = quarters(_mm_sub_epi32(above, base));
    const __m128i d[4] = {
        _mm_packs_epi32(quarters(_mm_sub_epi32(four(around.last), base)), _mm_add_epi32(plain, level)),
        _mm_packs_epi32(plain, quarters(_mm_sub_epi32(next, above))),
        _mm_packs_epi32(_mm_srai_epi32(_mm_sub_epi32(four(around.above + 2), above), 3),
                        quarters(_mm_sub_epi32(upper, base))),
        _mm_packs_epi32(quarters(_mm_sub_epi32(upper, above)), quarters(_mm_sub_epi32(four(around.upper + 1), upper))),
    };
    count_limits(d, scale, positions);
  }
};

#elif defined(LIDARCODEC_NEON_CELLS)

struct Positions {
  template <std::size_t Groups>
  static void count_limits(const int16x8_t (&d)[Groups], std::uint32_t scale, std::uint8_t* positions) {
    int16x8_t sign[Groups], size[Groups], count[Groups];
    for (std::size_t v = 0; v < Groups; ++v) {
      const int16x8_t kept = vmaxq_s16(d[v], vdupq_n_s16(-32767));
      sign[v] = vshrq_n_s16(kept, 15);
      size[v] = vabsq_s16(kept);
      count[v] = vdupq_n_s16(static_cast<std::int16_t>(kPositionLimitCount));
    }
    for (const auto& limit : kLaneLimits[scale].of) {
      const int16x8_t limits = vld1q_s16(limit.data());
      for (std::size_t v = 0; v < Groups; ++v)
        count[v] = vaddq_s16(count[v], vreinterpretq_s16_u16(vcgtq_s16(limits, size[v])));
    }
    for (std::size_t v = 0; v < Groups; ++v) count[v] = vaddq_s16(veorq_s16(count[v], sign[v]), vdupq_n_s16(8));
    for (std::size_t v = 0; v < Groups; v += 2)
      vst1q_u8(positions + 8 * v, vqmovun_high_s16(vqmovun_s16(count[v]), count[v + 1]));
  }

  static int32x4_t quarters(int32x4_t sixteenths) { return vshrq_n_s32(sixteenths, 2); }
  static int16x8_t pack(int32x4_t a, int32x4_t b) { return vqmovn_high_s32(vqmovn_s32(a), b); }

  static void of_expected(const Expected& expected, std::uint32_t scale, std::uint8_t* positions) {
    const int32x4_t here = vld1q_s32(expected.here), base = vdupq_n_s32(expected.base);
    const int32x4_t plain = quarters(vsubq_s32(here, base));
    const int16x8_t d[2] = {
        pack(vaddq_s32(plain, vdupq_n_s32(expected.bias)), plain),
        pack(quarters(vsubq_s32(vld1q_s32(expected.here + 1), here)),
             quarters(vsubq_s32(vld1q_s32(expected.came), vld1q_s32(expected.above)))),
    };
    count_limits(d, scale, positions);
  }

  static void of_neighbours(const Neighbours& around, std::uint32_t scale, std::uint8_t* positions) {
    const int32x4_t base = vdupq_n_s32(around.base), level = vdupq_n_s32(around.level);
    const int32x4_t above = vld1q_s32(around.above), next = vld1q_s32(around.above + 1),
                    upper = vld1q_s32(around.upper);
    const int32x4_t plain = quarters(vsubq_s32(above, base));
    const int16x8_t d[4] = {
        pack(quarters(vsubq_s32(vld1q_s32(around.last), base)), vaddq_s32(plain, level)),
        pack(plain, quarters(vsubq_s32(next, above))),
        pack(vshrq_n_s32(vsubq_s32(vld1q_s32(around.above + 2), above), 3), quarters(vsubq_s32(upper, base))),
        pack(quarters(vsubq_s32(upper, above)), quarters(vsubq_s32(vld1q_s32(around.upper + 1), upper))),
    };
    count_limits(d, scale, positions);
  }
};

#else

using Positions = PlainPositions;

#endif

}  // namespace lidarcodec
