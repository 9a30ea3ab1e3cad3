// A row of ranges that is to be coded: its neighbouring rows, and the state from its returns so far.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "bits/wide_coder.hpp"

namespace lidarcodec {

// The neighbouring rows, aligned with this one and padded.
struct RowSurroundings {
  const std::uint16_t* returns;  // of each cell: Known::returns
  const std::int32_t* above;     // ranges, here and below in sixteenths of a cell; nullptr for the first row
  const std::int32_t* upper;     // the row above that; nullptr for the first two
  const std::uint32_t* sizes;    // differences in the row above
  const std::uint32_t*
      sizes_around;  // 3 times the difference of a cell, 1 of the left cell, 2 of each of two right cells
  // Expected ranges, filled from the left where none is known; nullptr without.
  const std::int32_t *expected = nullptr, *expected_above = nullptr;
  // For networks: expected ranges of the row below; masks, 0 and 1, of this row and its neighbours; mask of the
  // expected ranges.
  const std::int32_t* expected_below = nullptr;
  const std::uint8_t *mask = nullptr, *above_mask = nullptr, *below_mask = nullptr, *known = nullptr;
  std::uint32_t row = 0;
  const std::uint32_t* columns = nullptr;  // of the cells
  const std::uint8_t* firings = nullptr;   // of columns
  std::uint32_t first_firing = 0;          // slot of the row's first one
};

// The state of a row, or of a part of one, from its returns so far, without the last ranges. Differences are in
// sixteenths of a cell.
struct RowState {
  bool begun = false;  // there was a return
  std::uint32_t size1 = 0, size2 = 0,
                mean = 0;       // the last difference; smoothed: those before it with gain 1/2, all with gain 1/8
  std::int32_t level = 0;       // smoothed difference from the row above
  std::int32_t bias = 0;        // smoothed difference from the expected ranges
  std::uint32_t miss = 0;       // smoothed size of that difference after the bias is subtracted
  std::uint32_t leaves = 0x88;  // of the last two returns
  std::uint32_t last_cell = 0;  // of the last return

  static RowState at_start(std::uint32_t start) {
    RowState state;
    state.size1 = state.size2 = state.mean = state.miss = start;
    return state;
  }
};

inline constexpr std::size_t kLastRanges = 8;

// The state at the end of a slab's row, with its last ranges, the latest first.
struct RowEnd : RowState {
  std::array<std::int32_t, kLastRanges> last{};
};

// Interleaved parts of an image, each with its own coder: the quarters of a row, or a row of each half of a slab.
inline constexpr std::size_t kMostParts = 4, kSlabParts = 2;

// One interleaved part: its coder and its state.
template <class Coder>
struct PredictivePart : RowState {
  Coder coder;
  WideInterval interval{};
  std::size_t next = 0, stop = 0;      // index of the next return in the row, and the end
  const std::int32_t* last = nullptr;  // kLastRanges ranges, the latest first

  explicit PredictivePart(Coder with = Coder()) : coder(std::move(with)) {}

  // base: the base of the first difference; returns: their number.
  void begin(std::size_t first, std::size_t returns, std::int32_t base, const RowState& state) {
    next = first;
    stop = first + returns;
    RowState::operator=(state);
    if (ranges_.size() < returns + kLastRanges) ranges_.resize(returns + kLastRanges);
    at_ = ranges_.data() + ranges_.size() - kLastRanges;
    std::fill_n(at_, kLastRanges, base);
    last = at_;
  }

  // Continues the row of a slab.
  void resume(std::size_t returns, std::int32_t base, const RowEnd& end) {
    begin(0, returns, base, end);
    if (begun) std::copy(end.last.begin(), end.last.end(), at_);
  }

  RowEnd end() const {
    RowEnd end{*this};
    std::copy_n(last, kLastRanges, end.last.begin());
    return end;
  }

  void take(std::int32_t range) {
    if (begun) {
      *--at_ = range;
    } else {
      std::fill_n(at_, kLastRanges, range);
    }
    last = at_;
    begun = true;
  }

 private:
  // Filled from the end, so that no range is moved. A vector load of ranges that were just moved would wait for their
  // stores.
  std::vector<std::int32_t> ranges_;
  std::int32_t* at_ = nullptr;
};

template <class Coder>
using PredictiveParts = std::array<PredictivePart<Coder>, kMostParts>;

// The returns of a row that are to be coded, with their ranges and differences: read by an encoder, written by both.
struct RowTask {
  RowSurroundings about;
  const std::uint32_t* cells;  // of the returns
  std::size_t count;           // of them
  std::int32_t* ranges;
  std::uint32_t* sizes;
};

}  // namespace lidarcodec
