// Decisions of planes: single ones, trees of them, and numbers far from what was expected.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "bits/bitmodel.hpp"
#include "bits/cells.hpp"
#include "bits/wide_coder.hpp"

namespace lidarcodec {

// Log odds of one decision in one context, as a lane of Cells.
using Odds = std::int16_t;

// A coder with its interval. `Coder` is WideEncoder or WideDecoder: what is written is returned, or what was read.
template <class Coder>
class PlaneStream {
 public:
  static constexpr bool kReads = std::is_same_v<Coder, WideDecoder>;

  explicit PlaneStream(Coder coder) : coder_(std::move(coder)) {
    if constexpr (kReads) at_ = coder_.start();
  }

  void make_room(std::size_t decisions) {
    if constexpr (!kReads) coder_.make_room(decisions);
  }
  decltype(auto) finish() { return coder_.finish(at_); }

  std::uint32_t bit(std::uint32_t value, std::uint32_t probability) {
    if constexpr (kReads) {
      return coder_.decode(at_, probability);
    } else {
      coder_.encode(at_, value, probability);
      return value;
    }
  }

  std::uint32_t by_model(std::uint32_t value, BitModel& model) {
    value = bit(value, model.probability() >> 1);
    model.update(value != 0);
    return value;
  }

  // Equally likely bits, up to 32.
  std::uint32_t plain(std::uint32_t value, std::uint32_t bits) {
    std::uint32_t result = 0;
    while (bits > 0) {
      const std::uint32_t now = std::min(bits, 16u);
      bits -= now;
      const std::uint32_t part = value >> bits & ((1u << now) - 1);
      if constexpr (kReads) {
        result = result << now | coder_.decode_plain(at_, now);
      } else {
        coder_.encode_plain(at_, part, now);
        result = result << now | part;
      }
    }
    return result;
  }

  // One decision of the sum of log odds.
  template <std::size_t N>
  std::uint32_t by_odds(std::uint32_t value, const std::array<Odds*, N>& contexts, int rate) {
    int sum = 0;
    for (const Odds* odds : contexts) sum += *odds;
    const int p = probability_of(std::clamp(sum, -32768, 32767));
    value = bit(value, static_cast<std::uint32_t>(p));
    const int by = (((value != 0 ? kOne : 0) - p) * rate + 0x8000) >> 16;
    for (Odds* odds : contexts) *odds = static_cast<Odds>(std::clamp(*odds + by, -32768, 32767));
    return value;
  }

  // The way to a leaf of a tree of Levels, up to four: 0 to 2^Levels - 1. contexts: each has 8 or 16 cells, by node.
  template <int Levels, std::size_t N>
  std::uint32_t by_cells(std::uint32_t leaf, const std::array<Cells*, N>& contexts, std::int16_t rate) {
    constexpr std::size_t vectors = Levels == 4 ? 2 : 1;
    std::array<Cells, vectors> p;
    alignas(16) std::array<std::int16_t, 8 * vectors> chance;
    for (std::size_t v = 0; v < vectors; ++v) {
      Cells sum = contexts[0][v];
      for (std::size_t i = 1; i < N; ++i) sum = sum + contexts[i][v];
      p[v] = probabilities(sum);
      p[v].store(chance.data() + 8 * v);
    }
    const std::uint32_t node = way<Levels>(leaf, chance.data());
    const Walk& walk = kWalks[node];
    for (std::size_t v = 0; v < vectors; ++v) {
      const Cells by =
          moves(Cells::load(walk.wanted.data() + 8 * v), Cells::load(walk.taken.data() + 8 * v), p[v], rate);
      for (Cells* cells : contexts) cells[v] = cells[v] + by;
    }
    return node - (1u << Levels);
  }

  // The same by a weighted sum of the log odds; the weights follow the gradient of the cost. weights: cells of each
  // context in turn, where 16384 is one.
  template <int Levels, std::size_t N>
  std::uint32_t by_weighted(std::uint32_t leaf, const std::array<Cells*, N>& contexts, Cells* weights,
                            std::int16_t rate) {
    constexpr std::size_t vectors = Levels == 4 ? 2 : 1;
    std::array<Cells, vectors> p;
    alignas(16) std::array<std::int16_t, 8 * vectors> chance;
    for (std::size_t v = 0; v < vectors; ++v) {
      Cells sum = product(contexts[0][v], weights[v]);
      for (std::size_t i = 1; i < N; ++i) sum = sum + product(contexts[i][v], weights[vectors * i + v]);
      sum = sum + sum;
      sum = sum + sum;
      p[v] = probabilities(sum);
      p[v].store(chance.data() + 8 * v);
    }
    const std::uint32_t node = way<Levels>(leaf, chance.data());
    const Walk& walk = kWalks[node];
    for (std::size_t v = 0; v < vectors; ++v) {
      const Cells wanted = Cells::load(walk.wanted.data() + 8 * v), taken = Cells::load(walk.taken.data() + 8 * v);
      const Cells error = errors(wanted, taken, p[v]);
      const Cells by = by_rate(error, rate);
      for (std::size_t i = 0; i < N; ++i) {
        Cells &weight = weights[vectors * i + v], &cell = contexts[i][v];
        weight = weight + by_rate(product(error, cell), kWeightRate);
        cell = cell + by;
      }
    }
    return node - (1u << Levels);
  }

 private:
  static constexpr std::int16_t kWeightRate = 2000;

  // The end of the way to a leaf, by the probability of each node. Nobody else sees the interval meanwhile, so that it
  // stays in registers: each decision waits for the one before it. A reader looks up both next probabilities before.
  template <int Levels>
  std::uint32_t way(std::uint32_t leaf, const std::int16_t* chance) {
    WideInterval at = at_;
    std::uint32_t node = 1;
    if constexpr (kReads) {
      auto p = static_cast<std::uint32_t>(chance[1]);
      for (int level = 1; level < Levels; ++level) {
        const auto even = static_cast<std::uint32_t>(chance[2 * node]);
        const auto odd = static_cast<std::uint32_t>(chance[2 * node + 1]);
        const std::uint32_t bit = coder_.decode(at, p);
        p = even ^ ((even ^ odd) & (0u - bit));
        node = 2 * node + bit;
      }
      node = 2 * node + coder_.decode(at, p);
    } else {
      for (int level = Levels - 1; level >= 0; --level) {
        const std::uint32_t bit = leaf >> level & 1u;
        coder_.encode(at, bit, static_cast<std::uint32_t>(chance[node]));
        node = 2 * node + bit;
      }
    }
    at_ = at;
    return node;
  }

  // As `probabilities` of cells.hpp, of one sum.
  static int probability_of(int sum) {
    const auto t = static_cast<std::uint32_t>(65534 - 2 * (sum < 0 ? -1 - sum : sum));
    const std::uint32_t square = (t * t) >> 16;
    const int rare = std::max(static_cast<int>((square * t) >> 18), int{kRarest});
    return sum < 0 ? rare : kOne - rare;
  }

  Coder coder_;
  WideInterval at_{};
};

// Whole numbers of any size: the bit length in unary, two bits after the first one by models, the others plain.
class FarNumbers {
 public:
  static constexpr std::uint32_t kLengths = 22;

  template <class Stream>
  std::uint32_t code(Stream& stream, std::uint32_t value) {
    const auto wanted = static_cast<std::uint32_t>(std::bit_width(value));
    std::uint32_t length = 0;
    while (length < kLengths && stream.by_model(wanted > length, longer_[length])) ++length;
    std::uint32_t result = length > 0, left = length > 0 ? length - 1 : 0;
    for (std::uint32_t node = 1; left > 0 && node < 4;) {
      --left;
      const std::uint32_t bit = stream.by_model(value >> left & 1u, high_[length][node]);
      node = 2 * node + bit;
      result = 2 * result + bit;
    }
    return left > 0 ? result << left | stream.plain(value & ((1u << left) - 1), left) : result;
  }

 private:
  std::array<BitModel, kLengths> longer_;
  std::array<std::array<BitModel, 4>, kLengths + 1> high_;
};

}  // namespace lidarcodec
