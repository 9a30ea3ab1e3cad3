// Networks for 64-bit ARM with the instructions for dot products (Armv8.2 and later): sixteen products of 8 bits at a
// time.
//
// All values are signed bytes. Hidden values, 0 to 255, are stored minus 128; the initial sums cancel it. Weights of 16
// bits are an upper and a lower byte, and the sums of upper bytes are multiplied by 256.
#pragma once
#include <arm_neon.h>

#include <cstring>

#include "network/net_lanes.hpp"

#if defined(__ARM_FEATURE_DOTPROD)
#define LIDARCODEC_DOT  // all is compiled for such processors
#elif defined(__clang__)
#define LIDARCODEC_DOT __attribute__((target("dotprod")))
#else
#define LIDARCODEC_DOT __attribute__((target("arch=armv8.2-a+dotprod")))
#endif

namespace lidarcodec::net_forms {

// Adds dot products with the first four of `in` to four sums. In assembly, because arm_neon.h of clang++ declares this
// instruction only if it may be used everywhere.
LIDARCODEC_DOT inline int32x4_t with_four(int32x4_t sums, int8x16_t weights, int8x8_t in) {
  asm("sdot %0.4s, %1.16b, %2.4b[0]" : "+w"(sums) : "w"(weights), "w"(in));
  return sums;
}

template <std::size_t N>
LIDARCODEC_DOT inline void add_four(int32x4_t (&sums)[N][4], const std::int8_t* weights, const int8x8_t (&in)[N]) {
#pragma GCC unroll 4
  for (std::size_t v = 0; v < 4; ++v) {
    const int8x16_t of = vld1q_s8(weights + 16 * v);
#pragma GCC unroll 4
    for (std::size_t r = 0; r < N; ++r) sums[r][v] = with_four(sums[r][v], of, in[r]);
  }
}

// Hidden values minus 128, or log odds.
inline void clip(const Lanes::Sums& sums, const Layer& layer, std::int8_t* out) {
  vst1_s8(out, veor_s8(vmovn_s16(Lanes::clipped(sums, layer)), vdup_n_s8(-128)));
}
inline void clip(const Lanes::Sums& sums, const Layer& layer, std::int16_t* out) { Lanes::clip(sums, layer, out); }

template <std::size_t N, class Out>
LIDARCODEC_DOT void layer_dot(const Layer& layer, const std::array<InitialSums, N>& initial,
                              const std::array<const std::int8_t*, N>& in, const std::array<Out*, N>& out) {
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    const std::size_t begin = layer.tiles_of[block], end = layer.tiles_of[block + 1];
    int32x4_t sums[N][4] = {};
    for (std::size_t plane = 0; plane < layer.planes; ++plane) {
#pragma GCC unroll 4
      for (std::size_t r = 0; r < N; ++r)
#pragma GCC unroll 4
        for (std::size_t v = 0; v < 4; ++v) sums[r][v] = vshlq_n_s32(sums[r][v], 8);
      const std::int8_t* w = layer.byte_weights.data() + (plane * layer.tiles() + begin) * kTileWeights;
      for (std::size_t tile = begin; tile < end; ++tile, w += kTileWeights) {
        int8x8_t x[N];
#pragma GCC unroll 4
        for (std::size_t r = 0; r < N; ++r) {
          std::int32_t four;
          std::memcpy(&four, in[r] + layer.inputs_of[tile], sizeof four);
          x[r] = vreinterpret_s8_s32(vdup_n_s32(four));
        }
        add_four(sums, w, x);
      }
    }
#pragma GCC unroll 4
    for (std::size_t r = 0; r < N; ++r) {
#pragma GCC unroll 2
      for (std::size_t h = 0; h < 2; ++h) {
        const std::size_t at = block * kTileOutputs + 8 * h;
        const Lanes::Sums begun = Lanes::both(Lanes::sums(initial[r].row + at), Lanes::sums(initial[r].scale + at));
        clip(Lanes::both(begun, {sums[r][2 * h], sums[r][2 * h + 1]}), layer, out[r] + at);
      }
    }
  }
}

template <std::size_t N>
void run_dot(const std::array<Layer, kNetLayers>& layers, const std::array<NetValues*, N>& values) {
  struct alignas(64) Bytes {
    std::array<std::int8_t, kMaxHidden> of;
  };
  std::array<Bytes, N> first, second;
  std::array<const std::int8_t*, N> in, from_first, from_second;
  std::array<std::int8_t*, N> to_first, to_second;
  std::array<std::int16_t*, N> odds;
  for (std::size_t r = 0; r < N; ++r) {
    in[r] = values[r]->in.data();
    from_first[r] = to_first[r] = first[r].of.data();
    from_second[r] = to_second[r] = second[r].of.data();
    odds[r] = values[r]->out.data();
  }
  layer_dot(layers[0], initial_of(layers[0], values), in, to_first);
  layer_dot(layers[1], initial_of(layers[1], values), from_first, to_second);
  layer_dot(layers[2], initial_of(layers[2], values), from_second, odds);
  for (std::size_t r = 0; r < N; ++r)
    for (std::size_t i = 0; i < layers[1].blocks() * kTileOutputs; ++i)
      values[r]->hidden[i] = static_cast<std::int16_t>(second[r].of[i] + 128);
}

}  // namespace lidarcodec::net_forms

#undef LIDARCODEC_DOT
