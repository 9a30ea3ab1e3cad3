#include "riddle_products.hpp"

#include <cstring>

namespace lidarcodec {
namespace {

template <std::size_t kLanes>
struct LanesOf;
template <>
struct LanesOf<8> {
  using Type = float __attribute__((vector_size(32)));
};
template <>
struct LanesOf<16> {
  using Type = float __attribute__((vector_size(64)));
};
template <std::size_t kLanes>
using Lanes = typename LanesOf<kLanes>::Type;

#define LIDARCODEC_INLINE [[gnu::always_inline]] inline

// kRows rows and kVectors times kLanes columns of c at once; each of its numbers is added up by itself, in order of k.
template <std::size_t kLanes, std::size_t kRows, std::size_t kVectors>
LIDARCODEC_INLINE void tile(std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {
  Lanes<kLanes> sums[kRows][kVectors];
#pragma GCC unroll 8
  for (std::size_t r = 0; r < kRows; ++r) {
#pragma GCC unroll 4
    for (std::size_t v = 0; v < kVectors; ++v) std::memcpy(&sums[r][v], c + r * n + v * kLanes, sizeof sums[r][v]);
  }
  const float* from = a.at;
  for (std::size_t i = 0; i < k; ++i, from += a.column, b += n) {
    Lanes<kLanes> factors[kVectors];
#pragma GCC unroll 4
    for (std::size_t v = 0; v < kVectors; ++v) std::memcpy(&factors[v], b + v * kLanes, sizeof factors[v]);
#pragma GCC unroll 8
    for (std::size_t r = 0; r < kRows; ++r) {
      const float factor = from[r * a.row];
#pragma GCC unroll 4
      for (std::size_t v = 0; v < kVectors; ++v) sums[r][v] += factors[v] * factor;
    }
  }
#pragma GCC unroll 8
  for (std::size_t r = 0; r < kRows; ++r) {
#pragma GCC unroll 4
    for (std::size_t v = 0; v < kVectors; ++v) std::memcpy(c + r * n + v * kLanes, &sums[r][v], sizeof sums[r][v]);
  }
}

template <std::size_t kLanes, std::size_t kRows>
LIDARCODEC_INLINE void rows(std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {
  std::size_t at = 0;
  for (; at + 2 * kLanes <= n; at += 2 * kLanes) tile<kLanes, kRows, 2>(n, k, a, b + at, c + at);
  for (; at + kLanes <= n; at += kLanes) tile<kLanes, kRows, 1>(n, k, a, b + at, c + at);
  for (; at < n; at += 8) tile<8, kRows, 1>(n, k, a, b + at, c + at);
}

template <std::size_t kLanes>
LIDARCODEC_INLINE void product(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {
  constexpr std::size_t kRows = 4;
  std::size_t at = 0;
  for (; at + kRows <= m; at += kRows) rows<kLanes, kRows>(n, k, {a.at + at * a.row, a.row, a.column}, b, c + at * n);
  for (; at < m; ++at) rows<kLanes, 1>(n, k, {a.at + at * a.row, a.row, a.column}, b, c + at * n);
}

using Product = void (*)(std::size_t, std::size_t, std::size_t, const Strided&, const float*, float*);

void plain(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) { product<8>(m, n, k, a, b, c); }

#if defined(__x86_64__)
__attribute__((target("avx2"))) void avx2(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {
  product<8>(m, n, k, a, b, c);
}
__attribute__((target("avx512f"))) void avx512(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {
  product<16>(m, n, k, a, b, c);
}
#endif

Product quickest() {
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx512f")) return avx512;
  if (__builtin_cpu_supports("avx2")) return avx2;
#endif
  return plain;
}

}  // namespace

void add_product(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {
  static const Product chosen = quickest();
  chosen(m, n, k, a, b, c);
}

}  // namespace lidarcodec
