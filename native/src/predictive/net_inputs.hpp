// What the networks of codec riddle are told of a return's surroundings: 72 numbers of 8 bits, or 112 where something is
// expected.
//
// Distances are counted from the last return of the row, in units of the scale of how much ranges differ here, and come
// in two forms: straight, 16 to a unit, up to eight units; and by their logarithm, 16 to an octave, at any distance. The
// arithmetic is that of single-precision numbers without fused operations, so it gives the same on every machine. The
// order is part of docs/wire-format-riddle.md.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "predictive/tables.hpp"
#include "network/net.hpp"

#if defined(__SSE2__)
#include <emmintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace lidarcodec {

// Units in a quarter of a cell, of each scale class: 4 / 2^((class + 1.5) / 2).
inline constexpr std::array<float, kScaleClasses> kUnitsInQuarter = {
    0x1.306fe00000000p+1f, 0x1.ae89fa0000000p+0f, 0x1.306fe00000000p+0f, 0x1.ae89fa0000000p-1f,
    0x1.306fe00000000p-1f, 0x1.ae89fa0000000p-2f, 0x1.306fe00000000p-2f, 0x1.ae89fa0000000p-3f,
    0x1.306fe00000000p-3f, 0x1.ae89fa0000000p-4f, 0x1.306fe00000000p-4f, 0x1.ae89fa0000000p-5f,
    0x1.306fe00000000p-5f, 0x1.ae89fa0000000p-6f, 0x1.306fe00000000p-6f, 0x1.ae89fa0000000p-7f,
    0x1.306fe00000000p-7f, 0x1.ae89fa0000000p-8f, 0x1.306fe00000000p-8f, 0x1.ae89fa0000000p-9f,
    0x1.306fe00000000p-9f, 0x1.ae89fa0000000p-10f, 0x1.306fe00000000p-10f, 0x1.ae89fa0000000p-11f,
    0x1.306fe00000000p-11f, 0x1.ae89fa0000000p-12f, 0x1.306fe00000000p-12f, 0x1.ae89fa0000000p-13f,
    0x1.306fe00000000p-13f, 0x1.ae89fa0000000p-14f, 0x1.306fe00000000p-14f, 0x1.ae89fa0000000p-15f,
};

// Everything that the inputs of a return are made of. Rows are read from a few cells to its left to some to its right.
struct Surroundings {
  std::int32_t base;                 // where distances are counted from; all ranges are sixteenths of a cell
  const std::int32_t* last;          // the eight last returns of the row, the latest first
  const std::int32_t *up, *upper;    // the two rows above, from this cell on
  const std::uint32_t* sizes;        // differences of the row above, from this cell on
  const std::uint8_t *here, *above, *below;  // returns of this row, of the one above and of the one below
  const std::int32_t *seen, *seen_above, *seen_below;  // what is expected; only where something is
  const std::uint8_t* known;                           // whether something is
  std::int32_t level, bias;           // of this row above the one above, of what comes above what is expected; sixteenths
  std::uint32_t size1, size2, mean, miss;  // differences, sixteenths: predictive/rows.hpp
  std::uint32_t scale, leaves, row, gap, step;
  bool begun;
};

namespace inputs {

using Floats = float __attribute__((vector_size(16)));
using Ints = std::int32_t __attribute__((vector_size(16)));

// 16 log2 of a number of at least 1, by a straight line within each octave; steps of a sixteenth of an octave.
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

// Four numbers that 8 bits hold. What follows may overwrite those of them that are too many.
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

// Four times four numbers, kept within -127 and 127.
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

// Of four bytes, 0 or 1 each: 32 where they are 1.
inline void put_flags(const std::uint8_t* from, std::int8_t* to) {
  std::uint32_t flags;
  std::memcpy(&flags, from, sizeof flags);
  flags <<= 5;  // no byte reaches into the next
  std::memcpy(to, &flags, sizeof flags);
}

// Four distances: how far `of` lies above `from`, both in sixteenths of a cell, and quarters of a cell more.
struct Apart {
  Ints of, from, more{};
  Ints quarters() const { return ((of - from) >> 2) + more; }
};
using Aparts = std::array<Apart, 4>;

// Where the first so many of four inputs stand.
struct Place {
  std::uint8_t at, count;
};
using Places = std::array<Place, 4>;
inline constexpr Places kNowhere{};

// The two forms of distances in ranges or quarters of them, in units of one scale.
struct Forms {
  Floats units;  // in a quarter

  // By logarithm: 16 log2(1 + units), up to 127, with the sign.
  Ints companded(Ints quarters) const {
    const Ints signs = quarters >> 31;
    const Floats size = __builtin_convertvector(with_sign(quarters, signs), Floats) * units;
    return with_sign(least(log2_16(size + 1.0f), Ints{} + 127), signs);
  }

  // Straight: 16 to a unit, rounded, -127 to 127.
  Ints straight(Ints quarters) const {
    const Ints signs = quarters >> 31;
    const Floats size = __builtin_convertvector(with_sign(quarters, signs), Floats) * (units * 16.0f);
    return with_sign(__builtin_convertvector(least(size + 0.5f, Floats{} + 127.0f), Ints), signs);
  }
};

// Puts two times four groups of distances where A and B say, the first Straight of each four straight, the others by
// their logarithm.
struct OneByOne {
  template <std::size_t Straight, Places A, Places B>
  static void put(const Forms& forms, const Aparts& a, const Aparts& b, std::int8_t* in) {
    put_four<Straight, A>(forms, a, in);
    put_four<Straight, B>(forms, b, in);
  }

 private:
  template <std::size_t Straight, Places To>
  static void put_four(const Forms& forms, const Aparts& groups, std::int8_t* in) {
    for (std::size_t g = 0; g < To.size(); ++g) {
      if (To[g].count == 0) continue;
      const Ints quarters = groups[g].quarters(), numbers = g < Straight ? forms.straight(quarters) : forms.companded(quarters);
      std::array<std::int8_t, 4> bytes;
      inputs::put(numbers, bytes.data());
      std::memcpy(in + To[g].at, bytes.data(), To[g].count);
    }
  }
};

}  // namespace inputs

// Fills the inputs of a return. AtOnce: OneByOne, or the same for a processor that does more at once.
template <bool kExpects, class AtOnce = inputs::OneByOne>
inline void find_inputs(const Surroundings& s, std::int8_t* in) {
  using inputs::four, inputs::Ints, inputs::put, inputs::put_flags, inputs::Apart, inputs::Aparts, inputs::Places, inputs::kNowhere;
  const std::int32_t base = s.base;
  const Ints bases = Ints{} + base;
  const inputs::Forms forms = {inputs::Floats{} + kUnitsInQuarter[s.scale]};
  const auto away = [&](const std::int32_t* ranges) { return Apart{four(ranges), bases}; };
  const auto apart = [&](const std::int32_t* a, const std::int32_t* b) { return Apart{four(a), four(b)}; };
  const Apart levelled = {four(s.up), bases, Ints{} + (s.level >> 2)};
  const Ints upper = four(s.upper);
  const Apart of_upper = {Ints{upper[0], upper[1], upper[1], upper[1]}, Ints{base, base, s.up[1], upper[0]}};
  constexpr Places kRow = {{{0, 3}, {3, 4}, {7, 4}, {11, 2}}}, kAbove = {{{13, 4}, {17, 4}, {21, 3}, {24, 2}}},
                   kAround = {{{26, 4}, {30, 2}, {32, 3}, {35, 4}}};
  const Aparts row = {away(s.last + 1), away(s.last + 4), away(s.up - 3), away(s.up + 1)};
  const Aparts above = {away(s.up + 3), away(s.upper - 1), away(s.last + 1), away(s.up - 1)};
  const Aparts around = {away(s.up + 1), levelled, apart(s.up, s.up - 1), of_upper};
  if constexpr (kExpects) {
    constexpr Places kSeen = {{{69, 3}, {72, 4}, {76, 2}, {78, 4}}}, kSeenOn = {{{82, 2}, {84, 4}, {88, 2}, {90, 3}}},
                     kSurprise = {{{106, 2}, {108, 4}, {93, 4}, {97, 4}}};
    const Ints seen = four(s.seen), bias = Ints{} + (s.bias >> 2), last_only = {0, 0, 0, -1}, third_only = {0, 0, -1, 0};
    const std::int32_t next_below = s.seen_below[1], this_below = s.seen_below[0];
    const Apart below = {Ints{this_below, next_below, this_below, 0}, Ints{base, base, s.seen[0], 0}, bias & last_only};
    const Apart last = {Ints{s.up[2], s.up[3], 0, next_below}, Ints{s.seen_above[2], s.seen_above[3], 0, this_below}, bias & third_only};
    AtOnce::template put<4, kRow, kSeen>(forms, row, {levelled, away(s.seen - 3), away(s.seen + 1), away(s.seen + 3)}, in);
    AtOnce::template put<2, kAbove, kSurprise>(forms, above, {apart(s.up, s.seen_above), last, apart(s.up - 1, s.seen_above - 1), below}, in);
    AtOnce::template put<0, kAround, kSeenOn>(forms, around, {away(s.seen - 1), away(s.seen + 1), Apart{seen, bases, bias}, apart(s.seen, s.seen - 1)}, in);
  } else {
    constexpr Places kLevelled = {{{69, 3}, {}, {}, {}}};
    AtOnce::template put<4, kRow, kLevelled>(forms, row, {levelled}, in);
    AtOnce::template put<2, kAbove, kNowhere>(forms, above, {}, in);
    AtOnce::template put<0, kAround, kNowhere>(forms, around, {}, in);
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
      Ints{4 * static_cast<std::int32_t>(s.scale) - 50, inputs::log2_16(native) / 2 - 90, inputs::log2_16(s.step) - 48, 8 * (leaves >> 4 & 15) - 60},
      Ints{8 * (leaves & 15) - 60, 2 * static_cast<std::int32_t>(s.row) - 64, inputs::log2_16(s.gap), s.begun ? 32 : 0}, in + 39);
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
