#include "motion/fixed_angle.hpp"

#include <algorithm>
#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "base/processor.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kAtOnce = 16;

// atan(2^-i), rounded to an Angle.
constexpr Angle micro_rotation(std::size_t i) { return static_cast<Angle>((kArctangent[i] + 128) >> 8); }

// The direction of a vector that is above the x axis before each rotation.
constexpr Angle kSumOfMicroRotations = [] {
  Angle all = 0;
  for (std::size_t i = 0; i < kVectoringSteps; ++i) all += micro_rotation(i);
  return all;
}();

using Four = std::int32_t __attribute__((vector_size(16)));
using FourAngles = Angle __attribute__((vector_size(16)));

// Two registers of vectors at once: their instructions do not wait for each other.
inline void two_to_polar(std::int32_t* x_at, std::int32_t* y_at, Angle* angle_at) {
  Four x[2], y[2];
  FourAngles angle[2];
  std::memcpy(x, x_at, sizeof x);
  std::memcpy(y, y_at, sizeof y);
  for (std::size_t v = 0; v < 2; ++v) {
    const auto back = x[v] >> 31;  // all ones: left of the y axis, so turned by half a turn first
    angle[v] = (reinterpret_cast<FourAngles>(back) << 31) + kSumOfMicroRotations;
    x[v] = (x[v] ^ back) - back;
    y[v] = (y[v] ^ back) - back;
  }
#pragma GCC unroll 20
  for (int i = 0; i < kVectoringSteps; ++i) {
    const Angle doubled = 2 * micro_rotation(static_cast<std::size_t>(i));
    for (std::size_t v = 0; v < 2; ++v) {
      const auto down = y[v] >> 31;  // all ones: below the x axis
      const auto dx = ((x[v] >> i) ^ down) - down, dy = ((y[v] >> i) ^ down) - down;
      x[v] += dy;
      y[v] -= dx;
      angle[v] -= reinterpret_cast<FourAngles>(down) & doubled;
    }
  }
  std::memcpy(x_at, x, sizeof x);
  std::memcpy(y_at, y, sizeof y);
  std::memcpy(angle_at, angle, sizeof angle);
}

using ToPolar = void (*)(std::int32_t*, std::int32_t*, Angle*);

void to_polar_in_fours(std::int32_t* x, std::int32_t* y, Angle* angle) {
  two_to_polar(x, y, angle);
  two_to_polar(x + 8, y + 8, angle + 8);
}

#if defined(__x86_64__)
// The same with eight numbers a register, by the instruction that multiplies a number by the sign of another.
LIDARCODEC_AVX2 void to_polar_in_eights(std::int32_t* x_at, std::int32_t* y_at, Angle* angle_at) {
  __m256i x[2], y[2], angle[2];
  for (std::size_t v = 0; v < 2; ++v) {
    x[v] = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(x_at + 8 * v));
    y[v] = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(y_at + 8 * v));
    const __m256i back = _mm256_or_si256(_mm256_srai_epi32(x[v], 31), _mm256_set1_epi32(1));
    angle[v] = _mm256_slli_epi32(_mm256_srai_epi32(x[v], 31), 31);
    x[v] = _mm256_sign_epi32(x[v], back);
    y[v] = _mm256_sign_epi32(y[v], back);
  }
#pragma GCC unroll 20
  for (int i = 0; i < kVectoringSteps; ++i) {
    const __m256i step = _mm256_set1_epi32(static_cast<int>(micro_rotation(static_cast<std::size_t>(i))));
    for (std::size_t v = 0; v < 2; ++v) {
      const __m256i way = _mm256_or_si256(y[v], _mm256_set1_epi32(1));
      const __m256i dx = _mm256_sign_epi32(_mm256_srai_epi32(x[v], i), way),
                    dy = _mm256_sign_epi32(_mm256_srai_epi32(y[v], i), way);
      x[v] = _mm256_add_epi32(x[v], dy);
      y[v] = _mm256_sub_epi32(y[v], dx);
      angle[v] = _mm256_add_epi32(angle[v], _mm256_sign_epi32(step, way));
    }
  }
  for (std::size_t v = 0; v < 2; ++v) {
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(x_at + 8 * v), x[v]);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(y_at + 8 * v), y[v]);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(angle_at + 8 * v), angle[v]);
  }
}
ToPolar fastest() { return quickest_path() == Path::Avx2 ? to_polar_in_eights : to_polar_in_fours; }
#else
ToPolar fastest() { return to_polar_in_fours; }
#endif

}  // namespace

void to_polar(std::int32_t* x, std::int32_t* y, Angle* angle, std::size_t n) {
  static const ToPolar convert = fastest();
  std::size_t k = 0;
  for (; k + kAtOnce <= n; k += kAtOnce) convert(x + k, y + k, angle + k);
  if (k == n) return;
  std::int32_t x_left[kAtOnce] = {}, y_left[kAtOnce] = {};
  Angle angle_left[kAtOnce];
  std::copy(x + k, x + n, x_left);
  std::copy(y + k, y + n, y_left);
  convert(x_left, y_left, angle_left);
  std::copy(x_left, x_left + (n - k), x + k);
  std::copy(angle_left, angle_left + (n - k), angle + k);
}

}  // namespace lidarcodec
