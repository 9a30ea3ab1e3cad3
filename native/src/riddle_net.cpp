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

// By how many bits the weights of each layer may be shifted, and how many more (or fewer) their sums are: the units of what
// goes in and comes out are 32 and 8, 8 and 8, 8 and 4096.
struct Shifts {
  std::uint32_t least, most;
  std::int32_t more;
};
constexpr std::array<Shifts, kNetLayers> kShifts = {{{3, 13, 2}, {3, 13, 0}, {9, 13, -9}}};
constexpr std::int64_t kMostHalf = 1 << 14;  // that rounds a sum

// Inputs or hidden values of one return, between two layers.
struct alignas(64) Words {
  std::array<std::int16_t, kMostHidden> of;
};
struct alignas(64) Bytes {
  std::array<std::uint8_t, kMostHidden> of;
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
#define LIDARCODEC_VNNI __attribute__((target("avx512f,avx512bw,avx512vl,avx512vnni")))

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

// Blocks of sums of N returns, from `first` on: of values without a sign, in 8 or 16 bits. Sums of S steps in turns are
// added up apart: enough of them at once that none waits for its last product, and few enough for the registers.
template <std::size_t N, std::size_t Blocks, std::size_t S, class Value, class Out>
LIDARCODEC_VNNI void blocks_vnni(const Layer& layer, std::size_t first, const std::array<const Value*, N>& in, const std::array<Out*, N>& out) {
  constexpr bool kBytes = sizeof(Value) == 1;
  constexpr std::size_t kAtOnce = 4 / sizeof(Value);  // inputs of a sum
  const std::int32_t* const bias = layer.unsigned_bias.data() + first * kBlock;
  const auto* w = reinterpret_cast<const std::byte*>(kBytes ? static_cast<const void*>(layer.byte_weights.data()) : layer.weights.data()) + first * 64;
  __m512i sums[N][Blocks][S];
#pragma GCC unroll 4
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
#pragma GCC unroll 4
      for (std::size_t r = 0; r < N; ++r) x[r] = _mm512_set1_epi32(four_bytes_at(in[r] + i + kAtOnce * s));
#pragma GCC unroll 8
      for (std::size_t b = 0; b < Blocks; ++b) {
        const __m512i of = _mm512_load_si512(w + b * 64);
#pragma GCC unroll 4
        for (std::size_t r = 0; r < N; ++r)
          sums[r][b][s] = kBytes ? _mm512_dpbusd_epi32(sums[r][b][s], x[r], of) : _mm512_dpwssd_epi32(sums[r][b][s], x[r], of);
      }
    }
  }
  const __m128i shift = _mm_cvtsi32_si128(static_cast<int>(layer.shift));
  const __m512i low = _mm512_set1_epi32(layer.low), high = _mm512_set1_epi32(layer.high);
#pragma GCC unroll 4
  for (std::size_t r = 0; r < N; ++r)
#pragma GCC unroll 8
    for (std::size_t b = 0; b < Blocks; ++b) {
      __m512i sum = sums[r][b][0];
#pragma GCC unroll 4
      for (std::size_t s = 1; s < S; ++s) sum = _mm512_add_epi32(sum, sums[r][b][s]);
      const __m512i done = _mm512_min_epi32(_mm512_max_epi32(_mm512_sra_epi32(sum, shift), low), high);
      auto* const to = out[r] + (first + b) * kBlock;
      if constexpr (sizeof(Out) == 1) {
        _mm_storeu_si128(reinterpret_cast<__m128i*>(to), _mm512_cvtepi32_epi8(done));
      } else {
        _mm256_storeu_si256(reinterpret_cast<__m256i*>(to), _mm512_cvtepi32_epi16(done));
      }
    }
}

template <std::size_t N, class Value, class Out>
void all_blocks_vnni(const Layer& layer, const std::array<const Value*, N>& in, const std::array<Out*, N>& out) {
  const std::size_t blocks = layer.blocks();
  constexpr std::size_t kTurns = N == 4 ? 1 : 2;  // so that a few blocks of few returns need not wait for their sums
  std::size_t at = 0;
  for (; blocks - at >= 6; at += 6) blocks_vnni<N, 6, 1>(layer, at, in, out);
  for (; blocks - at >= 3; at += 3) blocks_vnni<N, 3, kTurns>(layer, at, in, out);
  if (blocks - at == 2) blocks_vnni<N, 2, 2>(layer, at, in, out);
  if (blocks - at == 1) blocks_vnni<N, 1, 2>(layer, at, in, out);
}

// Inputs larger by 128, without a sign.
LIDARCODEC_VNNI void shift_vnni(const std::int8_t* in, std::size_t count, Bytes& to) {
  const __m512i by = _mm512_set1_epi8(-128);
  for (std::size_t i = 0; i < count; i += 64) {
    const auto here = count - i >= 64 ? ~__mmask64{0} : (__mmask64{1} << (count - i)) - 1;
    _mm512_store_si512(to.of.data() + i, _mm512_xor_si512(_mm512_maskz_loadu_epi8(here, in + i), by));
  }
}

LIDARCODEC_VNNI void widen_vnni(const std::uint8_t* in, std::size_t count, Words& to) {
  for (std::size_t i = 0; i < count; i += 32)
    _mm512_store_si512(to.of.data() + i, _mm512_cvtepu8_epi16(_mm256_load_si256(reinterpret_cast<const __m256i*>(in + i))));
}

template <std::size_t N, class Out>
void layer_vnni(const Layer& layer, const std::array<Bytes, N>& in, const std::array<Out*, N>& out) {
  std::array<Words, N> words;
  std::array<const std::uint8_t*, N> bytes_at;
  std::array<const std::int16_t*, N> words_at;
  for (std::size_t r = 0; r < N; ++r) {
    bytes_at[r] = in[r].of.data();
    words_at[r] = words[r].of.data();
    if (!layer.in_bytes) widen_vnni(bytes_at[r], layer.in, words[r]);
  }
  layer.in_bytes ? all_blocks_vnni(layer, bytes_at, out) : all_blocks_vnni(layer, words_at, out);
}

template <std::size_t N>
void run_vnni(const std::array<Layer, kNetLayers>& layers, const std::array<NetValues*, N>& values) {
  std::array<Bytes, N> in, first, second;
  std::array<std::uint8_t*, N> to_first, to_second;
  std::array<std::int16_t*, N> to_odds;
  for (std::size_t r = 0; r < N; ++r) {
    shift_vnni(values[r]->in.data(), layers[0].in, in[r]);
    to_first[r] = first[r].of.data();
    to_second[r] = second[r].of.data();
    to_odds[r] = values[r]->out.data();
  }
  layer_vnni(layers[0], in, to_first);
  layer_vnni(layers[1], first, to_second);
  layer_vnni(layers[2], second, to_odds);
}

#endif

template <std::size_t N>
void run_layers([[maybe_unused]] NetForm form, const std::array<Layer, kNetLayers>& layers, const std::array<NetValues*, N>& values) {
#if defined(__x86_64__)
  if (form == NetForm::Vnni) return run_vnni(layers, values);
#endif
  std::array<std::array<Words, kNetLayers>, N> words;  // what goes into each layer
  std::array<const std::int16_t*, N> in;
  std::array<std::int16_t*, N> out;
  for (std::size_t r = 0; r < N; ++r) std::copy_n(values[r]->in.data(), layers[0].in, words[r][0].of.data());
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    for (std::size_t r = 0; r < N; ++r) {
      in[r] = words[r][l].of.data();
      out[r] = l + 1 == kNetLayers ? values[r]->out.data() : words[r][l + 1].of.data();
    }
#if defined(__x86_64__)
    if (form == NetForm::Avx2) {
      if constexpr (N == 4) {  // two at a time are what the registers hold
        layer_avx2<2>(layers[l], {in[0], in[1]}, {out[0], out[1]});
        layer_avx2<2>(layers[l], {in[2], in[3]}, {out[2], out[3]});
      } else {
        layer_avx2<N>(layers[l], in, out);
      }
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

// Weights once more as bytes, if they fit, and biases for inputs that are larger by `more`.
void put_unsigned(const GivenLayer& from, std::int32_t more, Layer& layer) {
  layer.in_bytes = std::all_of(from.weights, from.weights + from.in * from.out, [](std::int16_t w) { return w >= -128 && w <= 127; });
  if (layer.in_bytes) layer.byte_weights.assign(layer.blocks() * kBlock * from.in);
  layer.unsigned_bias.assign(layer.blocks() * kBlock);
  for (std::size_t o = 0; o < from.out; ++o) {
    auto bias = static_cast<std::uint32_t>(layer.bias.data()[o]);
    for (std::size_t i = 0; i < from.in; ++i) {
      const std::int16_t w = from.weights[o * from.in + i];
      bias -= static_cast<std::uint32_t>(more * w);
      if (layer.in_bytes)
        layer.byte_weights.data()[(i / 4 * layer.blocks() + o / kBlock) * 4 * kBlock + o % kBlock * 4 + i % 4] = static_cast<std::int8_t>(w);
    }
    layer.unsigned_bias.data()[o] = static_cast<std::int32_t>(bias);
  }
}

// What is possible in a layer, and the largest a value it takes can be.
void check(const GivenLayer& given, std::size_t number, std::int64_t largest) {
  if (given.shift < kShifts[number].least || given.shift > kShifts[number].most)
    throw Error(ErrorCode::Section, "a layer shifted by too few or too many bits");
  for (std::size_t o = 0; o < given.out; ++o) {
    std::int64_t sum = std::abs(static_cast<std::int64_t>(given.bias[o])) + kMostHalf;
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
    check(from, l, l == 0 ? 128 : kMiddleTop);
    Layer& layer = layers_[l];
    layer.in = from.in;
    layer.out = from.out;
    layer.shift = static_cast<std::uint32_t>(static_cast<std::int32_t>(from.shift) + kShifts[l].more);
    layer.low = l == 2 ? -32768 : 0;
    layer.high = l == 2 ? 32767 : kMiddleTop;
    layer.bias.assign(layer.blocks() * kBlock);
    const std::int32_t half = layer.shift == 0 ? 0 : 1 << (layer.shift - 1);
    for (std::size_t o = 0; o < from.out; ++o) layer.bias.data()[o] = from.bias[o] + half;
    layer.weights.assign(layer.blocks() * kBlock * layer.in);
    for (std::size_t o = 0; o < from.out; ++o)
      for (std::size_t i = 0; i < from.in; ++i)
        layer.weights.data()[(i / 2 * layer.blocks() + o / kBlock) * 2 * kBlock + o % kBlock * 2 + i % 2] = from.weights[o * from.in + i];
    put_unsigned(from, l == 0 ? 128 : 0, layer);
  }
}

void RiddleNet::run(const std::array<NetValues*, 1>& values) const { run_layers(form_, layers_, values); }

void RiddleNet::run(const std::array<NetValues*, 2>& values) const { run_layers(form_, layers_, values); }

void RiddleNet::run(const std::array<NetValues*, 4>& values) const { run_layers(form_, layers_, values); }

}  // namespace lidarcodec
