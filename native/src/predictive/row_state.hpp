// A row of ranges to be coded, with what lies around it, and what is known of it from the returns before.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "bits/wide_coder.hpp"

namespace lidarcodec {

// What a row is coded with: the rows around as seen from it, all with margins.
struct RowSurroundings {
  const std::uint16_t* returns;              // around each cell: Known::returns
  const std::int32_t* above;                 // ranges, here and below in sixteenths of a cell; nullptr for the first row
  const std::int32_t* upper;                 // the row above that; nullptr for the first two
  const std::uint32_t* sizes;                // differences in the row above
  const std::uint32_t* sizes_around;         // 3, 1, 2 and 2 times that of a cell, to its left, and of two to its right
  // Where something is expected: ranges, filled from the left where nothing is.
  const std::int32_t *expected = nullptr, *expected_above = nullptr;
  // For networks: what is expected in the row below, too; returns, 0 and 1, of this row and those around; and whether
  // something is expected.
  const std::int32_t* expected_below = nullptr;
  const std::uint8_t *mask = nullptr, *above_mask = nullptr, *below_mask = nullptr, *known = nullptr;
  std::uint32_t row = 0;
  const std::uint32_t* columns = nullptr;  // of the cells
  const std::uint8_t* firings = nullptr;   // of columns
  std::uint32_t first_firing = 0;          // slot of the row's first one
};

// What is known from the returns of a row, or of a part of one, that were coded before, but for the last ranges.
struct RowState {
  bool begun = false;                            // whether there was a return
  std::uint32_t size1 = 0, size2 = 0, mean = 0;  // the last difference, the weighted one before, a long mean
  std::int32_t level = 0;                        // of this row above the one above, sixteenths
  std::int32_t bias = 0;                         // of what comes above what is expected, sixteenths
  std::uint32_t miss = 0;                        // mean difference from what is expected
  std::uint32_t leaves = 0x88;                   // of the last two returns
  std::uint32_t last_cell = 0;                   // of the last return

  static RowState at_start(std::uint32_t start) {
    RowState state;
    state.size1 = state.size2 = state.mean = state.miss = start;
    return state;
  }
};

inline constexpr std::size_t kLastRanges = 8;

// The same where a row of a slab ends, with its last ranges, the latest first.
struct RowEnd : RowState {
  std::array<std::int32_t, kLastRanges> last{};
};

// Parts of an image whose returns are coded at the same time, each with a coder of its own: quarters of rows, or rows of
// the halves of a slab.
inline constexpr std::size_t kMostParts = 4, kSlabParts = 2;

// One of the sequences of returns that are coded at the same time: its coder, and what is known where it stands.
template <class Coder>
struct PredictivePart : RowState {
  Coder coder;
  WideInterval interval{};
  std::size_t next = 0, stop = 0;      // return of the row, and the one behind the last
  const std::int32_t* last = nullptr;  // ranges, the latest first; kLastRanges of them mean something

  explicit PredictivePart(Coder with = Coder()) : coder(std::move(with)) {}

  // base: where the first difference is counted from; returns: how many there will be.
  void begin(std::size_t first, std::size_t returns, std::int32_t base, const RowState& state) {
    next = first;
    stop = first + returns;
    RowState::operator=(state);
    if (ranges_.size() < returns + kLastRanges) ranges_.resize(returns + kLastRanges);
    at_ = ranges_.data() + ranges_.size() - kLastRanges;
    std::fill_n(at_, kLastRanges, base);
    last = at_;
  }

  // Goes on where the row ended.
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
  // Filled from the end. Moved on instead of over: four that were just written one by one would be slow to read at once.
  std::vector<std::int32_t> ranges_;
  std::int32_t* at_ = nullptr;
};

template <class Coder>
using PredictiveParts = std::array<PredictivePart<Coder>, kMostParts>;

// Returns of a row to be coded, and where their ranges and what each differs by are, or are put.
struct RowWork {
  RowSurroundings about;
  const std::uint32_t* cells;  // of the returns
  std::size_t count;           // of them
  std::int32_t* ranges;
  std::uint32_t* sizes;
};

}  // namespace lidarcodec
