// The computations on all contexts of a return: find the slots, sum the log odds, update the cells. A *form* is a
// struct of these functions for one kind of processor. All forms give the same results.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>

#include "bits/cells.hpp"
#include "predictive/model.hpp"
#include "predictive/net_inputs.hpp"
#include "predictive/positions.hpp"

namespace lidarcodec {

// Learning rates of a context, of 65536, by how often it was seen: below 6, 24 and 96 times, and from 96 on.
inline constexpr std::array<std::int16_t, 4> kContextRates = {720, 460, 320, 230};
inline constexpr std::array<std::int16_t, 4> kNetworkRates = {
    216, 138, 96, 70};                            // with a network as prior: 0.3 times those, rounded to even
inline constexpr std::int16_t kMixingRate = 786;  // of the weights of mixing: 0.012; even, as AVX2 halves rates
template <bool kNetwork>
inline constexpr const std::array<std::int16_t, 4>& kRates = kNetwork ? kNetworkRates : kContextRates;
// The first cell of a slot counts how often it was seen. The count advances by 8192 / 6, 8192 / 18 and 8192 / 72 a
// time, so that its upper three bits are the number of the rate.
inline constexpr std::array<std::int16_t, 4> kCountSteps = {1366, 455, 114, 0};
constexpr std::size_t rate_of_slot(const std::int16_t* slot) { return static_cast<std::uint16_t>(slot[0]) >> 13; }
static_assert([] {
  std::int16_t cell = 0;
  bool right = true;
  for (int seen = 0; seen < 200; ++seen) {
    right = right && rate_of_slot(&cell) == std::size_t{seen >= 6} + (seen >= 24) + (seen >= 96);
    cell = static_cast<std::int16_t>(cell + kCountSteps[rate_of_slot(&cell)]);
  }
  return right;
}());

// The probabilities of a one at the nodes 1 to 15 of a return's tree, of 32768.
struct alignas(32) Probabilities {
  std::array<std::int16_t, 16> of;
};

// The slot of a context: 4 bits of each of two features, or the upper 3 bits of each of three.
constexpr std::uint32_t slot_of(const Context& context, const Features& of) {
  return context.is_pair() ? of[context.a] * 16u + of[context.b]
                           : (of[context.a] >> 1) * 64u + (of[context.b] >> 1) * 8u + (of[context.c] >> 1);
}

// Eight cells at a time.
template <class Cells, class Positions>
struct NarrowForm : PlainProducts {
  // Calls `work`, compiled for the form's processors.
  template <class Work>
  static void run(const Work& work) {
    work();
  }

  template <bool kExpects>
  static void find(const Known& known, Slots& found) {
    Features of;
    Positions::of_neighbours(known.around, known.scale, of.data());
    const auto relative = [&](std::uint32_t size) {
      const std::int32_t c = static_cast<std::int32_t>(scale_class(size)) - static_cast<std::int32_t>(known.scale) + 7;
      return static_cast<std::uint8_t>(std::clamp(c, 0, 15));
    };
    of[kScale] = static_cast<std::uint8_t>(known.scale / 2);
    of[kMask] = static_cast<std::uint8_t>(known.returns >> 12);
    of[kLastLeaf] = static_cast<std::uint8_t>(known.leaves >> 4);
    of[kMeanSize] = relative(known.mean_size);
    of[kLastSize] = relative(known.last_size);
    of[kUpSize] = relative(known.up_size);
    if constexpr (kExpects) {
      Positions::of_expected(known.expected, known.scale, of.data() + kExpectedLeft);
      of[kExpectedMask] = static_cast<std::uint8_t>((known.returns >> 9 & 7u) | (known.returns >> 7 & 1u) << 3);
      of[kExpectedSize] = relative(known.seen_size);
    }
    const auto name = [&](std::size_t context, std::uint32_t slot) {
      found.of[context] = kContextBegins[context] + slot * kSlotCells;
    };
    name(0, known.scale);
    name(1, known.leaves);
    name(2, known.returns % kMaskContexts);
    name(3, of[kUp] * kScaleClasses + known.scale);
    name(4, known.firing);
    constexpr std::size_t kOfFeatures = all_contexts<kExpects>().size() - kFixedContexts;
#pragma GCC unroll 16
    for (std::size_t i = 0; i < kOfFeatures; ++i) name(kFixedContexts + i, slot_of(context_of_features(i), of));
  }

  static NearRanges near(const std::array<std::int32_t, 8>& ranges, std::int32_t origin, bool down) {
    return {ranges, origin, down};
  }
  static std::uint32_t from(const NearRanges& near, std::uint32_t so_far) { return near.from(so_far); }

  static Cells error_of(const Walk& walked, const Probabilities& chances, std::size_t at) {
    return errors(Cells::load(walked.wanted.data() + at), Cells::load(walked.taken.data() + at),
                  Cells::load(chances.of.data() + at));
  }

  // The sum of log odds. kUsed: the contexts, here and below.
  template <const auto& kUsed>
  static Cells sum_of(const std::int16_t* cells, const Slots& slots, std::size_t at) {
    Cells sum = Cells::load(cells + slots.of[kUsed[0]] + at);
#pragma GCC unroll 20
    for (std::size_t i = 1; i < kUsed.size(); ++i) sum = sum + Cells::load(cells + slots.of[kUsed[i]] + at);
    return sum;
  }

  template <bool kExpects>
  static void inputs(const Surroundings& of, std::int8_t* in) {
    find_inputs<kExpects>(of, in);
  }

  template <const auto& kUsed>
  static void add_up(const std::int16_t* cells, const Slots& slots, Probabilities& chances) {
    for (std::size_t at = 0; at < kSlotCells; at += 8)
      probabilities(sum_of<kUsed>(cells, slots, at)).store(chances.of.data() + at);
  }

  // Logistic mixing of the log odds of the contexts with those of a network, net. Writes the log odds of the contexts
  // to context_odds.
  template <const auto& kUsed>
  static void mix(const std::int16_t* cells, const Slots& slots, const std::int16_t* net, const MixingWeights& weights,
                  std::int16_t* context_odds, Probabilities& chances) {
    for (std::size_t at = 0; at < kSlotCells; at += 8) {
      const Cells contexts = sum_of<kUsed>(cells, slots, at);
      contexts.store(context_odds + at);
      const Cells quarter = product(Cells::load(net + at), Cells::load(weights.of_net.data() + at)) +
                            product(contexts, Cells::load(weights.of_contexts.data() + at));
      const Cells half = quarter + quarter;
      probabilities(half + half).store(chances.of.data() + at);
    }
  }

  static void learn_mixing(MixingWeights& weights, const std::int16_t* net, const std::int16_t* context_odds,
                           const Probabilities& chances, const Walk& walked) {
    for (std::size_t at = 0; at < kSlotCells; at += 8) {
      const Cells error = error_of(walked, chances, at);
      const auto move = [&](std::int16_t* weight, const std::int16_t* of) {
        (Cells::load(weight + at) + by_rate(product(error, Cells::load(of + at)), kMixingRate)).store(weight + at);
      };
      move(weights.of_net.data(), net);
      move(weights.of_contexts.data(), context_odds);
    }
  }

  // Updates the cells of the nodes on the path to the return's leaf, walked.
  template <const auto& kUsed, bool kNetwork>
  static void learn(std::int16_t* cells, const Slots& slots, const Probabilities& chances, const Walk& walked) {
    std::array<std::array<Cells, 2>, kRates<kNetwork>.size()> by;
    for (std::size_t v = 0; v < 2; ++v) {
      const Cells error = error_of(walked, chances, 8 * v);
#pragma GCC unroll 4
      for (std::size_t r = 0; r < by.size(); ++r) by[r][v] = by_rate(error, kRates<kNetwork>[r]);
    }
    for (std::size_t r = 0; r < by.size(); ++r) {
      const std::array<std::int16_t, 8> seen = {kCountSteps[r]};
      by[r][0] = by[r][0] + Cells::load(seen.data());
    }
#pragma GCC unroll 20
    for (const std::uint8_t context : kUsed) {
      std::int16_t* const slot = cells + slots.of[context];
      const std::array<Cells, 2>& move = by[rate_of_slot(slot)];
      (Cells::load(slot) + move[0]).store(slot);
      (Cells::load(slot + 8) + move[1]).store(slot + 8);
    }
  }
};

using PlainForms = NarrowForm<PlainCells, PlainPositions>;
using VectorForms = NarrowForm<Cells, Positions>;  // SSE2 or NEON, which all x86-64 and AArch64 processors have

}  // namespace lidarcodec
