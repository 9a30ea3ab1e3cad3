#include "riddle_net.hpp"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <limits>

#include "error.hpp"

#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__wasm__)
#include "riddle_layer.hpp"
#endif

namespace lidarcodec {
namespace {

using Layer = RiddleNet::Layer;
constexpr std::size_t kBlock = 16;

// Hidden values of one return, between two layers.
struct alignas(64) Middle {
  std::array<std::int16_t, kMostHidden> of;
};

std::int16_t settled(std::int32_t sum, const Layer& layer) {
  return static_cast<std::int16_t>(std::clamp(sum >> layer.shift, layer.low, layer.high));
}

// Weights of block after block, for the inputs from `in` on, an even number.
const std::int16_t* weights_at(const Layer& layer, std::size_t block, std::size_t in) {
  return layer.weights.data() + (in / 2 * layer.blocks() + block) * 2 * kBlock;
}

[[maybe_unused]] void layer_plainly(const Layer& layer, const std::int16_t* in, std::int16_t* out) {
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    std::array<std::int32_t, kBlock> sums;
    std::copy_n(layer.bias.data() + block * kBlock, kBlock, sums.begin());
    for (std::size_t i = 0; i < layer.in; i += 2) {
      const std::int16_t* const w = weights_at(layer, block, i);
      for (std::size_t o = 0; o < kBlock; ++o) sums[o] += w[2 * o] * in[i] + w[2 * o + 1] * in[i + 1];
    }
    for (std::size_t o = 0; o < kBlock; ++o) out[block * kBlock + o] = settled(sums[o], layer);
  }
}

#if defined(__x86_64__)

// Two neighbouring values, or four that are bytes, to be multiplied with as many weights.
inline std::int32_t four_bytes_at(const void* in) {
  std::int32_t bytes;
  std::memcpy(&bytes, in, sizeof bytes);
  return bytes;
}

// N returns at once, two blocks of sums each.
template <std::size_t N>
__attribute__((target("avx2"))) void layer_avx2(const Layer& layer, const std::array<const std::int16_t*, N>& in,
                                                const std::array<std::int16_t*, N>& out) {
  const __m128i shift = _mm_cvtsi32_si128(static_cast<int>(layer.shift));
  const __m256i low = _mm256_set1_epi32(layer.low), high = _mm256_set1_epi32(layer.high);
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    const auto* bias = reinterpret_cast<const __m256i*>(layer.bias.data() + block * kBlock);
    // Odd and even pairs are added up apart, so that additions need not wait for each other.
    __m256i sums[N][4];
#pragma GCC unroll 2
    for (std::size_t r = 0; r < N; ++r) {
      sums[r][0] = _mm256_loadu_si256(bias);
      sums[r][1] = _mm256_loadu_si256(bias + 1);
      sums[r][2] = sums[r][3] = _mm256_setzero_si256();
    }
    for (std::size_t i = 0; i < layer.in; i += 4) {
#pragma GCC unroll 2
      for (std::size_t odd = 0; odd < 2; ++odd) {
        const auto* from = reinterpret_cast<const __m256i*>(weights_at(layer, block, i + 2 * odd));
        const __m256i w0 = _mm256_loadu_si256(from), w1 = _mm256_loadu_si256(from + 1);
#pragma GCC unroll 2
        for (std::size_t r = 0; r < N; ++r) {
          const __m256i x = _mm256_set1_epi32(four_bytes_at(in[r] + i + 2 * odd));
          sums[r][2 * odd] = _mm256_add_epi32(sums[r][2 * odd], _mm256_madd_epi16(x, w0));
          sums[r][2 * odd + 1] = _mm256_add_epi32(sums[r][2 * odd + 1], _mm256_madd_epi16(x, w1));
        }
      }
    }
#pragma GCC unroll 2
    for (std::size_t r = 0; r < N; ++r) {
      __m256i done[2];
#pragma GCC unroll 2
      for (std::size_t v = 0; v < 2; ++v) {
        const __m256i sum = _mm256_sra_epi32(_mm256_add_epi32(sums[r][v], sums[r][v + 2]), shift);
        done[v] = _mm256_min_epi32(_mm256_max_epi32(sum, low), high);
      }
      const __m256i packed = _mm256_permute4x64_epi64(_mm256_packs_epi32(done[0], done[1]), 0xd8);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(out[r] + block * kBlock), packed);
    }
  }
}

// Blocks of sums of N returns, from `first` on: of 16-bit values, or of bytes. Sums of S steps in turns are added up apart:
// enough of them at once that none waits for its last product, and few enough for the registers.
template <std::size_t N, std::size_t Blocks, std::size_t S, bool kBytes, class Value>
__attribute__((target("avx512f,avx512bw,avx512vl,avx512vnni"))) void blocks_vnni(
    const Layer& layer, std::size_t first, const std::array<const Value*, N>& in, const std::array<std::int16_t*, N>& out) {
  constexpr std::size_t kAtOnce = 4 / sizeof(Value);  // inputs of a sum
  const std::int32_t* const bias = (kBytes ? layer.byte_bias.data() : layer.bias.data()) + first * kBlock;
  const auto* w = reinterpret_cast<const std::byte*>(kBytes ? static_cast<const void*>(layer.byte_weights.data()) : layer.weights.data()) + first * 64;
  __m512i sums[N][Blocks][S];
#pragma GCC unroll 2
  for (std::size_t r = 0; r < N; ++r)
#pragma GCC unroll 8
    for (std::size_t b = 0; b < Blocks; ++b)
#pragma GCC unroll 4
      for (std::size_t s = 0; s < S; ++s)
        sums[r][b][s] = s == 0 ? _mm512_load_si512(bias + b * kBlock) : _mm512_setzero_si512();
  for (std::size_t i = 0; i < layer.in; i += kAtOnce * S) {
#pragma GCC unroll 4
    for (std::size_t s = 0; s < S; ++s, w += layer.blocks() * 64) {
      __m512i x[N];
#pragma GCC unroll 2
      for (std::size_t r = 0; r < N; ++r) x[r] = _mm512_set1_epi32(four_bytes_at(in[r] + i + kAtOnce * s));
#pragma GCC unroll 8
      for (std::size_t b = 0; b < Blocks; ++b) {
        const __m512i of = _mm512_load_si512(w + b * 64);
#pragma GCC unroll 2
        for (std::size_t r = 0; r < N; ++r)
          sums[r][b][s] = kBytes ? _mm512_dpbusd_epi32(sums[r][b][s], x[r], of) : _mm512_dpwssd_epi32(sums[r][b][s], x[r], of);
      }
    }
  }
  const __m128i shift = _mm_cvtsi32_si128(static_cast<int>(layer.shift));
  const __m512i low = _mm512_set1_epi32(layer.low), high = _mm512_set1_epi32(layer.high);
#pragma GCC unroll 2
  for (std::size_t r = 0; r < N; ++r)
#pragma GCC unroll 8
    for (std::size_t b = 0; b < Blocks; ++b) {
      __m512i sum = sums[r][b][0];
#pragma GCC unroll 4
      for (std::size_t s = 1; s < S; ++s) sum = _mm512_add_epi32(sum, sums[r][b][s]);
      const __m512i done = _mm512_min_epi32(_mm512_max_epi32(_mm512_sra_epi32(sum, shift), low), high);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(out[r] + (first + b) * kBlock), _mm512_cvtsepi32_epi16(done));
    }
}

template <std::size_t N, bool kBytes, class Value>
void all_blocks_vnni(const Layer& layer, const std::array<const Value*, N>& in, const std::array<std::int16_t*, N>& out) {
  const std::size_t blocks = layer.blocks();
  std::size_t at = 0;
  for (; blocks - at >= 6; at += 6) blocks_vnni<N, 6, 1, kBytes>(layer, at, in, out);
  for (; blocks - at >= 3; at += 3) blocks_vnni<N, 3, 2, kBytes>(layer, at, in, out);
  if (blocks - at == 2) blocks_vnni<N, 2, kBytes ? 2 : 4, kBytes>(layer, at, in, out);
  if (blocks - at == 1) blocks_vnni<N, 1, kBytes ? 2 : 4, kBytes>(layer, at, in, out);
}

// Inputs larger by 128, as bytes.
struct alignas(64) Shifted {
  std::array<std::uint8_t, kInputsExpecting + 16> of;
};
__attribute__((target("avx512f,avx512bw,avx512vl,avx512vnni"))) void shift_vnni(const std::int16_t* in, std::size_t count, Shifted& to) {
  const __m256i by = _mm256_set1_epi8(-128);
  for (std::size_t i = 0; i < count; i += 32) {
    const auto here = static_cast<__mmask32>(count - i >= 32 ? 0xffffffffu : (1u << (count - i)) - 1u);
    const __m256i bytes = _mm256_xor_si256(_mm512_cvtepi16_epi8(_mm512_maskz_loadu_epi16(here, in + i)), by);
    _mm256_store_si256(reinterpret_cast<__m256i*>(to.of.data() + i), bytes);
  }
}

template <std::size_t N>
void layer_vnni(const Layer& layer, const std::array<const std::int16_t*, N>& in, const std::array<std::int16_t*, N>& out) {
  if (!layer.in_bytes) return all_blocks_vnni<N, false>(layer, in, out);
  std::array<Shifted, N> shifted;
  std::array<const std::uint8_t*, N> from;
  for (std::size_t r = 0; r < N; ++r) {
    shift_vnni(in[r], layer.in, shifted[r]);
    from[r] = shifted[r].of.data();
  }
  all_blocks_vnni<N, true>(layer, from, out);
}

#endif

template <std::size_t N>
void run_layers([[maybe_unused]] NetForm form, const std::array<Layer, kNetLayers>& layers, const std::array<NetValues*, N>& values) {
  std::array<std::array<Middle, 2>, N> middle;
  std::array<const std::int16_t*, N> in;
  std::array<std::int16_t*, N> out;
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    for (std::size_t r = 0; r < N; ++r) {
      in[r] = l == 0 ? values[r]->in.data() : middle[r][l - 1].of.data();
      out[r] = l + 1 == kNetLayers ? values[r]->out.data() : middle[r][l].of.data();
    }
#if defined(__x86_64__)
    if (form == NetForm::Vnni) {
      layer_vnni<N>(layers[l], in, out);
      continue;
    }
    if (form == NetForm::Avx2) {
      layer_avx2<N>(layers[l], in, out);
      continue;
    }
#endif
#if defined(__wasm__)
    wasm::layer_by_vectors<N>(layers[l], in, out);
#else
    for (std::size_t r = 0; r < N; ++r) layer_plainly(layers[l], in[r], out[r]);
#endif
  }
}

// The first layer's weights once more as bytes, if they fit.
void put_in_bytes(const GivenLayer& from, Layer& layer) {
  layer.in_bytes = std::all_of(from.weights, from.weights + from.in * from.out, [](std::int16_t w) { return w >= -128 && w <= 127; });
  if (!layer.in_bytes) return;
  layer.byte_weights.assign(layer.blocks() * kBlock * from.in);
  layer.byte_bias.assign(layer.blocks() * kBlock);
  for (std::size_t o = 0; o < from.out; ++o) {
    auto bias = static_cast<std::uint32_t>(from.bias[o]);
    for (std::size_t i = 0; i < from.in; ++i) {
      const std::int16_t w = from.weights[o * from.in + i];
      bias -= static_cast<std::uint32_t>(128 * w);
      layer.byte_weights.data()[(i / 4 * layer.blocks() + o / kBlock) * 4 * kBlock + o % kBlock * 4 + i % 4] = static_cast<std::int8_t>(w);
    }
    layer.byte_bias.data()[o] = static_cast<std::int32_t>(bias);
  }
}

// What is possible in a layer, and the largest a value it takes can be.
void check(const GivenLayer& given, std::int64_t largest) {
  if (given.shift < 5 || given.shift > 13) throw Error(ErrorCode::Section, "a layer shifted by other than 5 to 13 bits");
  for (std::size_t o = 0; o < given.out; ++o) {
    std::int64_t sum = std::abs(static_cast<std::int64_t>(given.bias[o]));
    for (std::size_t i = 0; i < given.in; ++i)
      sum += largest * std::abs(static_cast<std::int64_t>(given.weights[o * given.in + i]));
    if (sum > std::numeric_limits<std::int32_t>::max())
      throw Error(ErrorCode::Section, "sums of a network may pass 32 bits");
  }
}

}  // namespace

std::vector<NetForm> net_forms_here() {
  std::vector<NetForm> forms = {NetForm::Plain};
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx2")) forms.push_back(NetForm::Avx2);
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512vnni"))
    forms.push_back(NetForm::Vnni);
#endif
  return forms;
}

RiddleNet::RiddleNet(const std::array<GivenLayer, kNetLayers>& given, NetForm form) : form_(form) {
  const auto hidden = [](std::size_t n) { return n >= 8 && n <= kMostHidden && n % 8 == 0; };
  if ((given[0].in != kInputsAlone && given[0].in != kInputsExpecting) || !hidden(given[0].out) ||
      given[1].in != given[0].out || !hidden(given[1].out) || given[2].in != given[1].out || given[2].out != kNetOutputs)
    throw Error(ErrorCode::Section, "layers of a network that do not fit each other");
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    const GivenLayer& from = given[l];
    check(from, l == 0 ? 128 : kMiddleTop);
    Layer& layer = layers_[l];
    layer.in = from.in;
    layer.out = from.out;
    layer.shift = l == 0 ? from.shift - 2 : l == 1 ? from.shift : from.shift - 5;
    layer.low = l == 2 ? -32768 : 0;
    layer.high = l == 2 ? 32767 : kMiddleTop;
    layer.bias.assign(layer.blocks() * kBlock);
    std::copy_n(from.bias, from.out, layer.bias.data());
    layer.weights.assign(layer.blocks() * kBlock * layer.in);
    for (std::size_t o = 0; o < from.out; ++o)
      for (std::size_t i = 0; i < from.in; ++i)
        layer.weights.data()[(i / 2 * layer.blocks() + o / kBlock) * 2 * kBlock + o % kBlock * 2 + i % 2] = from.weights[o * from.in + i];
    if (l == 0) put_in_bytes(from, layer);
  }
}

void RiddleNet::run(NetValues& values) const { run_layers<1>(form_, layers_, {&values}); }

void RiddleNet::run(NetValues& first, NetValues& second) const { run_layers<2>(form_, layers_, {&first, &second}); }

}  // namespace lidarcodec
