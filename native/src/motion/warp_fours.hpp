// Four numbers at a time. Compilers turn these vectors into what the processor has: two registers of two, or one of
// four.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "base/processor.hpp"

#pragma GCC diagnostic ignored "-Wpsabi"  // all functions that take vectors are inlined

namespace lidarcodec {

using Fours = double __attribute__((vector_size(32)));
using FourInts = std::int32_t __attribute__((vector_size(16)));
using FourMasks = std::int64_t __attribute__((vector_size(32)));  // all ones: true; 0: false

[[gnu::always_inline]] inline Fours broadcast(double a) { return Fours{a, a, a, a}; }
[[gnu::always_inline]] inline FourInts load(const std::int32_t* at) {
  FourInts four;
  std::memcpy(&four, at, sizeof four);
  return four;
}
[[gnu::always_inline]] inline void store(FourInts four, std::int32_t* at) { std::memcpy(at, &four, sizeof four); }
[[gnu::always_inline]] inline FourInts truncated(Fours a) { return __builtin_convertvector(a, FourInts); }

// a where `so` is true, else b.
[[gnu::always_inline]] inline Fours select(FourMasks so, Fours a, Fours b) {
  return reinterpret_cast<Fours>((reinterpret_cast<FourMasks>(a) & so) | (reinterpret_cast<FourMasks>(b) & ~so));
}
[[gnu::always_inline]] inline Fours absolute(Fours a) { return select(a < 0.0, -a, a); }

// What depends on the processor: conversion from whole numbers, rounding down (of numbers within 2^31), and a mask as
// four bits. By reference, which compilers need where the processor's registers are shorter.
struct FoursInTwo {
  [[gnu::always_inline]] static void widen(FourInts a, Fours& to) { to = __builtin_convertvector(a, Fours); }
  [[gnu::always_inline]] static void round_down(Fours& a) {
    const Fours whole = __builtin_convertvector(truncated(a), Fours);
    a = whole - select(a < whole, broadcast(1), Fours{});
  }
  [[gnu::always_inline]] static std::uint32_t bits_of(const FourMasks& so) {
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
struct FoursInOne {
  LIDARCODEC_AVX2 static void widen(FourInts a, Fours& to) {
    to = reinterpret_cast<Fours>(_mm256_cvtepi32_pd(reinterpret_cast<__m128i>(a)));
  }
  LIDARCODEC_AVX2 static void round_down(Fours& a) {
    a = reinterpret_cast<Fours>(_mm256_floor_pd(reinterpret_cast<__m256d>(a)));
  }
  LIDARCODEC_AVX2 static std::uint32_t bits_of(const FourMasks& so) {
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
