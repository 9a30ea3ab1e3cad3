// A layer of a network by the vectors of WebAssembly: the same sums as layer_plainly of native/src/riddle_net.cpp.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>

#include <wasm_simd128.h>

namespace lidarcodec::wasm {

// N returns at once. Blocks of 16 sums, each of four lanes of four; weights lie in pairs, one for each of two inputs, those of
// all blocks for the first two inputs first.
template <std::size_t N, class Layer>
void layer_by_vectors(const Layer& layer, const std::array<const std::int16_t*, N>& in, const std::array<std::int16_t*, N>& out) {
  constexpr std::size_t kBlock = 16, kVectors = 4;
  const v128_t low = wasm_i32x4_splat(layer.low), high = wasm_i32x4_splat(layer.high);
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    v128_t sums[N][kVectors];
#pragma clang loop unroll(full)
    for (std::size_t r = 0; r < N; ++r)
      for (std::size_t v = 0; v < kVectors; ++v) sums[r][v] = wasm_v128_load(layer.bias.data() + block * kBlock + 4 * v);
    const std::int16_t* w = layer.weights.data() + block * 2 * kBlock;
    for (std::size_t i = 0; i < layer.in; i += 2, w += layer.blocks() * 2 * kBlock) {
#pragma clang loop unroll(full)
      for (std::size_t v = 0; v < kVectors; ++v) {
        const v128_t weights = wasm_v128_load(w + 8 * v);
#pragma clang loop unroll(full)
        for (std::size_t r = 0; r < N; ++r)
          sums[r][v] = wasm_i32x4_add(sums[r][v], wasm_i32x4_dot_i16x8(wasm_v128_load32_splat(in[r] + i), weights));
      }
    }
#pragma clang loop unroll(full)
    for (std::size_t r = 0; r < N; ++r) {
      v128_t done[kVectors];
      for (std::size_t v = 0; v < kVectors; ++v)
        done[v] = wasm_i32x4_min(wasm_i32x4_max(wasm_i32x4_shr(sums[r][v], layer.shift), low), high);
      wasm_v128_store(out[r] + block * kBlock, wasm_i16x8_narrow_i32x4(done[0], done[1]));
      wasm_v128_store(out[r] + block * kBlock + 8, wasm_i16x8_narrow_i32x4(done[2], done[3]));
    }
  }
}

}  // namespace lidarcodec::wasm
