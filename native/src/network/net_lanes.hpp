// A layer of a network by vectors of 128 bits, which every x86-64 (SSE2), every 64-bit ARM (NEON) and WebAssembly have.
// `Lanes` has what differs between them: eight sums, how products with two inputs are added, and how many returns and
// eights of sums are computed at once.
#pragma once
#include <type_traits>

#include "network/net_plain.hpp"

#if defined(__SSE2__)
#include <emmintrin.h>  // WebAssembly has its own: native/wasm/sse2
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#if defined(__SSE2__) || defined(__aarch64__)
#define LIDARCODEC_NET_LANES

namespace lidarcodec::net_forms {

#if defined(__SSE2__)

struct Lanes {
  static constexpr std::size_t kReturns = 2, kEights = 1;  // what sixteen registers hold
  using Inputs = __m128i;
  struct Eight {
    __m128i low, high;
  };
  using Sums = Eight;
  using Weights = Eight;  // pairs of them

  template <class Number>
  static __m128i load(const Number* from) {
    return _mm_load_si128(reinterpret_cast<const __m128i*>(from));
  }
  static Sums sums(const std::int32_t* from) { return {load(from), load(from + 4)}; }
  static Sums both(const Sums& a, const Sums& b) {
    return {_mm_add_epi32(a.low, b.low), _mm_add_epi32(a.high, b.high)};
  }
  static Inputs inputs(const std::int16_t* from) { return _mm_loadl_epi64(reinterpret_cast<const __m128i*>(from)); }
  static Weights weights(const std::int16_t* from) { return {load(from), load(from + 8)}; }

  template <int kPair>
  static void add(Sums& to, Inputs in, const Weights& w) {
    const __m128i pair = _mm_shuffle_epi32(in, kPair * 0x55);
    to.low = _mm_add_epi32(to.low, _mm_madd_epi16(pair, w.low));
    to.high = _mm_add_epi32(to.high, _mm_madd_epi16(pair, w.high));
  }

  static void clip(const Sums& sums, const Layer& layer, std::int16_t* out) {
    const auto shift = static_cast<int>(layer.shift);
    const __m128i words = _mm_packs_epi32(_mm_srai_epi32(sums.low, shift), _mm_srai_epi32(sums.high, shift));
    const __m128i low = _mm_set1_epi16(static_cast<short>(layer.low)),
                  high = _mm_set1_epi16(static_cast<short>(layer.high));
    _mm_store_si128(reinterpret_cast<__m128i*>(out), _mm_min_epi16(_mm_max_epi16(words, low), high));
  }
};

#else

struct Lanes {
  static constexpr std::size_t kReturns = 4, kEights = 2;
  using Inputs = int16x4_t;
  struct Sums {
    int32x4_t low, high;
  };
  using Weights = int16x8x2_t;  // of even inputs, of odd inputs

  static Inputs inputs(const std::int16_t* from) { return vld1_s16(from); }
  static Sums sums(const std::int32_t* from) { return {vld1q_s32(from), vld1q_s32(from + 4)}; }
  static Sums both(const Sums& a, const Sums& b) { return {vaddq_s32(a.low, b.low), vaddq_s32(a.high, b.high)}; }
  static Weights weights(const std::int16_t* from) { return vld2q_s16(from); }

  template <int kPair>
  static void add(Sums& to, Inputs in, const Weights& w) {
    to.low = vmlal_lane_s16(to.low, vget_low_s16(w.val[0]), in, 2 * kPair);
    to.high = vmlal_high_lane_s16(to.high, w.val[0], in, 2 * kPair);
    to.low = vmlal_lane_s16(to.low, vget_low_s16(w.val[1]), in, 2 * kPair + 1);
    to.high = vmlal_high_lane_s16(to.high, w.val[1], in, 2 * kPair + 1);
  }

  static int16x8_t clipped(const Sums& sums, const Layer& layer) {
    const int32x4_t shift = vdupq_n_s32(-static_cast<std::int32_t>(layer.shift));
    const int16x8_t words = vqmovn_high_s32(vqmovn_s32(vshlq_s32(sums.low, shift)), vshlq_s32(sums.high, shift));
    const auto low = static_cast<std::int16_t>(layer.low), high = static_cast<std::int16_t>(layer.high);
    return vminq_s16(vmaxq_s16(words, vdupq_n_s16(low)), vdupq_n_s16(high));
  }
  static void clip(const Sums& sums, const Layer& layer, std::int16_t* out) { vst1q_s16(out, clipped(sums, layer)); }
};

#endif

// N returns at once, which share the reads of the weights.
template <std::size_t N>
void layer_in_lanes(const Layer& layer, const std::array<InitialSums, N>& initial,
                    const std::array<const std::int16_t*, N>& in, const std::array<std::int16_t*, N>& out) {
  constexpr std::size_t kEights = Lanes::kEights;
  for (std::size_t at = 0; at < layer.blocks() * kTileOutputs; at += 8 * kEights) {
    Lanes::Sums sums[N][kEights];
#pragma GCC unroll 4
    for (std::size_t r = 0; r < N; ++r)
#pragma GCC unroll 2
      for (std::size_t e = 0; e < kEights; ++e)
        sums[r][e] = Lanes::both(Lanes::sums(initial[r].row + at + 8 * e), Lanes::sums(initial[r].scale + at + 8 * e));
    const std::size_t block = at / kTileOutputs, end = layer.tiles_of[block + 1];
    const std::int16_t* w = layer.weights.data() + layer.tiles_of[block] * kTileWeights + 2 * (at % kTileOutputs);
    for (std::size_t tile = layer.tiles_of[block]; tile < end; ++tile) {
      Lanes::Inputs x[N];
#pragma GCC unroll 4
      for (std::size_t r = 0; r < N; ++r) x[r] = Lanes::inputs(in[r] + layer.inputs_of[tile]);
      const auto add = [&](auto pair) {
#pragma GCC unroll 2
        for (std::size_t e = 0; e < kEights; ++e) {
          const Lanes::Weights of = Lanes::weights(w + 16 * e);
#pragma GCC unroll 4
          for (std::size_t r = 0; r < N; ++r) Lanes::add<pair.value>(sums[r][e], x[r], of);
        }
        w += 2 * kTileOutputs;
      };
      add(std::integral_constant<int, 0>{});
      add(std::integral_constant<int, 1>{});
    }
#pragma GCC unroll 4
    for (std::size_t r = 0; r < N; ++r)
#pragma GCC unroll 2
      for (std::size_t e = 0; e < kEights; ++e) Lanes::clip(sums[r][e], layer, out[r] + at + 8 * e);
  }
}

}  // namespace lidarcodec::net_forms

#endif
