// The inner loops of the mask coder of streams, for AVX2. The form is chosen at run time (mask/stream.cpp), so each
// function has its own target attribute.
#pragma once
#if defined(__x86_64__)
#include <immintrin.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/processor.hpp"
#include "mask/lookup.hpp"
#include "mask/model.hpp"

namespace lidarcodec {

// The part of the cells to the left in all context numbers, for every state of LeftCells.
struct alignas(32) Avx2Left {
  static constexpr std::size_t kRuns = 8, kClasses = 8;
  std::array<std::array<std::uint16_t, kCellContexts>, 4 * kRuns * kClasses> of{};

  constexpr Avx2Left() {
    for (std::uint32_t i = 0; i < of.size(); ++i)
      for (std::size_t c = 0; c < kCellContexts; ++c)
        of[i][c] =
            static_cast<std::uint16_t>((i & 1) * kLeftContext.last[c] + (i >> 1 & 1) * kLeftContext.before[c] +
                                       i / 4 % kRuns * kLeftContext.run[c] + i / 4 / kRuns * kLeftContext.holes[c]);
  }
  static std::size_t number(const LeftCells& left) {
    return (left.bits & 3u) | left.run << 2 | std::uint32_t{kCountClass[left.holes]} << 5;
  }
};
inline constexpr Avx2Left kAvx2Left;

// PlainLogOdds with the cells of a decision in a vector. The updated cells are stored after the next decision has
// loaded its own. Cells that both share are updated in the registers, so no load waits for a store.
class Avx2LogOdds {
 public:
  using Numbers = std::array<std::uint16_t, kCellContexts>;

  LIDARCODEC_AVX2 explicit Avx2LogOdds(std::int16_t* cells)
      : cells_(cells),
        values_(_mm256_set1_epi16(cells[0])),
        numbers_(_mm256_setzero_si256()),
        all_by_(_mm256_setzero_si256()) {}

  // The context numbers of a block, [cell][context].
  struct alignas(32) Block {
    std::array<Numbers, kContextBlock> of;
  };

  LIDARCODEC_AVX2 static void put_block(const ContextBlock& from, Block& block) {
    for (std::size_t half = 0; half < 2; ++half) {
      __m256i rows[8], turned[8];
      for (std::size_t i = 0; i < 8; ++i) rows[i] = _mm256_set_m128i(eight(from[i + 8], half), eight(from[i], half));
      // Transposes 8 x 8 numbers in each half of the vectors: three rounds that interleave rows i and i + 4.
      for (std::size_t round = 0; round < 3; ++round) {
        for (std::size_t i = 0; i < 4; ++i) {
          turned[2 * i] = _mm256_unpacklo_epi16(rows[i], rows[i + 4]);
          turned[2 * i + 1] = _mm256_unpackhi_epi16(rows[i], rows[i + 4]);
        }
        for (std::size_t i = 0; i < 8; ++i) rows[i] = turned[i];
      }
      for (std::size_t i = 0; i < 8; ++i)
        _mm256_store_si256(reinterpret_cast<__m256i*>(block.of[8 * half + i].data()), rows[i]);
    }
  }

  LIDARCODEC_AVX2 std::int32_t sum(const Block& block, std::size_t k, const LeftCells& left) {
    const __m256i numbers = _mm256_add_epi16(load(block.of[k]), load(kAvx2Left.of[Avx2Left::number(left)]));
    store(numbers, here_);
    const __m256i values = _mm256_set_m128i(read<8>(), read<0>());
    put();
    store(numbers, there_);
    const __m256i same = _mm256_cmpeq_epi16(numbers, numbers_);
    numbers_ = numbers;
    values_ = moved(values, _mm256_and_si256(all_by_, same));
    // Without saturation the sum needs no updated cells: it is the sum of the loaded ones, plus `by` for each shared
    // cell.
    const __m256i far = _mm256_cmpgt_epi16(_mm256_abs_epi16(values), _mm256_set1_epi16(32767 - kMaxUpdate));
    if (!_mm256_testz_si256(far, far)) return added(values_);
    return added(values) + by_ * (_mm_popcnt_u32(static_cast<std::uint32_t>(_mm256_movemask_epi8(same))) >> 1);
  }

  LIDARCODEC_AVX2 void move(std::int32_t by) {
    by_ = by;
    all_by_ = _mm256_set1_epi16(static_cast<std::int16_t>(by));
    values_ = moved(values_, all_by_);
  }

  LIDARCODEC_AVX2 void end() { put(); }

 private:
  static_assert(kCellContexts == 16 && kContextBlock == 16 && kCellsBegin.back() < 65536);
  static constexpr int kMaxUpdate = 128;
  static_assert(MaskModel::kRate < kMaxUpdate);

  LIDARCODEC_AVX2 static __m256i load(const Numbers& numbers) {
    return _mm256_load_si256(reinterpret_cast<const __m256i*>(numbers.data()));
  }
  LIDARCODEC_AVX2 static void store(__m256i numbers, Numbers& to) {
    _mm256_store_si256(reinterpret_cast<__m256i*>(to.data()), numbers);
    asm("" : "+m"(to));  // else GCC extracts the numbers from the vector one by one, which is slower
  }
  LIDARCODEC_AVX2 static __m128i eight(const Numbers& numbers, std::size_t half) {
    return _mm_loadu_si128(reinterpret_cast<const __m128i*>(numbers.data() + 8 * half));
  }
  LIDARCODEC_AVX2 static __m256i moved(__m256i values, __m256i by) {
    return _mm256_max_epi16(_mm256_adds_epi16(values, by), _mm256_set1_epi16(-32767));
  }
  LIDARCODEC_AVX2 static std::int32_t added(__m256i values) {
    const __m256i pairs = _mm256_madd_epi16(values, _mm256_set1_epi16(1));
    __m128i sum = _mm_add_epi32(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256(pairs, 1));
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, 0x4E));
    sum = _mm_add_epi32(sum, _mm_shuffle_epi32(sum, 0xB1));
    return _mm_cvtsi128_si32(sum);
  }
  template <std::size_t first>
  LIDARCODEC_AVX2 __m128i read() const {
    const std::uint16_t* const n = here_.data() + first;
    const std::int16_t* const c = cells_;
    return _mm_setr_epi16(c[n[0]], c[n[1]], c[n[2]], c[n[3]], c[n[4]], c[n[5]], c[n[6]], c[n[7]]);
  }
  LIDARCODEC_AVX2 void put() {
    put_eight(there_.data(), _mm256_castsi256_si128(values_));
    put_eight(there_.data() + 8, _mm256_extracti128_si256(values_, 1));
  }
  LIDARCODEC_AVX2 void put_eight(const std::uint16_t* at, __m128i values) {
    cells_[at[0]] = static_cast<std::int16_t>(_mm_extract_epi16(values, 0));
    cells_[at[1]] = static_cast<std::int16_t>(_mm_extract_epi16(values, 1));
    cells_[at[2]] = static_cast<std::int16_t>(_mm_extract_epi16(values, 2));
    cells_[at[3]] = static_cast<std::int16_t>(_mm_extract_epi16(values, 3));
    cells_[at[4]] = static_cast<std::int16_t>(_mm_extract_epi16(values, 4));
    cells_[at[5]] = static_cast<std::int16_t>(_mm_extract_epi16(values, 5));
    cells_[at[6]] = static_cast<std::int16_t>(_mm_extract_epi16(values, 6));
    cells_[at[7]] = static_cast<std::int16_t>(_mm_extract_epi16(values, 7));
  }

  std::int16_t* cells_;
  alignas(32) Numbers here_{}, there_{};  // numbers of this decision, and of the last one
  __m256i values_, numbers_, all_by_;     // of the last decision: its updated cells, their numbers, the update
  std::int32_t by_ = 0;
};

struct Avx2MaskForms {
  using Odds = Avx2LogOdds;

  // Gathers group after group by a shuffle of a vector of kWithin directions.
  template <std::size_t count>
  LIDARCODEC_AVX2 static void look_up(const std::array<const std::uint8_t*, count>& from,
                                      const std::vector<std::uint16_t>& at, const CellGroups& picks,
                                      const std::array<std::uint8_t*, count>& to) {
    constexpr std::size_t kGroup = CellGroups::kGroup;
    for (std::size_t g = 0; g < picks.groups(); ++g) {
      const std::size_t begin = g * kGroup, first = at[begin];
      if (picks[g] == CellGroups::kSpread || first + CellGroups::kWithin > kDirections) {
        look_up_each(from, at.data(), begin, begin + kGroup, to);
        continue;
      }
      const __m128i pick = _mm_cvtsi64_si128(static_cast<long long>(picks[g]));
      for (std::size_t j = 0; j < count; ++j) {
        const __m128i directions = _mm_loadu_si128(reinterpret_cast<const __m128i*>(from[j] + first));
        _mm_storel_epi64(reinterpret_cast<__m128i*>(to[j] + begin), _mm_shuffle_epi8(directions, pick));
      }
    }
    look_up_each(from, at.data(), picks.groups() * kGroup, at.size(), to);
  }

  // Scatters to sixteen directions by a shuffle of a vector of sixteen cells.
  LIDARCODEC_AVX2 static void put_group(const std::uint8_t* cells, const std::uint8_t* behind, std::uint8_t* to) {
    const __m128i values = _mm_loadu_si128(reinterpret_cast<const __m128i*>(cells));
    const __m128i order = _mm_loadu_si128(reinterpret_cast<const __m128i*>(behind));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(to), _mm_shuffle_epi8(values, order));
  }
  LIDARCODEC_AVX2 [[gnu::flatten]] static void put(const std::uint8_t* values, const DirectionGroups& picks,
                                                   std::size_t shift, std::uint8_t* to) {
    put_groups(values, picks, shift, to, put_group);
  }

  // Not inlined: a larger function has too few registers.
  template <class Work>
  LIDARCODEC_AVX2 [[gnu::flatten, gnu::noinline]] static void run(const Work& work) {
    work();
  }
};

}  // namespace lidarcodec
#endif
