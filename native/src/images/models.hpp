// What a plane's coder learns: probabilities, mean errors and proportions. It may go on from frame to frame.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "images/first_cells.hpp"
#include "images/numbers.hpp"
#include "images/plane_rows.hpp"
#include "images/proportion.hpp"
#include "images/symbols.hpp"

namespace lidarcodec {

// How much is looked at. Quick: fewer contexts and one prediction, for twice the speed. Follows: the frame before, too.
enum class PlaneEffort : std::uint8_t { Best, Quick, Follows };

template <PlaneEffort Effort>
struct PlaneModels {
  static constexpr bool kQuick = Effort == PlaneEffort::Quick, kFollows = Effort == PlaneEffort::Follows;
  static constexpr std::size_t kSpreadWays = 16, kSpreads = 128 * kSpreadWays, kBiases = 64 * 16;
  static constexpr std::size_t kContexts = kQuick ? 3 : kFollows ? 11 : 7;
  static constexpr std::size_t kSymbolContexts = kQuick ? 6 : kFollows ? 10 : 8;
  static constexpr std::size_t kScales = 17;
  static constexpr std::int16_t kFirstWeight = 15000;
  static constexpr std::size_t kEqualContexts = kFollows ? 5 : 3, kHasContexts = kFollows ? 6 : 4;
  static constexpr auto kContextSizes = [] {
    if constexpr (kQuick)
      return std::array<std::uint32_t, 3>{17 * 4 * 8, 169, 256};
    else if constexpr (kFollows)
      return std::array<std::uint32_t, 11>{17 * 4 * 8, 169, 169, 169, 256, 128, 256, 14 * 14, 14 * 16, 14 * 14, 256};
    else
      return std::array<std::uint32_t, 7>{17 * 4 * 8, 169, 169, 169, 256, 128, 256};
  }();

  PlaneModels() : spread(kSpreads), bias(kBiases), equal_odds(kEqualContexts * 256), has_odds(kHasContexts * 512) {
    if constexpr (kFollows) {
      std::array<std::int16_t, 8> first{};
      first.fill(kFirstWeight);
      weights.resize(kScales * kContexts * 2, Cells::load(first.data()));
    }
    for (std::size_t i = 0; i < spread.size(); ++i) spread[i] = first_spread(i / kSpreadWays);
    std::uint32_t total = 0;
    for (std::size_t i = 0; i < kContexts; ++i) {
      begin[i] = 2 * total;
      total += kContextSizes[i];
    }
  }

  // Makes what a way of coding needs, unless it is there.
  void prepare(PlaneWay way) {
    if ((way == PlaneWay::Numbers || way == PlaneWay::Sparse) && cells.empty()) {
      std::uint32_t total = 0;
      for (const std::uint32_t size : kContextSizes) total += size;
      cells.resize(2 * std::size_t{total});
      for (std::size_t i = 0; i < kContextSizes[0]; ++i)
        std::memcpy(static_cast<void*>(&cells[2 * i]), kFirstOdds.data(), sizeof kFirstOdds);
      for (std::size_t i = 0; i < kBesideContexts; ++i) {
        std::array<Odds, kLeaves> first{};
        for (std::size_t node = 1; node < kLeaves; ++node)
          first[node] = static_cast<Odds>(kFirstBeside[15 * i + node - 1] * 256);
        std::memcpy(static_cast<void*>(&cells[begin[1] + 2 * i]), first.data(), sizeof first);
      }
    }
    if (way == PlaneWay::Symbols && symbols.empty()) symbols.emplace_back();
  }

  std::uint32_t rows = 0;             // coded so far
  std::vector<std::uint32_t> spread;  // mean error in sixteenths, by activity and slope
  std::vector<std::int32_t> bias;
  std::vector<Odds> equal_odds, has_odds;
  std::array<Odds, 8> run_odds{};
  std::array<std::uint32_t, kContexts> begin{};
  std::vector<Cells> cells;
  NumberCoder numbers;
  std::vector<Cells> weights;  // of the contexts of numbers, by the scale of the bins
  std::vector<SymbolCoder<kSymbolContexts>> symbols;
  Proportion proportion;

 private:
  static std::uint32_t first_spread(std::size_t activity) {
    const auto a = static_cast<std::uint32_t>(std::min<std::size_t>(activity, 79));
    return 8 + 4 * (a < 4 ? a + 1 : (4 + a % 4) << (a / 4 - 1));
  }
};

}  // namespace lidarcodec
