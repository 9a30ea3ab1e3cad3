// The functions of predictive/forms.hpp for AVX2: a vector holds a whole slot, or the slots of all contexts. The form
// is chosen at run time (predictive/paths.hpp), so each function has its own target attribute.
#pragma once
#if defined(__x86_64__)
#include <immintrin.h>

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "base/processor.hpp"
#include "predictive/forms.hpp"

namespace lidarcodec {

// Byte shuffles that gather the features of each context. The features are in four vectors of 16 bytes: two of
// positions, one of classes, one of positions of expected ranges. Packing leaves the positions as {groups 0 1 4 5} and
// {groups 2 3 6 7}.
struct alignas(32) Avx2Tables {
  using Bytes = std::array<std::uint8_t, 32>;
  static constexpr std::size_t kLanes = 16;
  static_assert(kAllContexts - kFixedContexts <= kLanes);

  std::array<Bytes, 4> two{},
      third{};      // shuffles of each vector for the first two features of each context, and for the third
  Bytes kept{};     // mask of the bits of the first two that are used
  Bytes weights{};  // of the first two; the weighted sum plus the third is twice the slot
  alignas(32) std::array<std::uint32_t, kLanes> begins{};

  constexpr Avx2Tables() {
    for (auto* of : {&two, &third})
      for (Bytes& bytes : *of) bytes.fill(0x80);  // not in this vector: the shuffle gives 0
    for (std::size_t i = 0; i < kAllContexts - kFixedContexts; ++i) {
      const Context context = context_of_features(i);
      place(two, 2 * i, context.a);
      place(two, 2 * i + 1, context.b);
      if (!context.is_pair()) place(third, 2 * i, context.c);
      kept[2 * i] = kept[2 * i + 1] = context.is_pair() ? 0x0F : 0x0E;
      weights[2 * i] = context.is_pair() ? 32 : 64;
      weights[2 * i + 1] = context.is_pair() ? 2 : 8;
      begins[i] = kContextBegins[kFixedContexts + i];
    }
  }

 private:
  static constexpr void place(std::array<Bytes, 4>& of, std::size_t lane, Feature feature) {
    const std::size_t group = feature / 4u;
    const std::size_t vector = feature < kPositionLanes ? group / 2 % 2 : feature / 16u;
    const std::size_t at = feature < kPositionLanes ? (group / 4 * 2 + group % 2) * 4 + feature % 4u : feature % 16u;
    of[vector][lane] = static_cast<std::uint8_t>(at);
  }
};
inline constexpr Avx2Tables kAvx2Tables;

constexpr bool all_even(const std::array<std::int16_t, 4>& rates) {
  return rates[0] % 2 == 0 && rates[1] % 2 == 0 && rates[2] % 2 == 0 && rates[3] % 2 == 0;
}
static_assert(all_even(kContextRates) && all_even(kNetworkRates));

struct Avx2Forms {
  template <class Work>
  LIDARCODEC_AVX2 [[gnu::flatten]] static void run(const Work& work) {
    work();
  }

  template <bool kExpects>
  LIDARCODEC_AVX2 static void find(const Known& known, Slots& found) {
    constexpr std::size_t kPairs = kExpects ? 3 : 2;  // vectors of differences
    __m256i differences[kPairs], sizes[kPairs], counts[kPairs];
    differences[0] = differences_first(known.around);
    differences[1] = differences_second(known.around);
    if constexpr (kExpects) differences[2] = differences_expected(known.expected);
    for (std::size_t v = 0; v < kPairs; ++v) {
      sizes[v] = _mm256_min_epu16(_mm256_abs_epi16(differences[v]), _mm256_set1_epi16(32767));
      counts[v] = _mm256_set1_epi16(static_cast<std::int16_t>(kPositionLimitCount));
    }
    const auto& limits = kLaneLimits[known.scale].of;
#pragma GCC unroll 7
    for (std::size_t k = 0; k < kPositionLimitCount; ++k) {
      const __m256i limit =
          _mm256_broadcastsi128_si256(_mm_load_si128(reinterpret_cast<const __m128i*>(limits[k].data())));
      for (std::size_t v = 0; v < kPairs; ++v)
        counts[v] = _mm256_add_epi16(counts[v], _mm256_cmpgt_epi16(limit, sizes[v]));
    }
    for (std::size_t v = 0; v < kPairs; ++v) {
      const __m256i turned = _mm256_xor_si256(counts[v], _mm256_srai_epi16(differences[v], 15));
      counts[v] = _mm256_add_epi16(turned, _mm256_set1_epi16(8));
    }
    const __m256i positions = _mm256_packus_epi16(counts[0], counts[1]);
    const __m256i first = _mm256_permute4x64_epi64(positions, 0x44), second = _mm256_permute4x64_epi64(positions, 0xEE);
    const __m256i classes = _mm256_broadcastsi128_si256(classes_of(known));
    __m256i two = pick(first, second, classes, kAvx2Tables.two),
            third = pick(first, second, classes, kAvx2Tables.third);
    if constexpr (kExpects) {
      const __m256i expected = _mm256_permute4x64_epi64(_mm256_packus_epi16(counts[2], counts[2]), 0x88);
      two = _mm256_or_si256(two, _mm256_shuffle_epi8(expected, load(kAvx2Tables.two[3])));
      third = _mm256_or_si256(third, _mm256_shuffle_epi8(expected, load(kAvx2Tables.third[3])));
    }
    two = _mm256_and_si256(two, load(kAvx2Tables.kept));
    third = _mm256_and_si256(third, _mm256_set1_epi16(0x0E));
    const __m256i twice = _mm256_add_epi16(_mm256_maddubs_epi16(two, load(kAvx2Tables.weights)), third);
    put(_mm256_castsi256_si128(twice), kAvx2Tables.begins.data(), found.of.data() + kFixedContexts);
    put(_mm256_extracti128_si256(twice, 1), kAvx2Tables.begins.data() + 8, found.of.data() + kFixedContexts + 8);
    const auto up = static_cast<std::uint32_t>(_mm256_extract_epi8(positions, kUp));
    found.of[0] = kContextBegins[0] + known.scale * kSlotCells;
    found.of[1] = kContextBegins[1] + known.leaves * kSlotCells;
    found.of[2] = kContextBegins[2] + known.returns % kMaskContexts * kSlotCells;
    found.of[3] = kContextBegins[3] + (up * kScaleClasses + known.scale) * kSlotCells;
    found.of[4] = kContextBegins[4] + known.firing * kSlotCells;
    asm("" : "+m"(found));  // else GCC extracts the numbers from the vectors one by one, which is slower
  }

  LIDARCODEC_AVX2 static NearRanges near(const std::array<std::int32_t, 8>& r, std::int32_t origin, bool down) {
    const __m256i ranges = _mm256_setr_epi32(r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7]);
    const __m256i apart = _mm256_srai_epi32(_mm256_sub_epi32(ranges, _mm256_set1_epi32(origin)), 4);
    const __m256i away = _mm256_xor_si256(apart, _mm256_set1_epi32(down ? -1 : 0));
    NearRanges near;
    _mm256_store_si256(reinterpret_cast<__m256i*>(near.away.data()), away);
    return near;
  }

  LIDARCODEC_AVX2 static std::uint32_t from(const NearRanges& near, std::uint32_t so_far) {
    const __m256i away = _mm256_load_si256(reinterpret_cast<const __m256i*>(near.away.data()));
    const __m256i is = _mm256_cmpgt_epi32(away, _mm256_set1_epi32(static_cast<std::int32_t>(so_far) - 1));
    return static_cast<std::uint32_t>(_mm256_movemask_ps(_mm256_castsi256_ps(is)));
  }

  template <bool kExpects>
  LIDARCODEC_AVX2 [[gnu::flatten]] static void inputs(const Surroundings& of, std::int8_t* in) {
    find_inputs<kExpects, Avx2GroupWriter>(of, in);
  }

  LIDARCODEC_AVX2 static std::int32_t products(const std::int16_t* a, const std::int16_t* b, std::size_t blocks) {
    __m256i sums = _mm256_madd_epi16(load(a), load(b));
    for (std::size_t at = kTileOutputs; at < blocks * kTileOutputs; at += kTileOutputs)
      sums = _mm256_add_epi32(sums, _mm256_madd_epi16(load(a + at), load(b + at)));
    const __m128i four = _mm_add_epi32(_mm256_castsi256_si128(sums), _mm256_extracti128_si256(sums, 1));
    const __m128i two = _mm_add_epi32(four, _mm_shuffle_epi32(four, 0x4E));
    return _mm_cvtsi128_si32(two) + _mm_extract_epi32(two, 1);
  }

  template <const auto& kUsed>
  LIDARCODEC_AVX2 static void add_up(const std::int16_t* cells, const Slots& slots, Probabilities& chances) {
    store(probabilities_of(sum_of<kUsed>(cells, slots)), chances.of.data());
  }

  template <const auto& kUsed>
  LIDARCODEC_AVX2 static void mix(const std::int16_t* cells, const Slots& slots, const std::int16_t* net,
                                  const MixingWeights& weights, std::int16_t* context_odds, Probabilities& chances) {
    const __m256i contexts = sum_of<kUsed>(cells, slots);
    store(contexts, context_odds);
    const __m256i quarter = _mm256_adds_epi16(_mm256_mulhi_epi16(load(net), load(weights.of_net.data())),
                                              _mm256_mulhi_epi16(contexts, load(weights.of_contexts.data())));
    const __m256i half = _mm256_adds_epi16(quarter, quarter);
    store(probabilities_of(_mm256_adds_epi16(half, half)), chances.of.data());
  }

  LIDARCODEC_AVX2 static void learn_mixing(MixingWeights& weights, const std::int16_t* net,
                                           const std::int16_t* context_odds, const Probabilities& chances,
                                           const Walk& walked) {
    const __m256i error = error_of(walked, chances);
    const __m256i rate = _mm256_set1_epi16(kMixingRate / 2);
    const __m256i by_net = _mm256_mulhrs_epi16(_mm256_mulhi_epi16(error, load(net)), rate);
    const __m256i by_contexts = _mm256_mulhrs_epi16(_mm256_mulhi_epi16(error, load(context_odds)), rate);
    store(_mm256_adds_epi16(load(weights.of_net.data()), by_net), weights.of_net.data());
    store(_mm256_adds_epi16(load(weights.of_contexts.data()), by_contexts), weights.of_contexts.data());
  }

  template <const auto& kUsed, bool kNetwork>
  LIDARCODEC_AVX2 static void learn(std::int16_t* cells, const Slots& slots, const Probabilities& chances,
                                    const Walk& walked) {
    const __m256i error = error_of(walked, chances);
    alignas(32) std::array<std::array<std::int16_t, kSlotCells>, kRates<kNetwork>.size()> by;
#pragma GCC unroll 4
    for (std::size_t r = 0; r < by.size(); ++r) {
      // (error * rate / 2 + 2^14) >> 15 is what `by_rate` gives, as rates are even.
      __m256i move = _mm256_mulhrs_epi16(error, _mm256_set1_epi16(static_cast<std::int16_t>(kRates<kNetwork>[r] / 2)));
      if (r + 1 < by.size()) move = _mm256_add_epi16(move, _mm256_zextsi128_si256(_mm_cvtsi32_si128(kCountSteps[r])));
      store(move, by[r].data());
    }
#pragma GCC unroll 20
    for (const std::uint8_t context : kUsed) {
      std::int16_t* const slot = cells + slots.of[context];
      const std::int16_t* const move = by[rate_of_slot(slot)].data();
      store(_mm256_adds_epi16(load(slot), load(move)), slot);
    }
  }

 private:
  // inputs::GroupWriter, eight differences at a time.
  struct Avx2GroupWriter {
    template <std::size_t Linear, inputs::Slices A, inputs::Slices B>
    LIDARCODEC_AVX2 static void put(const inputs::Quantiser& quantiser, const inputs::DifferenceGroups& a,
                                    const inputs::DifferenceGroups& b, std::int8_t* in) {
      const __m256 units = _mm256_set1_ps(quantiser.units[0]), sixteenths = _mm256_set1_ps(quantiser.units[0] * 16.0f);
      __m256i quarters[4], sizes[4];
#pragma GCC unroll 4
      for (std::size_t g = 0; g < 4; ++g) {
        const __m256i apart = _mm256_sub_epi32(both(a[g].of, b[g].of), both(a[g].from, b[g].from));
        quarters[g] = _mm256_add_epi32(_mm256_srai_epi32(apart, 2), both(a[g].more, b[g].more));
        const __m256 size =
            _mm256_mul_ps(_mm256_cvtepi32_ps(_mm256_abs_epi32(quarters[g])), g < Linear ? sixteenths : units);
        sizes[g] = g < Linear ? _mm256_cvttps_epi32(_mm256_add_ps(size, _mm256_set1_ps(0.5f))) : log2_16(size);
      }
      // Packing saturates sizes at 127, and keeps the signs of quarters.
      const __m256i numbers = _mm256_sign_epi8(packed(sizes), packed(quarters));
      put<A>(_mm256_castsi256_si128(numbers), in);
      put<B>(_mm256_extracti128_si256(numbers, 1), in);
    }

   private:
    LIDARCODEC_AVX2 static __m256i both(inputs::Ints a, inputs::Ints b) {
      return _mm256_inserti128_si256(_mm256_castsi128_si256(std::bit_cast<__m128i>(a)), std::bit_cast<__m128i>(b), 1);
    }
    LIDARCODEC_AVX2 static __m256i log2_16(__m256 size) {
      const __m256i bits = _mm256_castps_si256(_mm256_add_ps(size, _mm256_set1_ps(1.0f)));
      return _mm256_srai_epi32(_mm256_sub_epi32(bits, _mm256_set1_epi32(0x3f800000)), 19);
    }
    LIDARCODEC_AVX2 static __m256i packed(const __m256i (&of)[4]) {
      return _mm256_packs_epi16(_mm256_packs_epi32(of[0], of[1]), _mm256_packs_epi32(of[2], of[3]));
    }

    // The number of bytes if the slices are adjacent, else 0.
    static constexpr std::size_t run_of(const inputs::Slices& places) {
      std::size_t bytes = places[0].count;
      for (std::size_t g = 1; g < places.size(); bytes += places[g++].count)
        if (places[g].at != places[0].at + bytes) return 0;
      return bytes;
    }
    // Shuffle of the first eight bytes of a run, and of its last eight.
    static constexpr std::array<std::uint8_t, 16> ends_of(const inputs::Slices& places) {
      std::array<std::uint8_t, 16> run{}, ends{};
      std::size_t bytes = 0;
      for (std::size_t g = 0; g < places.size(); ++g)
        for (std::size_t i = 0; i < places[g].count; ++i) run[bytes++] = static_cast<std::uint8_t>(4 * g + i);
      for (std::size_t i = 0; i < 8; ++i) {
        ends[i] = run[i];
        ends[8 + i] = run[bytes - 8 + i];
      }
      return ends;
    }
    template <inputs::Slices To>
    LIDARCODEC_AVX2 static void put(__m128i numbers, std::int8_t* in) {
      constexpr std::size_t kBytes = run_of(To);
      if constexpr (kBytes >= 8) {
        static constexpr std::array<std::uint8_t, 16> kEnds = ends_of(To);
        const __m128i ends = _mm_shuffle_epi8(numbers, _mm_loadu_si128(reinterpret_cast<const __m128i*>(kEnds.data())));
        _mm_storel_epi64(reinterpret_cast<__m128i*>(in + To[0].at), ends);
        _mm_storeh_pd(reinterpret_cast<double*>(in + To[0].at + kBytes - 8), _mm_castsi128_pd(ends));
      } else {
        alignas(16) std::array<std::int8_t, 16> bytes;
        _mm_store_si128(reinterpret_cast<__m128i*>(bytes.data()), numbers);
        for (std::size_t g = 0; g < To.size(); ++g) std::memcpy(in + To[g].at, bytes.data() + 4 * g, To[g].count);
      }
    }
  };

  template <const auto& kUsed>
  LIDARCODEC_AVX2 static __m256i sum_of(const std::int16_t* cells, const Slots& slots) {
    __m256i sum = load(cells + slots.of[kUsed[0]]);
#pragma GCC unroll 20
    for (std::size_t i = 1; i < kUsed.size(); ++i) sum = _mm256_adds_epi16(sum, load(cells + slots.of[kUsed[i]]));
    return sum;
  }

  LIDARCODEC_AVX2 static __m256i error_of(const Walk& walked, const Probabilities& chances) {
    const __m256i missing = _mm256_sub_epi16(load(walked.wanted.data()), load(chances.of.data()));
    return _mm256_and_si256(missing, load(walked.taken.data()));
  }

  // As `probabilities` in bits/cells.hpp.
  LIDARCODEC_AVX2 static __m256i probabilities_of(__m256i sum) {
    const __m256i flip = _mm256_andnot_si256(_mm256_srai_epi16(sum, 15), _mm256_set1_epi16(kOne));
    const __m256i left = _mm256_xor_si256(sum, flip), t = _mm256_add_epi16(left, left);
    const __m256i cube = _mm256_mulhi_epu16(_mm256_mulhi_epu16(t, t), t);
    return _mm256_xor_si256(_mm256_max_epi16(_mm256_srli_epi16(cube, 2), _mm256_set1_epi16(kRarest)), flip);
  }

  template <class T>
  LIDARCODEC_AVX2 static __m256i load(const T* from) {
    return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(from));
  }
  LIDARCODEC_AVX2 static __m256i load(const Avx2Tables::Bytes& from) { return load(from.data()); }
  LIDARCODEC_AVX2 static void store(__m256i from, std::int16_t* to) {
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(to), from);
  }

  // A vector of two times four numbers: low in the lower half, high in the upper.
  LIDARCODEC_AVX2 static __m256i fours(const std::int32_t* low, const std::int32_t* high) {
    return _mm256_inserti128_si256(_mm256_castsi128_si256(_mm_loadu_si128(reinterpret_cast<const __m128i*>(low))),
                                   _mm_loadu_si128(reinterpret_cast<const __m128i*>(high)), 1);
  }
  // A vector with `low` four times in the lower half, and the lower half of `high` in the upper.
  LIDARCODEC_AVX2 static __m256i same(std::int32_t low, __m256i high) {
    return _mm256_permute2x128_si256(_mm256_castsi128_si256(_mm_set1_epi32(low)), high, 0x20);
  }
  LIDARCODEC_AVX2 static __m256i quarters(__m256i sixteenths) { return _mm256_srai_epi32(sixteenths, 2); }
  LIDARCODEC_AVX2 static __m256i in_low_half(std::int32_t number) {
    return _mm256_zextsi128_si256(_mm_set1_epi32(number));
  }

  // Differences of predictive/positions.hpp: groups 0 to 3.
  LIDARCODEC_AVX2 static __m256i differences_first(const Neighbours& around) {
    const __m256i above = fours(around.above, around.above + 1);
    const __m256i even = quarters(_mm256_sub_epi32(fours(around.last, around.above), _mm256_set1_epi32(around.base)));
    const __m256i odd = quarters(_mm256_sub_epi32(above, same(around.base, above)));
    return _mm256_packs_epi32(even, _mm256_add_epi32(odd, in_low_half(around.level)));
  }

  // Groups 4 to 7.
  LIDARCODEC_AVX2 static __m256i differences_second(const Neighbours& around) {
    const __m256i upper = fours(around.upper, around.upper + 1);
    const __m256i even = _mm256_sub_epi32(fours(around.above + 2, around.upper), fours(around.above, around.above));
    const __m256i odd = quarters(_mm256_sub_epi32(upper, same(around.base, upper)));
    return _mm256_packs_epi32(_mm256_srav_epi32(even, _mm256_setr_epi32(3, 3, 3, 3, 2, 2, 2, 2)), odd);
  }

  // Groups 0 to 3 of expected ranges.
  LIDARCODEC_AVX2 static __m256i differences_expected(const Expected& expected) {
    const __m256i here = fours(expected.here, expected.here + 1), came = fours(expected.here, expected.came);
    const __m256i above = fours(expected.here, expected.above), base = _mm256_set1_epi32(expected.base);
    const __m256i even = quarters(_mm256_sub_epi32(here, same(expected.base, here)));
    const __m256i odd = quarters(_mm256_sub_epi32(came, _mm256_blend_epi32(base, above, 0xF0)));
    return _mm256_packs_epi32(_mm256_add_epi32(even, in_low_half(expected.bias)), odd);
  }

  // The classes of Feature from kScale on.
  LIDARCODEC_AVX2 static __m128i classes_of(const Known& known) {
    const std::uint32_t seen = (known.returns >> 9 & 7u) | (known.returns >> 7 & 1u) << 3;
    const std::uint32_t direct = known.scale / 2 | known.returns >> 12 << 8 | known.leaves >> 4 << 16 | seen << 24;
    // scale_class of four sizes: exponent and mantissa of a float that holds size + 2 exactly.
    __m128i sizes =
        _mm_cvtsi32_si128(static_cast<int>(known.mean_size));  // one by one: a vector load would wait for the stores
    sizes = _mm_insert_epi32(sizes, static_cast<int>(known.last_size), 1);
    sizes = _mm_insert_epi32(sizes, static_cast<int>(known.up_size), 2);
    sizes = _mm_insert_epi32(sizes, static_cast<int>(known.seen_size), 3);
    const __m128i number = _mm_castps_si128(_mm_cvtepi32_ps(_mm_add_epi32(sizes, _mm_set1_epi32(2))));
    const __m128i mantissa = _mm_and_si128(number, _mm_set1_epi32(0x7FFFFF));
    const __m128i upper_half = _mm_cmpgt_epi32(
        mantissa, _mm_set1_epi32(0x3504F3));  // of the octave: the mantissa is above the square root of 2
    const __m128i halves = _mm_sub_epi32(_mm_slli_epi32(_mm_srli_epi32(number, 23), 1), upper_half);
    constexpr int kFirst = 2 * 127 + 1;  // that of class 0
    const __m128i of_class = _mm_min_epi32(halves, _mm_set1_epi32(kFirst + static_cast<int>(kScaleClasses) - 1));
    const __m128i relative = _mm_sub_epi32(of_class, _mm_set1_epi32(kFirst - 7 + static_cast<int>(known.scale)));
    const __m128i words = _mm_packus_epi32(_mm_min_epi32(relative, _mm_set1_epi32(15)), _mm_setzero_si128());
    return _mm_unpacklo_epi32(_mm_cvtsi32_si128(static_cast<int>(direct)), _mm_packus_epi16(words, words));
  }

  LIDARCODEC_AVX2 static __m256i pick(__m256i first, __m256i second, __m256i classes,
                                      const std::array<Avx2Tables::Bytes, 4>& at) {
    const __m256i positions =
        _mm256_or_si256(_mm256_shuffle_epi8(first, load(at[0])), _mm256_shuffle_epi8(second, load(at[1])));
    return _mm256_or_si256(positions, _mm256_shuffle_epi8(classes, load(at[2])));
  }

  // First cells of eight slots, given twice their numbers.
  LIDARCODEC_AVX2 static void put(__m128i twice, const std::uint32_t* begins, std::uint32_t* found) {
    static_assert(kSlotCells == 16);
    const __m256i cells = _mm256_slli_epi32(_mm256_cvtepu16_epi32(twice), 3);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(found), _mm256_add_epi32(cells, load(begins)));
  }
};

}  // namespace lidarcodec

#undef LIDARCODEC_AVX2
#endif
