#include "network/products.hpp"

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

constexpr std::size_t kRowsAtOnce = 4, kColumnsOfRuns = 16;

// kRows rows and kVectors times kLanes columns of c at once. Each number of c is a sum in the order of k.
template <std::size_t kLanes, std::size_t kRows, std::size_t kVectors>
LIDARCODEC_INLINE void tile(std::size_t n, const Run* run, const Run* end, const Strided& a, const float* b, float* c) {
  Lanes<kLanes> sums[kRows][kVectors];
#pragma GCC unroll 8
  for (std::size_t r = 0; r < kRows; ++r) {
#pragma GCC unroll 4
    for (std::size_t v = 0; v < kVectors; ++v) std::memcpy(&sums[r][v], c + r * n + v * kLanes, sizeof sums[r][v]);
  }
  for (; run != end; ++run) {
    const float *from = a.at + run->from * a.column, *row = b + run->from * n;
    for (std::size_t i = run->from; i < run->to; ++i, from += a.column, row += n) {
      Lanes<kLanes> factors[kVectors];
#pragma GCC unroll 4
      for (std::size_t v = 0; v < kVectors; ++v) std::memcpy(&factors[v], row + v * kLanes, sizeof factors[v]);
#pragma GCC unroll 8
      for (std::size_t r = 0; r < kRows; ++r) {
        const float factor = from[r * a.row];
#pragma GCC unroll 4
        for (std::size_t v = 0; v < kVectors; ++v) sums[r][v] += factors[v] * factor;
      }
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
  const Run all{0, k};
  std::size_t at = 0;
  for (; at + 2 * kLanes <= n; at += 2 * kLanes) tile<kLanes, kRows, 2>(n, &all, &all + 1, a, b + at, c + at);
  for (; at + kLanes <= n; at += kLanes) tile<kLanes, kRows, 1>(n, &all, &all + 1, a, b + at, c + at);
  for (; at < n; at += 8) tile<8, kRows, 1>(n, &all, &all + 1, a, b + at, c + at);
}

template <std::size_t kLanes>
LIDARCODEC_INLINE void product(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b,
                               float* c) {
  std::size_t at = 0;
  for (; at + kRowsAtOnce <= m; at += kRowsAtOnce)
    rows<kLanes, kRowsAtOnce>(n, k, {a.at + at * a.row, a.row, a.column}, b, c + at * n);
  for (; at < m; ++at) rows<kLanes, 1>(n, k, {a.at + at * a.row, a.row, a.column}, b, c + at * n);
}

// Sixteen columns, or the last eight.
template <std::size_t kLanes, std::size_t kRows>
LIDARCODEC_INLINE void block(std::size_t left, std::size_t n, const Run* run, const Run* end, const Strided& a,
                             const float* b, float* c) {
  if (left >= kColumnsOfRuns)
    tile<kLanes, kRows, kColumnsOfRuns / kLanes>(n, run, end, a, b, c);
  else
    tile<8, kRows, 1>(n, run, end, a, b, c);
}

template <std::size_t kLanes>
LIDARCODEC_INLINE void product_with(const Runs& runs, std::size_t m, std::size_t n, const Strided& a, const float* b,
                                    float* c) {
  for (std::size_t number = 0; number < runs.size(); ++number) {
    const Run *const begin = runs[number].data(), *const end = begin + runs[number].size();
    const std::size_t column = number * kColumnsOfRuns;
    std::size_t at = 0;
    for (; at + kRowsAtOnce <= m; at += kRowsAtOnce)
      block<kLanes, kRowsAtOnce>(n - column, n, begin, end, {a.at + at * a.row, a.row, a.column}, b + column,
                                 c + at * n + column);
    for (; at < m; ++at)
      block<kLanes, 1>(n - column, n, begin, end, {a.at + at * a.row, a.row, a.column}, b + column,
                       c + at * n + column);
  }
}

template <std::size_t kLanes>
LIDARCODEC_INLINE void product_to(const Runs& runs, std::size_t n, std::size_t k, const Strided& a, const float* b,
                                  float* c) {
  const Run all{0, k};
  for (std::size_t number = 0; number < runs.size(); ++number)
    for (const Run& run : runs[number])
      for (std::size_t at = run.from, column = number * kColumnsOfRuns; at < run.to; at += kRowsAtOnce)
        block<kLanes, kRowsAtOnce>(n - column, n, &all, &all + 1, {a.at + at * a.row, a.row, a.column}, b + column,
                                   c + at * n + column);
}

// The three products, compiled for one kind of processor.
struct Products {
  void (*all)(std::size_t, std::size_t, std::size_t, const Strided&, const float*, float*);
  void (*with)(const Runs&, std::size_t, std::size_t, const Strided&, const float*, float*);
  void (*to)(const Runs&, std::size_t, std::size_t, const Strided&, const float*, float*);
};

#define LIDARCODEC_PRODUCTS(name, lanes, target)                                                                      \
  target void name##_all(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {   \
    product<lanes>(m, n, k, a, b, c);                                                                                 \
  }                                                                                                                   \
  target void name##_with(const Runs& runs, std::size_t m, std::size_t n, const Strided& a, const float* b,           \
                          float* c) {                                                                                 \
    product_with<lanes>(runs, m, n, a, b, c);                                                                         \
  }                                                                                                                   \
  target void name##_to(const Runs& runs, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) { \
    product_to<lanes>(runs, n, k, a, b, c);                                                                           \
  }                                                                                                                   \
  constexpr Products name = {name##_all, name##_with, name##_to};

LIDARCODEC_PRODUCTS(kPlain, 8, )
#if defined(__x86_64__)
LIDARCODEC_PRODUCTS(kAvx2, 8, __attribute__((target("avx2"))))
LIDARCODEC_PRODUCTS(kAvx512, 16, __attribute__((target("avx512f"))))
#endif

const Products& fastest() {
#if defined(__x86_64__)
  static const Products& chosen = []() -> const Products& {
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f")) return kAvx512;
    if (__builtin_cpu_supports("avx2")) return kAvx2;
    return kPlain;
  }();
  return chosen;
#else
  return kPlain;
#endif
}

}  // namespace

void add_product(std::size_t m, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {
  fastest().all(m, n, k, a, b, c);
}

void add_product_with(const Runs& runs, std::size_t m, std::size_t n, const Strided& a, const float* b, float* c) {
  fastest().with(runs, m, n, a, b, c);
}

void add_product_to(const Runs& runs, std::size_t n, std::size_t k, const Strided& a, const float* b, float* c) {
  fastest().to(runs, n, k, a, b, c);
}

}  // namespace lidarcodec
