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

inline Ints quarters_at(const std::int32_t* from) {
  Ints four;
  std::memcpy(&four, from, sizeof four);
  return four;
}

inline Ints least(Ints a, Ints b) { return a < b ? a : b; }
inline Floats least(Floats a, Floats b) { return a < b ? a : b; }

inline Ints with_sign(Ints sizes, Ints signs) { return (sizes ^ signs) - signs; }

// Eight numbers that 16 bits hold.
inline void put(Ints low, Ints high, std::int16_t* to) {
#if defined(__SSE2__)
  const __m128i packed = _mm_packs_epi32(std::bit_cast<__m128i>(low), std::bit_cast<__m128i>(high));
  _mm_storeu_si128(reinterpret_cast<__m128i*>(to), packed);
#else
  for (std::size_t i = 0; i < 4; ++i) {
    to[i] = static_cast<std::int16_t>(low[i]);
    to[4 + i] = static_cast<std::int16_t>(high[i]);
  }
#endif
}

// Straight: 16 to a unit, rounded, -127 to 127. `units`: times 16.
inline Ints straight_four(const std::int32_t* quarters, Floats units) {
  const Ints q = quarters_at(quarters), signs = q >> 31;
  const Floats size = __builtin_convertvector(with_sign(q, signs), Floats) * units;
  return with_sign(__builtin_convertvector(least(size + 0.5f, Floats{} + 127.0f), Ints), signs);
}

// By logarithm: 16 log2(1 + units), up to 127, with the sign.
inline Ints companded_four(const std::int32_t* quarters, Floats units) {
  const Ints q = quarters_at(quarters), signs = q >> 31;
  const Floats size = __builtin_convertvector(with_sign(q, signs), Floats) * units;
  return with_sign(least(log2_16(size + 1.0f), Ints{} + 127), signs);
}

// In groups of eight: up to seven more than `count` are read and written.
inline void straight(const std::int32_t* quarters, std::size_t count, float units, std::int16_t* to) {
  const Floats times = Floats{} + units * 16.0f;
  for (std::size_t i = 0; i < count; i += 8) put(straight_four(quarters + i, times), straight_four(quarters + i + 4, times), to + i);
}

inline void companded(const std::int32_t* quarters, std::size_t count, float units, std::int16_t* to) {
  const Floats times = Floats{} + units;
  for (std::size_t i = 0; i < count; i += 8) put(companded_four(quarters + i, times), companded_four(quarters + i + 4, times), to + i);
}

inline std::int16_t kept(std::int32_t x) { return static_cast<std::int16_t>(std::clamp(x, -127, 127)); }

}  // namespace inputs

// Fills the inputs of a return.
template <bool kExpects>
inline void find_inputs(const Surroundings& s, std::int16_t* to) {
  const std::int32_t base = s.last[0];
  const float units = kUnitsInQuarter[s.scale];
  std::int32_t q[24] = {};
  std::int16_t* at = to;
  const auto from_base = [&](const std::int32_t* from, std::size_t count, std::int32_t* into) {
    for (std::size_t i = 0; i < count; ++i) into[i] = 4 * (from[i] - base);
  };
  const auto steps = [](const std::int32_t* from, std::size_t count, std::int32_t* into) {
    for (std::size_t i = 0; i < count; ++i) into[i] = 4 * (from[i + 1] - from[i]);
  };
  from_base(s.last + 1, 7, q);
  from_base(s.up - 3, 10, q + 7);
  from_base(s.upper - 1, 4, q + 17);
  inputs::straight(q, 21, units, at);
  at += 21;
  std::copy_n(q, 3, q);               // the returns before the last one
  std::copy_n(q + 9, 6, q + 3);       // the row above from the left on
  q[9] = q[4] + (s.level >> 2);       // levelled, here and to the right
  q[10] = q[5] + (s.level >> 2);
  steps(s.up - 1, 3, q + 11);
  q[14] = 4 * (s.upper[0] - base);
  q[15] = 4 * (s.upper[1] - base);
  q[16] = 4 * (s.upper[1] - s.up[1]);
  q[17] = 4 * (s.upper[1] - s.upper[0]);
  inputs::companded(q, 18, units, at);
  at += 18;
  const std::int32_t scale_of = 8 * static_cast<std::int32_t>(s.scale) + 12;
  const auto relative = [&](std::uint32_t size) { return inputs::kept(inputs::log2_16(size + 2) - scale_of); };
  for (const std::uint32_t size : {s.size1, s.size2, s.mean, s.sizes[-1], s.sizes[0], s.sizes[1], s.sizes[2], s.sizes[4]})
    *at++ = relative(size);
  const auto native = static_cast<std::uint32_t>(std::max(base, 1)) * s.step;
  *at++ = inputs::kept(4 * static_cast<std::int32_t>(s.scale) - 50);
  *at++ = inputs::kept(inputs::log2_16(native) / 2 - 90);
  *at++ = inputs::kept(inputs::log2_16(s.step) - 48);
  *at++ = static_cast<std::int16_t>(8 * static_cast<std::int32_t>(s.leaves >> 4 & 15) - 60);
  *at++ = static_cast<std::int16_t>(8 * static_cast<std::int32_t>(s.leaves & 15) - 60);
  *at++ = static_cast<std::int16_t>(2 * static_cast<std::int32_t>(s.row) - 64);
  *at++ = inputs::kept(inputs::log2_16(s.gap));
  *at++ = s.begun ? 32 : 0;
  const auto flags = [&](const std::uint8_t* from, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) *at++ = static_cast<std::int16_t>(32 * from[i]);
  };
  flags(s.here - 3, 3);
  flags(s.here + 1, 3);
  flags(s.above - 1, 4);
  flags(s.below - 1, 4);
  at = std::fill_n(at, to + kInputsAlone - at, std::int16_t{0});
  if constexpr (kExpects) {
    from_base(s.seen - 3, 10, q);
    inputs::straight(q, 10, units, at);
    at += 10;
    std::copy_n(q + 2, 6, q);  // from the left on
    q[6] = q[1] + (s.bias >> 2);
    q[7] = q[2] + (s.bias >> 2);
    steps(s.seen - 1, 3, q + 8);
    for (std::ptrdiff_t k = -1; k < 3; ++k) q[12 + k] = 4 * (s.up[k] - s.seen_above[k]);
    q[15] = 4 * (s.seen_below[0] - base);
    q[16] = 4 * (s.seen_below[1] - base);
    q[17] = 4 * (s.seen_below[0] - s.seen[0]);
    inputs::companded(q, 18, units, at);
    at += 18;
    *at++ = relative(s.miss);
    q[0] = s.bias >> 2;
    *at++ = static_cast<std::int16_t>(inputs::companded_four(q, inputs::Floats{} + units)[0]);
    flags(s.known - 1, 4);
    std::fill_n(at, to + kInputsExpecting - at, std::int16_t{0});
  }
}

}  // namespace lidarcodec
