// A layer of a network for processors with AVX2: sixteen products of 16 bits at a time.
#pragma once
#include <immintrin.h>

#include <cstring>

#include "network/net_plain.hpp"

namespace lidarcodec::net_forms {

// Two adjacent values of 16 bits, or four of 8 bits.
inline std::int32_t four_bytes_at(const void* in) {
  std::int32_t bytes;
  std::memcpy(&bytes, in, sizeof bytes);
  return bytes;
}

// N returns at once, two blocks of eight sums each.
template <std::size_t N>
__attribute__((target("avx2"))) void layer_avx2(const Layer& layer, const std::array<InitialSums, N>& initial,
                                                const std::array<const std::int16_t*, N>& in,
                                                const std::array<std::int16_t*, N>& out) {
  const __m128i shift = _mm_cvtsi32_si128(static_cast<int>(layer.shift));
  const __m256i low = _mm256_set1_epi32(layer.low), high = _mm256_set1_epi32(layer.high);
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    __m256i sums[N][2];
#pragma GCC unroll 4
    for (std::size_t r = 0; r < N; ++r) {
      const auto* row = reinterpret_cast<const __m256i*>(initial[r].row + block * kTileOutputs);
      const auto* scale = reinterpret_cast<const __m256i*>(initial[r].scale + block * kTileOutputs);
      sums[r][0] = _mm256_add_epi32(_mm256_load_si256(row), _mm256_load_si256(scale));
      sums[r][1] = _mm256_add_epi32(_mm256_load_si256(row + 1), _mm256_load_si256(scale + 1));
    }
    const std::size_t end = layer.tiles_of[block + 1];
    const auto* w = reinterpret_cast<const __m256i*>(layer.weights.data() + layer.tiles_of[block] * kTileWeights);
    for (std::size_t tile = layer.tiles_of[block]; tile < end; ++tile) {
      const std::size_t at = layer.inputs_of[tile];
#pragma GCC unroll 2
      for (std::size_t pair = 0; pair < 2; ++pair, w += 2) {
        const __m256i w0 = _mm256_load_si256(w), w1 = _mm256_load_si256(w + 1);
#pragma GCC unroll 4
        for (std::size_t r = 0; r < N; ++r) {
          const __m256i x = _mm256_set1_epi32(four_bytes_at(in[r] + at + 2 * pair));
          sums[r][0] = _mm256_add_epi32(sums[r][0], _mm256_madd_epi16(x, w0));
          sums[r][1] = _mm256_add_epi32(sums[r][1], _mm256_madd_epi16(x, w1));
          // Keeps the compiler from adding the products of both pairs first, for which there are too few registers.
          asm("" : "+x"(sums[r][0]), "+x"(sums[r][1]));
        }
      }
    }
#pragma GCC unroll 4
    for (std::size_t r = 0; r < N; ++r) {
      __m256i done[2];
#pragma GCC unroll 2
      for (std::size_t v = 0; v < 2; ++v)
        done[v] = _mm256_min_epi32(_mm256_max_epi32(_mm256_sra_epi32(sums[r][v], shift), low), high);
      const __m256i packed = _mm256_permute4x64_epi64(_mm256_packs_epi32(done[0], done[1]), 0xd8);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(out[r] + block * kTileOutputs), packed);
    }
  }
}

}  // namespace lidarcodec::net_forms
