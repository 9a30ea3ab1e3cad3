// Values of up to 8 bits by themselves: the way to one of 256 leaves. For planes whose values repeat, or have gaps.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "images/decisions.hpp"

namespace lidarcodec {

// N: of the contexts, the first ones, that are looked at.
template <std::size_t N>
class SymbolCoder {
 public:
  static constexpr std::array<std::uint32_t, 10> kSizes = {256, 512, 512, 2048, 1024, 256, 512, 1024, 512, 4096};
  using Contexts = std::array<std::uint32_t, N>;  // below kSizes

  template <class Stream>
  std::uint32_t code(Stream& stream, std::uint32_t value, const Contexts& contexts, std::int16_t rate) {
    std::array<Cells*, N> cells;
    for (std::size_t i = 0; i < N; ++i) cells[i] = record(kBegin[i] + contexts[i]);
    const std::uint32_t high = stream.template by_cells<4>(value >> 4, cells, rate);
    for (Cells*& of : cells) of += 2 + 2 * high;
    return 16 * high + stream.template by_cells<4>(value & 15u, cells, rate);
  }

 private:
  static constexpr std::size_t kRecord =
      34;  // Cells of a context: for the upper four levels, then for each of their ends
  static constexpr std::size_t kBlock = 32;  // records that are made at once
  static constexpr auto kBegin = [] {        // of the records of each context; behind them how many there are
    std::array<std::uint32_t, N + 1> begin{};
    for (std::size_t i = 0; i < N; ++i) begin[i + 1] = begin[i] + kSizes[i];
    return begin;
  }();

  // The cells of a context. Most contexts never come in a small frame, and their cells are not made.
  Cells* record(std::uint32_t context) {
    Cells* const found = of_[context];
    return found != nullptr ? found : make(context);
  }
  [[gnu::noinline]] Cells* make(std::uint32_t context) {
    if (made_ % kBlock == 0) blocks_.push_back(std::make_unique<Cells[]>(kBlock * kRecord));
    Cells* const cells = &blocks_.back()[made_++ % kBlock * kRecord];
    if (context < kSizes[0]) expect(cells, 4 * (context / 4) + 2);
    return of_[context] = cells;
  }

  // Log odds that decrease on both sides of `centre`, by a factor of e in 32 leaves.
  static void expect(Cells* cells, std::uint32_t centre) {
    std::array<Odds, 8 * kRecord> odds{};
    for (std::uint32_t level = 0; level < 8; ++level) {
      const std::int32_t half = 1 << (8 - level);  // of the leaves below, in half leaves
      for (std::uint32_t way = 0; way < 1u << level; ++way) {
        const auto middle = static_cast<std::int32_t>(2 * way + 1) * half;
        const std::uint32_t node =
            level < 4 ? (1u << level) + way
                      : 16 + 16 * (way >> (level - 4)) + (1u << (level - 4)) + (way & ((1u << (level - 4)) - 1));
        const std::int32_t off = std::clamp(static_cast<std::int32_t>(2 * centre) - middle, -half, half);
        odds[node] = static_cast<Odds>(off * 21845 / 256);
      }
    }
    std::memcpy(static_cast<void*>(cells), odds.data(), sizeof odds);
  }

  std::size_t made_ = 0;
  std::array<Cells*, kBegin[N]> of_{};  // of each context, in blocks; null: its cells were not made yet
  std::vector<std::unique_ptr<Cells[]>> blocks_;
};

}  // namespace lidarcodec
