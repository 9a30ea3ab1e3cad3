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

#include "predictive_tables.hpp"
#include "riddle_net.hpp"

#if defined(__SSE2__)
#include <emmintrin.h>
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
  const std::int32_t* last;          // the eight last returns of the row, the latest first
  const std::int32_t *up, *upper;    // the two rows above, from this cell on
  const std::uint32_t* sizes;        // differences of the row above, from this cell on
  const std::uint8_t *here, *above, *below;  // returns of this row, of the one above and of the one below
  const std::int32_t *seen, *seen_above, *seen_below;  // what is expected; only where something is
  const std::uint8_t* known;                           // whether something is
  std::int32_t level, bias;           // of this row above the one above, of what comes above what is expected; sixteenths
  std::uint32_t size1, size2, mean, miss;  // differences, sixteenths: predictive_rows.hpp
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
#else
  for (std::size_t i = 0; i < 4; ++i) to[i] = static_cast<std::int8_t>(numbers[i]);
#endif
}

inline Ints kept(Ints numbers) { return most(least(numbers, Ints{} + 127), Ints{} - 127); }

// Of four bytes, 0 or 1 each: 32 where they are 1.
inline constexpr auto kFlags = [] {
  std::array<std::array<std::int8_t, 4>, 16> flags{};
  for (std::size_t bits = 0; bits < 16; ++bits)
    for (std::size_t i = 0; i < 4; ++i) flags[bits][i] = (bits >> i & 1u) != 0 ? 32 : 0;
  return flags;
}();
inline void put_flags(const std::uint8_t* from, std::int8_t* to) {
  const auto bits = static_cast<std::size_t>(from[0] | from[1] << 1 | from[2] << 2 | from[3] << 3);
  std::memcpy(to, kFlags[bits].data(), sizeof kFlags[bits]);
}

// The two forms of distances in ranges or quarters of them, in units of one scale.
struct Forms {
  Floats units;  // in a quarter
  Ints base;

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

  Ints from_base(const std::int32_t* ranges) const { return (four(ranges) - base) << 2; }
};

// Two times four distances, in quarters, in one of the forms, to where they belong; those of `a` first.
struct OneByOne {
  static void straight(const Forms& forms, Ints a, Ints b, std::int8_t* to_a, std::int8_t* to_b) {
    put(forms.straight(a), to_a);
    put(forms.straight(b), to_b);
  }
  static void companded(const Forms& forms, Ints a, Ints b, std::int8_t* to_a, std::int8_t* to_b) {
    put(forms.companded(a), to_a);
    put(forms.companded(b), to_b);
  }
};

}  // namespace inputs

// Fills the inputs of a return. What is written later may overwrite what was too much before. Pairs: OneByOne, or the
// same for a processor that does both at once.
template <bool kExpects, class Pairs = inputs::OneByOne>
inline void find_inputs(const Surroundings& s, std::int8_t* in) {
  using inputs::four, inputs::Ints, inputs::put, inputs::put_flags;
  const std::int32_t base = s.last[0];
  const inputs::Forms forms = {inputs::Floats{} + kUnitsInQuarter[s.scale], Ints{} + base};
  const auto away = [&](const std::int32_t* ranges) { return forms.from_base(ranges); };
  const auto apart = [&](const std::int32_t* a, const std::int32_t* b) { return (four(a) - four(b)) << 2; };
  const auto straight = [&](Ints a, std::size_t at, Ints b, std::size_t at_b) { Pairs::straight(forms, a, b, in + at, in + at_b); };
  const auto companded = [&](Ints a, std::size_t at, Ints b, std::size_t at_b) { Pairs::companded(forms, a, b, in + at, in + at_b); };
  const Ints levelled = away(s.up) + (s.level >> 2);
  straight(away(s.last + 1), 0, away(s.last + 4), 3);
  straight(away(s.up - 3), 7, away(s.up + 1), 11);
  straight(away(s.up + 3), 13, away(s.upper - 1), 17);
  companded(away(s.last + 1), 21, away(s.up - 1), 24);
  companded(away(s.up + 1), 26, levelled, 30);
  const std::int32_t upper = s.upper[0], next = s.upper[1];
  companded(apart(s.up, s.up - 1), 32, Ints{upper - base, next - base, next - s.up[1], next - upper} << 2, 35);
  const std::int32_t scale_of = 8 * static_cast<std::int32_t>(s.scale) + 12;
  const auto sizes = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) {
    using Unsigned = std::uint32_t __attribute__((vector_size(16)));
    const auto numbers = std::bit_cast<Ints>(Unsigned{a, b, c, d} + 2);  // at most 2^20 and two
    return inputs::kept(inputs::log2_16(__builtin_convertvector(numbers, inputs::Floats)) - scale_of);
  };
  put(sizes(s.size1, s.size2, s.mean, s.sizes[-1]), in + 39);
  put(sizes(s.sizes[0], s.sizes[1], s.sizes[2], s.sizes[4]), in + 43);
  const auto native = static_cast<std::uint32_t>(std::max(base, 1)) * s.step;
  const auto leaves = static_cast<std::int32_t>(s.leaves);
  put(inputs::kept(Ints{4 * static_cast<std::int32_t>(s.scale) - 50, inputs::log2_16(native) / 2 - 90,
                        inputs::log2_16(s.step) - 48, 8 * (leaves >> 4 & 15) - 60}), in + 47);
  put(inputs::kept(Ints{8 * (leaves & 15) - 60, 2 * static_cast<std::int32_t>(s.row) - 64, inputs::log2_16(s.gap),
                        s.begun ? 32 : 0}), in + 51);
  put_flags(s.here - 3, in + 55);
  put_flags(s.here + 1, in + 58);
  put_flags(s.above - 1, in + 61);
  put_flags(s.below - 1, in + 65);
  if constexpr (!kExpects) {
    put(forms.straight(levelled), in + 69);
  } else {
    straight(levelled, 69, away(s.seen - 3), 72);
    straight(away(s.seen + 1), 76, away(s.seen + 3), 78);
    companded(away(s.seen - 1), 82, away(s.seen + 1), 84);
    companded(away(s.seen) + (s.bias >> 2), 88, apart(s.seen, s.seen - 1), 90);
    const Ints below = Ints{s.seen_below[0] - base, s.seen_below[1] - base, s.seen_below[0] - s.seen[0], 0} << 2;
    companded(apart(s.up - 1, s.seen_above - 1), 93, below + Ints{0, 0, 0, s.bias >> 2}, 97);
    in[101] = in[100];
    in[100] = static_cast<std::int8_t>(sizes(s.miss, 0, 0, 0)[0]);
    put_flags(s.known - 1, in + 102);
    const std::int32_t step_below = s.seen_below[1] - s.seen_below[0];
    const Ints last = Ints{s.up[2] - s.seen_above[2], s.up[3] - s.seen_above[3], 0, step_below} << 2;
    straight(apart(s.up, s.seen_above), 106, last + Ints{0, 0, s.bias >> 2, 0}, 108);
  }
}

}  // namespace lidarcodec
