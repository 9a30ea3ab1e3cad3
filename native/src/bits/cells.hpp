// Eight log odds at a time: context mixing by logistic regression.
//
// A *cell* is an int16: the log odds of a one, where 32768 is six natural units. Each context of a decision names a
// cell, and their sum is the decision's log odds. A cubic in place of the logistic function gives the probability
// (README.md). Each of the cells then moves by rate times error, the gradient of the coding cost. The eight decisions
// of a tree are adjacent and are computed together.
//
// The plain form defines the results. The forms for SSE2 and NEON, `Cells`, give the same ones fifteen times as fast.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(LIDARCODEC_PLAIN_CELLS)
#elif defined(__SSE2__)
#include <emmintrin.h>
#define LIDARCODEC_SSE2_CELLS
#elif defined(__aarch64__)
#include <arm_neon.h>
#define LIDARCODEC_NEON_CELLS
#endif

namespace lidarcodec {

inline constexpr std::int16_t kRarest = 10;  // smallest probability, of 32768
inline constexpr std::int16_t kOne = 32767;  // stands for the probability 1

// Eight cells. a + b saturates at -32768 and 32767. probabilities: those of a one, 10 to 32757 of 32768, from sums of
// log odds. moves: the updates of cells, (wanted - p) * rate / 65536, rounded, where `taken` is -1, and 0 where `taken`
// is 0.
template <class Form>
struct alignas(16) CellsOf {
  typename Form::Lanes lanes;

  static CellsOf load(const std::int16_t* from) {
    CellsOf cells;
    std::memcpy(&cells.lanes, from, sizeof cells.lanes);
    return cells;
  }
  void store(std::int16_t* to) const { std::memcpy(to, &lanes, sizeof lanes); }
};

struct PlainForm {
  using Lanes = std::array<std::int16_t, 8>;
};
using PlainCells = CellsOf<PlainForm>;

inline PlainCells operator+(const PlainCells& a, const PlainCells& b) {
  PlainCells sum;
  for (std::size_t i = 0; i < 8; ++i)
    sum.lanes[i] = static_cast<std::int16_t>(std::clamp(a.lanes[i] + b.lanes[i], -32768, 32767));
  return sum;
}

inline PlainCells probabilities(const PlainCells& sums) {
  PlainCells p;
  for (std::size_t i = 0; i < 8; ++i) {
    const int sum = sums.lanes[i];
    const auto t = static_cast<std::uint32_t>(65534 - 2 * (sum < 0 ? -1 - sum : sum));
    const std::uint32_t square = (t * t) >> 16;
    const int rare = std::max(static_cast<int>((square * t) >> 18), int{kRarest});
    p.lanes[i] = static_cast<std::int16_t>(sum < 0 ? rare : kOne - rare);
  }
  return p;
}

inline PlainCells errors(const PlainCells& wanted, const PlainCells& taken, const PlainCells& p) {
  PlainCells found;
  for (std::size_t i = 0; i < 8; ++i)
    found.lanes[i] = static_cast<std::int16_t>((wanted.lanes[i] - p.lanes[i]) & taken.lanes[i]);
  return found;
}

inline PlainCells by_rate(const PlainCells& a, std::int16_t rate) {
  PlainCells by;
  for (std::size_t i = 0; i < 8; ++i) by.lanes[i] = static_cast<std::int16_t>((a.lanes[i] * rate + 0x8000) >> 16);
  return by;
}

inline PlainCells product(const PlainCells& a, const PlainCells& b) {
  PlainCells found;
  for (std::size_t i = 0; i < 8; ++i) found.lanes[i] = static_cast<std::int16_t>((a.lanes[i] * b.lanes[i]) >> 16);
  return found;
}

#if defined(LIDARCODEC_SSE2_CELLS)

struct Sse2Form {
  using Lanes = __m128i;
};
using Cells = CellsOf<Sse2Form>;

inline Cells operator+(const Cells& a, const Cells& b) { return {_mm_adds_epi16(a.lanes, b.lanes)}; }

inline Cells probabilities(const Cells& sums) {
  // `flip` is kOne where the sum is not negative: x ^ flip is then kOne - x. Doubling drops the sign bit.
  const __m128i flip = _mm_andnot_si128(_mm_srai_epi16(sums.lanes, 15), _mm_set1_epi16(kOne));
  const __m128i left = _mm_xor_si128(sums.lanes, flip);
  const __m128i t = _mm_add_epi16(left, left);
  const __m128i cube = _mm_mulhi_epu16(_mm_mulhi_epu16(t, t), t);
  const __m128i rare = _mm_max_epi16(_mm_srli_epi16(cube, 2), _mm_set1_epi16(kRarest));
  return {_mm_xor_si128(rare, flip)};
}

inline Cells errors(const Cells& wanted, const Cells& taken, const Cells& p) {
  return {_mm_and_si128(_mm_sub_epi16(wanted.lanes, p.lanes), taken.lanes)};
}

inline Cells by_rate(const Cells& a, std::int16_t rate) {
  const __m128i rates = _mm_set1_epi16(rate);
  const __m128i rounding = _mm_srli_epi16(_mm_mullo_epi16(a.lanes, rates), 15);
  return {_mm_add_epi16(_mm_mulhi_epi16(a.lanes, rates), rounding)};
}

inline Cells product(const Cells& a, const Cells& b) { return {_mm_mulhi_epi16(a.lanes, b.lanes)}; }

#elif defined(LIDARCODEC_NEON_CELLS)

struct NeonForm {
  using Lanes = int16x8_t;
};
using Cells = CellsOf<NeonForm>;

inline Cells operator+(const Cells& a, const Cells& b) { return {vqaddq_s16(a.lanes, b.lanes)}; }

inline uint16x8_t high_product(uint16x8_t a, uint16x8_t b) {
  const uint32x4_t low = vmull_u16(vget_low_u16(a), vget_low_u16(b));
  return vuzp2q_u16(vreinterpretq_u16_u32(low), vreinterpretq_u16_u32(vmull_high_u16(a, b)));
}

inline Cells probabilities(const Cells& sums) {
  const int16x8_t flip = vbicq_s16(vdupq_n_s16(kOne), vshrq_n_s16(sums.lanes, 15));  // as for SSE2
  const int16x8_t left = veorq_s16(sums.lanes, flip);
  const uint16x8_t t = vreinterpretq_u16_s16(vaddq_s16(left, left));
  const uint16x8_t cube = high_product(high_product(t, t), t);
  const int16x8_t rare = vmaxq_s16(vreinterpretq_s16_u16(vshrq_n_u16(cube, 2)), vdupq_n_s16(kRarest));
  return {veorq_s16(rare, flip)};
}

inline Cells errors(const Cells& wanted, const Cells& taken, const Cells& p) {
  return {vandq_s16(vsubq_s16(wanted.lanes, p.lanes), taken.lanes)};
}

inline Cells by_rate(const Cells& a, std::int16_t rate) {
  const int32x4_t low = vmull_n_s16(vget_low_s16(a.lanes), rate), high = vmull_high_n_s16(a.lanes, rate);
  return {vrshrn_high_n_s32(vrshrn_n_s32(low, 16), high, 16)};
}

inline Cells product(const Cells& a, const Cells& b) {
  const int32x4_t low = vmull_s16(vget_low_s16(a.lanes), vget_low_s16(b.lanes)),
                  high = vmull_high_s16(a.lanes, b.lanes);
  return {vshrn_high_n_s32(vshrn_n_s32(low, 16), high, 16)};
}

#else

using Cells = PlainCells;

#endif

// The updates of cells.
template <class Form>
CellsOf<Form> moves(const CellsOf<Form>& wanted, const CellsOf<Form>& taken, const CellsOf<Form>& p,
                    std::int16_t rate) {
  return by_rate(errors(wanted, taken, p), rate);
}

// The decisions on the path to a node of a binary tree of up to four levels. Nodes are numbered from 1; the children of
// n are 2 n and 2 n + 1. `taken` is -1 for the nodes on the path, and `wanted` is kOne for those where it goes on to
// the odd child.
struct alignas(16) Walk {
  std::array<std::int16_t, 16> taken{}, wanted{};
};

// The path to each node, 1 to 31.
inline constexpr auto kWalks = [] {
  std::array<Walk, 32> walks{};
  for (std::uint32_t end = 1; end < 32; ++end) {
    for (std::uint32_t node = end; node > 1; node /= 2) {
      walks[end].taken[node / 2] = -1;
      walks[end].wanted[node / 2] = node % 2 != 0 ? kOne : std::int16_t{0};
    }
  }
  return walks;
}();

}  // namespace lidarcodec
