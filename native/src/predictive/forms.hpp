// What is done with all contexts of a return at once, for any processor: its slots are found, their log odds added up, and
// all of them taught. A *form* is a struct of such functions; every form gives the same results.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>

#include "bits/cells.hpp"
#include "predictive/positions.hpp"
#include "predictive/model.hpp"
#include "predictive/net_inputs.hpp"

namespace lidarcodec {

// How fast a context learns, by how often it was seen: less than 6, 24, 96 times, and more.
inline constexpr std::array<std::int16_t, 4> kPredictiveRates = {720, 460, 320, 230};
inline constexpr std::array<std::int16_t, 4> kLearnedRates = {216, 138, 96, 70};  // where a network has said most
inline constexpr std::int16_t kBalanceRate = 786;  // even, as the others are
template <bool kLearned>
inline constexpr const std::array<std::int16_t, 4>& kRates = kLearned ? kLearnedRates : kPredictiveRates;
// The first cell of a slot counts how often it was seen, in steps that are the smaller the slower it learns: the upper bits
// then tell the rate.
inline constexpr std::array<std::int16_t, 4> kSeenOnce = {1366, 455, 114, 0};
constexpr std::size_t rate_of_slot(const std::int16_t* slot) { return static_cast<std::uint16_t>(slot[0]) >> 13; }
static_assert([] {
  std::int16_t cell = 0;
  bool right = true;
  for (int seen = 0; seen < 200; ++seen) {
    right = right && rate_of_slot(&cell) == std::size_t{seen >= 6} + (seen >= 24) + (seen >= 96);
    cell = static_cast<std::int16_t>(cell + kSeenOnce[rate_of_slot(&cell)]);
  }
  return right;
}());

// Probabilities of the nodes of a return's tree, 1 to 15.
struct alignas(32) Chances {
  std::array<std::int16_t, 16> of;
};

// A slot's first cell, by features.
constexpr std::uint32_t slot_of(const Context& context, const Features& of) {
  return context.is_pair() ? of[context.a] * 16u + of[context.b]
                           : (of[context.a] >> 1) * 64u + (of[context.b] >> 1) * 8u + (of[context.c] >> 1);
}

// Eight cells at a time.
template <class Cells, class Positions>
struct NarrowForm : PlainProducts {
  // Calls what is to be compiled for the form's processors.
  template <class Work>
  static void run(const Work& work) {
    work();
  }

  template <bool kExpects>
  static void find(const Known& known, Slots& found) {
    Features of;
    Positions::of_around(known.around, known.scale, of.data());
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
      Positions::of_expected(known.expected, known.scale, of.data() + kSeenLeft);
      of[kSeenMask] = static_cast<std::uint8_t>((known.returns >> 9 & 7u) | (known.returns >> 7 & 1u) << 3);
      of[kSeenSize] = relative(known.seen_size);
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
    for (std::size_t i = 0; i < kOfFeatures; ++i)
      name(kFixedContexts + i, slot_of(context_of_features(i), of));
  }

  static NearRanges near(const std::array<std::int32_t, 8>& ranges, std::int32_t origin, bool down) { return {ranges, origin, down}; }
  static std::uint32_t from(const NearRanges& near, std::uint32_t so_far) { return near.from(so_far); }

  static Cells error_of(const Walk& walked, const Chances& chances, std::size_t at) {
    return errors(Cells::load(walked.wanted.data() + at), Cells::load(walked.taken.data() + at), Cells::load(chances.of.data() + at));
  }

  // kUsed: numbers of the contexts, here and below.
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
  static void add_up(const std::int16_t* cells, const Slots& slots, Chances& chances) {
    for (std::size_t at = 0; at < kSlotCells; at += 8) probabilities(sum_of<kUsed>(cells, slots, at)).store(chances.of.data() + at);
  }

  // The same with what a network says, each by its weight. said: takes the log odds of the contexts.
  template <const auto& kUsed>
  static void weigh(const std::int16_t* cells, const Slots& slots, const std::int16_t* net, const Balance& weights,
                    std::int16_t* said, Chances& chances) {
    for (std::size_t at = 0; at < kSlotCells; at += 8) {
      const Cells contexts = sum_of<kUsed>(cells, slots, at);
      contexts.store(said + at);
      const Cells quarter = product(Cells::load(net + at), Cells::load(weights.of_net.data() + at)) +
                            product(contexts, Cells::load(weights.of_contexts.data() + at));
      const Cells half = quarter + quarter;
      probabilities(half + half).store(chances.of.data() + at);
    }
  }

  static void learn_weights(Balance& weights, const std::int16_t* net, const std::int16_t* said, const Chances& chances,
                            const Walk& walked) {
    for (std::size_t at = 0; at < kSlotCells; at += 8) {
      const Cells error = error_of(walked, chances, at);
      const auto move = [&](std::int16_t* weight, const std::int16_t* of) {
        (Cells::load(weight + at) + by_rate(product(error, Cells::load(of + at)), kBalanceRate)).store(weight + at);
      };
      move(weights.of_net.data(), net);
      move(weights.of_contexts.data(), said);
    }
  }

  // walked: down the tree, where the return lies.
  template <const auto& kUsed, bool kLearned>
  static void learn(std::int16_t* cells, const Slots& slots, const Chances& chances, const Walk& walked) {
    std::array<std::array<Cells, 2>, kRates<kLearned>.size()> by;
    for (std::size_t v = 0; v < 2; ++v) {
      const Cells error = error_of(walked, chances, 8 * v);
#pragma GCC unroll 4
      for (std::size_t r = 0; r < by.size(); ++r) by[r][v] = by_rate(error, kRates<kLearned>[r]);
    }
    for (std::size_t r = 0; r < by.size(); ++r) {
      const std::array<std::int16_t, 8> seen = {kSeenOnce[r]};
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
using VectorForms = NarrowForm<Cells, Positions>;  // SSE2 or NEON, which every processor of their kind has

}  // namespace lidarcodec
