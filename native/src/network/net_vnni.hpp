// Networks for processors with AVX-512 VNNI: sixty-four products of 8 bits at a time, or thirty-two of 16 bits.
#pragma once
#include <immintrin.h>

#include "network/net_avx2.hpp"

#define LIDARCODEC_VNNI __attribute__((target("avx512f,avx512bw,avx512vl,avx512vnni")))

namespace lidarcodec::net_forms {

struct alignas(64) Bytes {
  std::array<std::uint8_t, kMaxHidden> of;
};

// Where a layer's weights of a type begin, and how many bytes a tile has of them.
template <class Value>
const std::byte* weights_vnni(const Layer& layer) {
  return reinterpret_cast<const std::byte*>(sizeof(Value) == 1 ? static_cast<const void*>(layer.byte_weights.data())
                                                               : layer.weights.data());
}
template <class Value>
inline constexpr std::size_t kTileBytes = kTileWeights * sizeof(Value);

// Adds the products of a register of weights and four bytes of values, unsigned if they are bytes.
template <class Value>
LIDARCODEC_VNNI __m512i with_products(__m512i sums, const Value* x, const std::byte* w) {
  const __m512i values = _mm512_set1_epi32(four_bytes_at(x)), weights = _mm512_load_si512(w);
  return sizeof(Value) == 1 ? _mm512_dpbusd_epi32(sums, values, weights) : _mm512_dpwssd_epi32(sums, values, weights);
}

template <class Out>
LIDARCODEC_VNNI void clip_vnni(__m512i sums, const Layer& layer, Out* to) {
  const __m512i shifted = _mm512_sra_epi32(sums, _mm_cvtsi32_si128(static_cast<int>(layer.shift)));
  const __m512i done =
      _mm512_min_epi32(_mm512_max_epi32(shifted, _mm512_set1_epi32(layer.low)), _mm512_set1_epi32(layer.high));
  if constexpr (sizeof(Out) == 1) {
    _mm_storeu_si128(reinterpret_cast<__m128i*>(to), _mm512_cvtepi32_epi8(done));
  } else {
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(to), _mm512_cvtepi32_epi16(done));
  }
}

// Blocks of outputs of N returns, from `first` on, of a layer without pruned tiles; values are unsigned, of 8 or 16
// bits. Each sum is kept in S parts: enough that no addition waits for the one before it, and few enough for the
// registers.
template <std::size_t N, std::size_t Blocks, std::size_t S, class Value, class Out>
LIDARCODEC_VNNI void blocks_vnni(const Layer& layer, const std::array<InitialSums, N>& initial, std::size_t first,
                                 const std::array<const Value*, N>& in, const std::array<Out*, N>& out) {
  constexpr std::size_t kAtOnce = 4 / sizeof(Value);  // inputs of a sum
  const std::size_t of_block = layer.in / kTileInputs * kTileBytes<Value>;
  const std::byte* w = weights_vnni<Value>(layer) + first * of_block;
  __m512i sums[N][Blocks][S];
#pragma GCC unroll 4
  for (std::size_t r = 0; r < N; ++r)
#pragma GCC unroll 8
    for (std::size_t b = 0; b < Blocks; ++b) {
      const std::size_t at = (first + b) * kTileOutputs;
      sums[r][b][0] =
          _mm512_add_epi32(_mm512_load_si512(initial[r].row + at), _mm512_load_si512(initial[r].scale + at));
#pragma GCC unroll 4
      for (std::size_t s = 1; s < S; ++s) sums[r][b][s] = _mm512_setzero_si512();
    }
  for (std::size_t i = 0; i < layer.in; i += kAtOnce * S) {
#pragma GCC unroll 4
    for (std::size_t s = 0; s < S; ++s, w += 64)
#pragma GCC unroll 8
      for (std::size_t b = 0; b < Blocks; ++b)
#pragma GCC unroll 4
        for (std::size_t r = 0; r < N; ++r)
          sums[r][b][s] = with_products(sums[r][b][s], in[r] + i + kAtOnce * s, w + b * of_block);
  }
#pragma GCC unroll 4
  for (std::size_t r = 0; r < N; ++r)
#pragma GCC unroll 8
    for (std::size_t b = 0; b < Blocks; ++b) {
      __m512i sum = sums[r][b][0];
#pragma GCC unroll 4
      for (std::size_t s = 1; s < S; ++s) sum = _mm512_add_epi32(sum, sums[r][b][s]);
      clip_vnni(sum, layer, out[r] + (first + b) * kTileOutputs);
    }
}

// One block, of a layer with pruned tiles. Each sum is kept in two parts, as above.
template <std::size_t N, class Value, class Out>
LIDARCODEC_VNNI void block_of_tiles_vnni(const Layer& layer, const std::array<InitialSums, N>& initial,
                                         std::size_t block, const std::array<const Value*, N>& in,
                                         const std::array<Out*, N>& out) {
  __m512i sums[N][2];
#pragma GCC unroll 4
  for (std::size_t r = 0; r < N; ++r) {
    sums[r][0] = _mm512_add_epi32(_mm512_load_si512(initial[r].row + block * kTileOutputs),
                                  _mm512_load_si512(initial[r].scale + block * kTileOutputs));
    sums[r][1] = _mm512_setzero_si512();
  }
  std::size_t tile = layer.tiles_of[block];
  const std::size_t end = layer.tiles_of[block + 1];
  const std::byte* w = weights_vnni<Value>(layer) + tile * kTileBytes<Value>;
  const auto add = [&](std::size_t at, std::size_t s) LIDARCODEC_VNNI {
#pragma GCC unroll 2
    for (std::size_t i = 0; i < kTileInputs; i += 4 / sizeof(Value), w += 64)
#pragma GCC unroll 4
      for (std::size_t r = 0; r < N; ++r) sums[r][s] = with_products(sums[r][s], in[r] + at + i, w);
  };
  for (; tile + 2 <= end; tile += 2) {
    add(layer.inputs_of[tile], 0);
    add(layer.inputs_of[tile + 1], 1);
  }
  if (tile < end) add(layer.inputs_of[tile], 0);
#pragma GCC unroll 4
  for (std::size_t r = 0; r < N; ++r)
    clip_vnni(_mm512_add_epi32(sums[r][0], sums[r][1]), layer, out[r] + block * kTileOutputs);
}

template <std::size_t N, class Value, class Out>
void all_blocks_vnni(const Layer& layer, const std::array<InitialSums, N>& initial,
                     const std::array<const Value*, N>& in, const std::array<Out*, N>& out) {
  const std::size_t blocks = layer.blocks();
  if (layer.tiles() < blocks * (layer.in / kTileInputs)) {
    for (std::size_t block = 0; block < blocks; ++block) block_of_tiles_vnni(layer, initial, block, in, out);
    return;
  }
  constexpr std::size_t kParts = N == 4 ? 1 : 2;  // parts of a sum: two where there are few sums
  std::size_t at = 0;
  for (; blocks - at >= 6; at += 6) blocks_vnni<N, 6, 1>(layer, initial, at, in, out);
  for (; blocks - at >= 3; at += 3) blocks_vnni<N, 3, kParts>(layer, initial, at, in, out);
  if (blocks - at == 2) blocks_vnni<N, 2, 2>(layer, initial, at, in, out);
  if (blocks - at == 1) blocks_vnni<N, 1, 2>(layer, initial, at, in, out);
}

// Inputs plus 128, unsigned.
LIDARCODEC_VNNI inline void to_unsigned_vnni(const std::int8_t* in, std::size_t count, Bytes& to) {
  const __m512i by = _mm512_set1_epi8(-128);
  for (std::size_t i = 0; i < count; i += 64) {
    const auto here = count - i >= 64 ? ~__mmask64{0} : (__mmask64{1} << (count - i)) - 1;
    _mm512_store_si512(to.of.data() + i, _mm512_xor_si512(_mm512_maskz_loadu_epi8(here, in + i), by));
  }
}

inline bool in_bytes(const Layer& layer) { return layer.planes == 1; }

LIDARCODEC_VNNI inline void widen_vnni(const std::uint8_t* in, std::size_t count, std::int16_t* to) {
  for (std::size_t i = 0; i < count; i += 32)
    _mm512_store_si512(to + i, _mm512_cvtepu8_epi16(_mm256_load_si256(reinterpret_cast<const __m256i*>(in + i))));
}

// in: values of 8 bits; words: the same in 16 bits, used if the layer's weights do not fit bytes.
template <std::size_t N, class Out>
void layer_vnni(const Layer& layer, const std::array<InitialSums, N>& initial, const std::array<Bytes, N>& in,
                const std::array<std::int16_t*, N>& words, const std::array<Out*, N>& out) {
  std::array<const std::uint8_t*, N> bytes_at;
  std::array<const std::int16_t*, N> words_at;
  for (std::size_t r = 0; r < N; ++r) {
    bytes_at[r] = in[r].of.data();
    words_at[r] = words[r];
  }
  in_bytes(layer) ? all_blocks_vnni(layer, initial, bytes_at, out) : all_blocks_vnni(layer, initial, words_at, out);
}

template <std::size_t N>
void run_vnni(const std::array<Layer, kNetLayers>& layers, const std::array<NetValues*, N>& values) {
  std::array<Bytes, N> in, first, second;
  std::array<Words, N> words;
  std::array<std::uint8_t*, N> to_first, to_second;
  std::array<std::int16_t*, N> to_words, to_hidden, to_odds;
  for (std::size_t r = 0; r < N; ++r) {
    to_unsigned_vnni(values[r]->in.data(), layers[0].in, in[r]);
    to_first[r] = first[r].of.data();
    to_second[r] = second[r].of.data();
    to_words[r] = words[r].of.data();
    to_hidden[r] = values[r]->hidden.data();
    to_odds[r] = values[r]->out.data();
  }
  const auto widen = [](const Layer& layer, const auto& from, const auto& to) {
    for (std::size_t r = 0; r < N; ++r) widen_vnni(from[r].of.data(), layer.in, to[r]);
  };
  if (!in_bytes(layers[0])) widen(layers[0], in, to_words);
  layer_vnni(layers[0], initial_of(layers[0], values), in, to_words, to_first);
  if (!in_bytes(layers[1])) widen(layers[1], first, to_words);
  layer_vnni(layers[1], initial_of(layers[1], values), first, to_words, to_second);
  widen(layers[2], second, to_hidden);
  layer_vnni(layers[2], initial_of(layers[2], values), second, to_hidden, to_odds);
}

}  // namespace lidarcodec::net_forms

#undef LIDARCODEC_VNNI
