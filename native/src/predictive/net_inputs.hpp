// The inputs of the networks of codec riddle: 72 numbers of 8 bits, or 112 with expected ranges.
//
// Differences are counted from the last return of the row in units of the local scale. They are quantised in two ways:
// linearly, 16 steps a unit, up to eight units; and companded, 16 log2(1 + units), as in the mu law of ITU-T G.711. The
// arithmetic is IEEE 754 single precision without fused operations, so every machine gives the same numbers.
// docs/wire-format-riddle.md defines their order.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "network/net.hpp"
#include "predictive/tables.hpp"

#if defined(__SSE2__)
#include <emmintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace lidarcodec {

// Units in a quarter of a cell, for each scale class c: 4 / 2^((c + 1.5) / 2), as 2^((c + 1.5) / 2) sixteenths are the
// middle of the class.
inline constexpr std::array<float, kScaleClasses> kUnitsInQuarter = {
    0x1.306fe00000000p+1f,  0x1.ae89fa0000000p+0f,  0x1.306fe00000000p+0f,  0x1.ae89fa0000000p-1f,
    0x1.306fe00000000p-1f,  0x1.ae89fa0000000p-2f,  0x1.306fe00000000p-2f,  0x1.ae89fa0000000p-3f,
    0x1.306fe00000000p-3f,  0x1.ae89fa0000000p-4f,  0x1.306fe00000000p-4f,  0x1.ae89fa0000000p-5f,
    0x1.306fe00000000p-5f,  0x1.ae89fa0000000p-6f,  0x1.306fe00000000p-6f,  0x1.ae89fa0000000p-7f,
    0x1.306fe00000000p-7f,  0x1.ae89fa0000000p-8f,  0x1.306fe00000000p-8f,  0x1.ae89fa0000000p-9f,
    0x1.306fe00000000p-9f,  0x1.ae89fa0000000p-10f, 0x1.306fe00000000p-10f, 0x1.ae89fa0000000p-11f,
    0x1.306fe00000000p-11f, 0x1.ae89fa0000000p-12f, 0x1.306fe00000000p-12f, 0x1.ae89fa0000000p-13f,
    0x1.306fe00000000p-13f, 0x1.ae89fa0000000p-14f, 0x1.306fe00000000p-14f, 0x1.ae89fa0000000p-15f,
};

// What the inputs of a return are computed from. Rows are padded: cells to the left and to the right are read.
struct Surroundings {
  std::int32_t base;                                   // the last range; all ranges are in sixteenths of a cell
  const std::int32_t* last;                            // the eight last returns of the row, the latest first
  const std::int32_t *up, *upper;                      // the two rows above, from this cell on
  const std::uint32_t* sizes;                          // differences of the row above, from this cell on
  const std::uint8_t *here, *above, *below;            // masks of this row, of the row above and of the row below
  const std::int32_t *seen, *seen_above, *seen_below;  // expected ranges; only with them
  const std::uint8_t* known;                           // mask of the expected ranges
  std::int32_t level, bias;  // smoothed differences from the row above and from expected ranges; sixteenths
  std::uint32_t size1, size2, mean, miss;  // RowState (predictive/row_state.hpp)
  std::uint32_t scale, leaves, row, gap, step;
  bool begun;
};

namespace inputs {

using Floats = float __attribute__((vector_size(16)));
using Ints = std::int32_t __attribute__((vector_size(16)));

// 16 log2 x for x >= 1, rounded down, linear within each octave (Mitchell, "Computer multiplication and division using
// binary logarithms", 1962): exponent and upper four bits of the mantissa of a float.
inline Ints log2_16(Floats x) { return (std::bit_cast<Ints>(x) - 0x3f800000) >> 19; }
inline std::int32_t log2_16(std::uint32_t x) {
  return (std::bit_cast<std::int32_t>(static_cast<float>(x)) - 0x3f800000) >> 19;
}

inline Ints four(const std::int32_t* from) {
  Ints numbers;
  std::memcpy(&numbers, from, sizeof numbers);
  return numbers;
}

inline Ints least(Ints a, Ints b) { return a < b ? a : b; }
inline Ints most(Ints a, Ints b) { return a > b ? a : b; }
inline Floats least(Floats a, Floats b) { return a < b ? a : b; }
inline Ints with_sign(Ints sizes, Ints signs) { return (sizes ^ signs) - signs; }

// Writes four numbers that fit 8 bits. Callers overwrite surplus ones with the inputs that follow.
inline void put(Ints numbers, std::int8_t* to) {
#if defined(__SSE2__)
  const __m128i lanes = std::bit_cast<__m128i>(numbers), words = _mm_packs_epi32(lanes, lanes);
  const std::int32_t bytes = _mm_cvtsi128_si32(_mm_packs_epi16(words, words));
  std::memcpy(to, &bytes, sizeof bytes);
#elif defined(__aarch64__)
  const int16x4_t words = vqmovn_s32(std::bit_cast<int32x4_t>(numbers));
  const std::int32_t bytes = vget_lane_s32(vreinterpret_s32_s8(vqmovn_s16(vcombine_s16(words, words))), 0);
  std::memcpy(to, &bytes, sizeof bytes);
#else
  for (std::size_t i = 0; i < 4; ++i) to[i] = static_cast<std::int8_t>(numbers[i]);
#endif
}

// Writes 16 numbers, clamped to -127 to 127.
inline void put(Ints a, Ints b, Ints c, Ints d, std::int8_t* to) {
#if defined(__SSE2__)
  const auto words = [](Ints low, Ints high) {
    const __m128i both = _mm_packs_epi32(std::bit_cast<__m128i>(low), std::bit_cast<__m128i>(high));
    return _mm_max_epi16(both, _mm_set1_epi16(-127));
  };
  _mm_storeu_si128(reinterpret_cast<__m128i*>(to), _mm_packs_epi16(words(a, b), words(c, d)));
#else
  for (const Ints& four : {a, b, c, d}) {
    put(most(least(four, Ints{} + 127), Ints{} - 127), to);
    to += 4;
  }
#endif
}

// Writes 32 for each of four bytes that is 1, and 0 for each that is 0.
inline void put_flags(const std::uint8_t* from, std::int8_t* to) {
  std::uint32_t flags;
  std::memcpy(&flags, from, sizeof flags);
  flags <<= 5;  // no bit moves into the next byte
  std::memcpy(to, &flags, sizeof flags);
}

// Four differences, of - from, in sixteenths of a cell, with `more` added in quarters of a cell.
struct Differences {
  Ints of, from, more{};
  Ints quarters() const { return ((of - from) >> 2) + more; }
};
using DifferenceGroups = std::array<Differences, 4>;

// The first `count` of four inputs go to index `at`.
struct Slice {
  std::uint8_t at, count;
};
using Slices = std::array<Slice, 4>;
inline constexpr Slices kNoSlices{};

// Quantises differences in quarters of a cell.
struct Quantiser {
  Floats units;  // in a quarter of a cell

  // 16 log2(1 + units), up to 127, with the sign.
  Ints companded(Ints quarters) const {
    const Ints signs = quarters >> 31;
    const Floats size = __builtin_convertvector(with_sign(quarters, signs), Floats) * units;
    return with_sign(least(log2_16(size + 1.0f), Ints{} + 127), signs);
  }

  // Linear: 16 steps a unit, rounded, -127 to 127.
  Ints linear(Ints quarters) const {
    const Ints signs = quarters >> 31;
    const Floats size = __builtin_convertvector(with_sign(quarters, signs), Floats) * (units * 16.0f);
    return with_sign(__builtin_convertvector(least(size + 0.5f, Floats{} + 127.0f), Ints), signs);
  }
};

// Writes the four groups of differences a to the slices A, and b to B. Of each four the first `Linear` are linear, the
// others companded.
struct GroupWriter {
  template <std::size_t Linear, Slices A, Slices B>
  static void put(const Quantiser& quantiser, const DifferenceGroups& a, const DifferenceGroups& b, std::int8_t* in) {
    put_four<Linear, A>(quantiser, a, in);
    put_four<Linear, B>(quantiser, b, in);
  }

 private:
  template <std::size_t Linear, Slices To>
  static void put_four(const Quantiser& quantiser, const DifferenceGroups& groups, std::int8_t* in) {
    for (std::size_t g = 0; g < To.size(); ++g) {
      if (To[g].count == 0) continue;
      const Ints quarters = groups[g].quarters(),
                 numbers = g < Linear ? quantiser.linear(quarters) : quantiser.companded(quarters);
      std::array<std::int8_t, 4> bytes;
      inputs::put(numbers, bytes.data());
      std::memcpy(in + To[g].at, bytes.data(), To[g].count);
    }
  }
};

}  // namespace inputs

// Computes the inputs of a return. Writer: GroupWriter, or the same for vectors of a processor.
template <bool kExpects, class Writer = inputs::GroupWriter>
inline void find_inputs(const Surroundings& s, std::int8_t* in) {
  using inputs::four, inputs::Ints, inputs::put, inputs::put_flags, inputs::Differences, inputs::DifferenceGroups,
      inputs::Slices, inputs::kNoSlices;
  const std::int32_t base = s.base;
  const Ints bases = Ints{} + base;
  const inputs::Quantiser quantiser = {inputs::Floats{} + kUnitsInQuarter[s.scale]};
  const auto away = [&](const std::int32_t* ranges) { return Differences{four(ranges), bases}; };
  const auto apart = [&](const std::int32_t* a, const std::int32_t* b) { return Differences{four(a), four(b)}; };
  const Differences levelled = {four(s.up), bases, Ints{} + (s.level >> 2)};
  const Ints upper = four(s.upper);
  const Differences of_upper = {Ints{upper[0], upper[1], upper[1], upper[1]}, Ints{base, base, s.up[1], upper[0]}};
  constexpr Slices kRow = {{{0, 3}, {3, 4}, {7, 4}, {11, 2}}}, kAbove = {{{13, 4}, {17, 4}, {21, 3}, {24, 2}}},
                   kAround = {{{26, 4}, {30, 2}, {32, 3}, {35, 4}}};
  const DifferenceGroups row = {away(s.last + 1), away(s.last + 4), away(s.up - 3), away(s.up + 1)};
  const DifferenceGroups above = {away(s.up + 3), away(s.upper - 1), away(s.last + 1), away(s.up - 1)};
  const DifferenceGroups around = {away(s.up + 1), levelled, apart(s.up, s.up - 1), of_upper};
  if constexpr (kExpects) {
    constexpr Slices kSeen = {{{69, 3}, {72, 4}, {76, 2}, {78, 4}}}, kSeenOn = {{{82, 2}, {84, 4}, {88, 2}, {90, 3}}},
                     kResidual = {{{106, 2}, {108, 4}, {93, 4}, {97, 4}}};
    const Ints seen = four(s.seen), bias = Ints{} + (s.bias >> 2), last_only = {0, 0, 0, -1},
               third_only = {0, 0, -1, 0};
    const std::int32_t next_below = s.seen_below[1], this_below = s.seen_below[0];
    const Differences below = {Ints{this_below, next_below, this_below, 0}, Ints{base, base, s.seen[0], 0},
                               bias & last_only};
    const Differences last = {Ints{s.up[2], s.up[3], 0, next_below},
                              Ints{s.seen_above[2], s.seen_above[3], 0, this_below}, bias & third_only};
    Writer::template put<4, kRow, kSeen>(quantiser, row,
                                         {levelled, away(s.seen - 3), away(s.seen + 1), away(s.seen + 3)}, in);
    Writer::template put<2, kAbove, kResidual>(
        quantiser, above, {apart(s.up, s.seen_above), last, apart(s.up - 1, s.seen_above - 1), below}, in);
    Writer::template put<0, kAround, kSeenOn>(
        quantiser, around,
        {away(s.seen - 1), away(s.seen + 1), Differences{seen, bases, bias}, apart(s.seen, s.seen - 1)}, in);
  } else {
    constexpr Slices kLevelled = {{{69, 3}, {}, {}, {}}};
    Writer::template put<4, kRow, kLevelled>(quantiser, row, {levelled}, in);
    Writer::template put<2, kAbove, kNoSlices>(quantiser, above, {}, in);
    Writer::template put<0, kAround, kNoSlices>(quantiser, around, {}, in);
  }
  const std::int32_t scale_of = 8 * static_cast<std::int32_t>(s.scale) + 12;
  const auto sizes = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
    using Unsigned = std::uint32_t __attribute__((vector_size(16)));
    const auto numbers = std::bit_cast<Ints>(Unsigned{a, b, c, d} + 2);  // at most 2^20 and two
    return inputs::log2_16(__builtin_convertvector(numbers, inputs::Floats)) - scale_of;
  };
  const auto native = static_cast<std::uint32_t>(std::max(base >> 4, 1)) * s.step;
  const auto leaves = static_cast<std::int32_t>(s.leaves);
  put(sizes(s.size1, s.size2, s.mean, s.sizes[-1]), sizes(s.sizes[0], s.sizes[1], s.sizes[2], s.sizes[4]),
      Ints{4 * static_cast<std::int32_t>(s.scale) - 50, inputs::log2_16(native) / 2 - 90, inputs::log2_16(s.step) - 48,
           8 * (leaves >> 4 & 15) - 60},
      Ints{8 * (leaves & 15) - 60, 2 * static_cast<std::int32_t>(s.row) - 64, inputs::log2_16(s.gap), s.begun ? 32 : 0},
      in + 39);
  put_flags(s.here - 3, in + 55);
  put_flags(s.here + 1, in + 58);
  put_flags(s.above - 1, in + 61);
  put_flags(s.below - 1, in + 65);
  if constexpr (kExpects) {
    in[101] = in[100];
    in[100] = static_cast<std::int8_t>(std::clamp(inputs::log2_16(s.miss + 2) - scale_of, -127, 127));
    put_flags(s.known - 1, in + 102);
  }
}

}  // namespace lidarcodec
