// Four numbers at a time, in vectors of which compilers make what the processor has: two of two, or one of four.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "base/processor.hpp"

#pragma GCC diagnostic ignored "-Wpsabi"  // vectors are handed to nothing that is not inlined

namespace lidarcodec {

using Fours = double __attribute__((vector_size(32)));
using FourInts = std::int32_t __attribute__((vector_size(16)));
using FourMasks = std::int64_t __attribute__((vector_size(32)));  // all ones where something is so, else 0

[[gnu::always_inline]] inline Fours four_times(double a) { return Fours{a, a, a, a}; }
[[gnu::always_inline]] inline FourInts ints_at(const std::int32_t* at) {
  FourInts four;
  std::memcpy(&four, at, sizeof four);
  return four;
}
[[gnu::always_inline]] inline void put(FourInts four, std::int32_t* at) { std::memcpy(at, &four, sizeof four); }
[[gnu::always_inline]] inline FourInts cut_off(Fours a) { return __builtin_convertvector(a, FourInts); }

// a where something is so, else b.
[[gnu::always_inline]] inline Fours chosen(FourMasks so, Fours a, Fours b) {
  return reinterpret_cast<Fours>((reinterpret_cast<FourMasks>(a) & so) | (reinterpret_cast<FourMasks>(b) & ~so));
}
[[gnu::always_inline]] inline Fours size_of(Fours a) { return chosen(a < 0.0, -a, a); }

// What depends on the processor: four whole numbers as others; rounding down, within 2^31; in which of four something is so, a
// bit for each. By reference, as compilers want it where the processor's vectors are shorter.
struct FoursByTwo {
  [[gnu::always_inline]] static void widen(FourInts a, Fours& to) { to = __builtin_convertvector(a, Fours); }
  [[gnu::always_inline]] static void round_down(Fours& a) {
    const Fours whole = __builtin_convertvector(cut_off(a), Fours);
    a = whole - chosen(a < whole, four_times(1), Fours{});
  }
  [[gnu::always_inline]] static std::uint32_t set(const FourMasks& so) {
#if defined(__x86_64__)
    __m128d halves[2];
    std::memcpy(halves, &so, sizeof halves);
    return static_cast<std::uint32_t>(_mm_movemask_pd(halves[0]) | _mm_movemask_pd(halves[1]) << 2);
#else
    return static_cast<std::uint32_t>((so[0] & 1) | (so[1] & 2) | (so[2] & 4) | (so[3] & 8));
#endif
  }
};

#if defined(__x86_64__)
struct FoursAtOnce {
  LIDARCODEC_AVX2 static void widen(FourInts a, Fours& to) { to = reinterpret_cast<Fours>(_mm256_cvtepi32_pd(reinterpret_cast<__m128i>(a))); }
  LIDARCODEC_AVX2 static void round_down(Fours& a) { a = reinterpret_cast<Fours>(_mm256_floor_pd(reinterpret_cast<__m256d>(a))); }
  LIDARCODEC_AVX2 static std::uint32_t set(const FourMasks& so) {
    return static_cast<std::uint32_t>(_mm256_movemask_pd(reinterpret_cast<__m256d>(so)));
  }
};
#endif

template <class Form>
[[gnu::always_inline]] inline Fours fours_of(FourInts a) {
  Fours four;
  Form::widen(a, four);
  return four;
}
template <class Form>
[[gnu::always_inline]] inline Fours rounded_down(Fours a) {
  Form::round_down(a);
  return a;
}

}  // namespace lidarcodec
