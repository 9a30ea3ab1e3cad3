// The decisions of a range other than its first tree: offset bits, octaves beyond the last leaf, and the second tree.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "base/error.hpp"
#include "bits/cells.hpp"
#include "bits/wide_coder.hpp"
#include "network/samples.hpp"
#include "predictive/beyond.hpp"
#include "predictive/forms.hpp"
#include "predictive/model.hpp"

namespace lidarcodec {

// Learning rates, of 65536: 0.01, and less where a network gives the prior.
inline constexpr std::int32_t kOffsetRate = 655;
inline constexpr std::int32_t kNetworkOffsetRate = 120;
// The prior of one more octave: log odds of half a natural unit, a probability of 0.62 (native/src/bits/README.md,
// Cells).
inline constexpr std::int32_t kOctaveLogOdds = 32768 / 6 / 2;
inline constexpr std::uint32_t kMaxOctaves =
    17;  // beyond the last leaf; 17 octaves are 2^17 - 1 cells, more than any range

// The leaves of each scale: the distance at which each begins, and log2 of its width. The width of the last one is that
// of its first octave.
struct Leaves {
#if defined(__wasm__)  // small, for the page; encoders compare 32 bits faster
  using Begin = std::uint16_t;
#else
  using Begin = std::uint32_t;
#endif
  std::array<std::array<Begin, 8>, kScaleClasses> begins{};
  std::array<std::array<std::uint8_t, 8>, kScaleClasses> bits{};

  constexpr explicit Leaves(const std::uint8_t (&widths)[kScaleClasses][7]) {
    for (std::size_t c = 0; c < kScaleClasses; ++c) {
      for (std::size_t l = 0; l < 7; ++l) {
        bits[c][l] = widths[c][l];
        begins[c][l + 1] = static_cast<Begin>(begins[c][l] + (1u << widths[c][l]));
      }
      bits[c][7] = kBeyondBits[c];
    }
  }

  std::uint32_t of(std::uint32_t scale, std::uint32_t away) const {
    std::uint32_t leaf = 0;
    for (std::size_t l = 1; l < 8; ++l) leaf += away >= begins[scale][l];
    return leaf;
  }
};
inline constexpr Leaves kLeaves(kLeafBits), kQuickLeaves(kQuickLeafBits);

// The number of modelled offset bits, by leaf. The density is steepest in the middle
// (research/notes/offset-bits-by-leaf.md).
inline constexpr std::array<std::uint8_t, 8> kDepths = {4, 1, 1, 1, 2, 2, 2, 3};

// `Coder` is WideEncoder or WideDecoder.
template <class Coder>
class RangeDecisions {
 public:
  static constexpr bool kReads = std::is_same_v<Coder, WideDecoder>;

 protected:
  // limit: largest range, in cells.
  RangeDecisions(PredictiveModel& model, std::int32_t limit) : model_(model), limit_(limit) {}

  // Whether no range is so far from its base. The limit is doubled, since a base from a slab with another step may
  // exceed the largest range.
  bool is_too_far(std::uint32_t away) const { return away > 2 * static_cast<std::uint32_t>(limit_); }

  // The first modelled offset bits of a difference in a leaf; kNone where there are fewer.
  static std::array<std::uint8_t, RiddleSamples::kOffsets> first_offsets(std::uint32_t scale, std::uint32_t leaf,
                                                                         std::uint32_t away) {
    std::array<std::uint8_t, RiddleSamples::kOffsets> bits;
    bits.fill(RiddleSamples::kNone);
    const std::uint32_t l = leaf < 8 ? 7 - leaf : leaf - 8;
    if (l == 7) return bits;
    std::uint32_t left = kLeaves.bits[scale][l];
    for (std::size_t i = 0; i < std::min<std::size_t>(bits.size(), kDepths[l]) && left > 0; ++i)
      bits[i] = (away - kLeaves.begins[scale][l]) >> --left & 1u;
    return bits;
  }

  // A decision whose log odds are the sum of two cells and an offset. Updates both cells.
  std::uint32_t decide(Coder& coder, WideInterval& interval, std::int16_t& a, std::int16_t& b, std::int32_t offset,
                       std::uint32_t bit, std::int32_t rate = kOffsetRate) {
    const std::int32_t sum = std::clamp(a + b + offset, -32768, 32767);
    const auto t =
        static_cast<std::uint32_t>(65534 - 2 * (sum < 0 ? -1 - sum : sum));  // as `probabilities` in bits/cells.hpp
    const std::uint32_t square = (t * t) >> 16;
    const auto rare = std::max(static_cast<std::int32_t>((square * t) >> 18), std::int32_t{kRarest});
    const std::int32_t p = sum < 0 ? rare : kOne - rare;
    if constexpr (kReads) {
      bit = coder.decode(interval, static_cast<std::uint32_t>(p));
    } else {
      coder.encode(interval, bit, static_cast<std::uint32_t>(p));
    }
    const std::int32_t by = (((bit != 0 ? kOne : 0) - p) * rate + 0x8000) >> 16;
    a = static_cast<std::int16_t>(std::clamp(a + by, -32768, 32767));
    b = static_cast<std::int16_t>(std::clamp(b + by, -32768, 32767));
    return bit;
  }

  // The lowest `bits` bits of a number, each with the probability 1/2.
  std::uint32_t plain(Coder& coder, WideInterval& interval, std::uint32_t bits, std::uint32_t number) {
    if (bits == 0) return 0;
    if (bits > 16) throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
    if constexpr (kReads) {
      return coder.decode_plain(interval, bits);
    } else {
      coder.encode_plain(interval, number, bits);
      return number;
    }
  }

  // Encodes or decodes, and returns, the distance of a return beyond the last leaf by its second tree. begin: the least
  // distance.
  [[gnu::noinline]] std::uint32_t beyond_leaf(Coder& coder, WideInterval& interval, const BeyondTree& at,
                                              std::uint32_t begin, std::uint32_t away) {
    BeyondCells& cells = model_.beyond;
    std::uint32_t leaf = 0, in = 0;
    if constexpr (!kReads) {
      const std::int32_t d = static_cast<std::int32_t>(away) - at.anchor;
      in = static_cast<std::uint32_t>(d < 0 ? -1 - d : d);
      leaf = d < 0 ? 7 - kLeaves.of(at.scale, in) : 8 + kLeaves.of(at.scale, in);
    }
    leaf = walk_beyond(coder, interval, at, leaf);
    const bool back = leaf < 8;
    const std::uint32_t l = back ? 7 - leaf : leaf - 8;
    std::uint32_t from = kLeaves.begins[at.scale][l], left = kLeaves.bits[at.scale][l];
    for (std::uint32_t octave = 0; l == 7; ++octave, ++left) {
      if (octave > kMaxOctaves || is_too_far(from))
        throw Error(ErrorCode::Section, "a range beyond what the sensor can give");
      const std::uint32_t end = from + (1u << left);
      if (decide(coder, interval, cells.more[2 * octave + back], cells.of_scale[at.scale], kOctaveLogOdds, in >= end) ==
          0)
        break;
      from = end;
    }
    for (std::uint32_t depth = 0; left > 0 && depth < BeyondCells::kDepth; ++depth) {
      --left;
      const std::uint32_t middle = from + (1u << left);
      std::int16_t none = 0;
      std::int16_t& cell = cells.offset[(depth * kScaleClasses + at.scale) * 16 + leaf];
      if (decide(coder, interval, cell, none, 0, in >= middle) != 0) from = middle;
    }
    from += plain(coder, interval, left, in - from);
    if constexpr (!kReads) return away;
    const auto d = static_cast<std::int32_t>(from);
    const std::int32_t found = at.anchor + (back ? -1 - d : d);
    if (found < static_cast<std::int32_t>(begin)) throw Error(ErrorCode::Section, "a range coded twice");
    return static_cast<std::uint32_t>(found);
  }

  // Encodes or decodes the leaf of the second tree, and updates its cells. Returns the leaf.
  std::uint32_t walk_beyond(Coder& coder, WideInterval& interval, const BeyondTree& at, std::uint32_t leaf) {
    std::array<Cells, 2> p;
    alignas(16) std::array<std::int16_t, kSlotCells> chance;
    std::int16_t* const all = model_.beyond.slots.data()->cells.data();
    for (std::size_t v = 0; v < 2; ++v) {
      Cells sum = Cells::load(all + at.slots[0] * kSlotCells + 8 * v);
      for (std::size_t i = 1; i < kBeyondContexts; ++i) sum = sum + Cells::load(all + at.slots[i] * kSlotCells + 8 * v);
      p[v] = probabilities(sum);
      p[v].store(chance.data() + 8 * v);
    }
    std::uint32_t node = 1;
    for (int level = 3; level >= 0; --level) {
      const auto probability = static_cast<std::uint32_t>(chance[node]);
      std::uint32_t bit;
      if constexpr (kReads) {
        bit = coder.decode(interval, probability);
      } else {
        bit = leaf >> level & 1u;
        coder.encode(interval, bit, probability);
      }
      node = 2 * node + bit;
    }
    const Walk& walked = kWalks[node];
    for (const std::uint32_t slot : at.slots) {
      std::int16_t* const of = all + slot * kSlotCells;
      const std::size_t rate = rate_of_slot(of);
      for (std::size_t v = 0; v < 2; ++v) {
        const Cells wanted = Cells::load(walked.wanted.data() + 8 * v),
                    taken = Cells::load(walked.taken.data() + 8 * v);
        (Cells::load(of + 8 * v) + moves(wanted, taken, p[v], kBeyondRates[rate])).store(of + 8 * v);
      }
      of[0] = static_cast<std::int16_t>(of[0] + kCountSteps[rate]);
    }
    return node - 16;
  }

  PredictiveModel& model_;
  std::int32_t limit_;
};

}  // namespace lidarcodec
