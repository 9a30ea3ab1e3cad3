// Where returns were in the last eight turns: of each direction of each beam, and of each place in front of it.
//
// A byte for each of 4096 directions of a row holds a bit a turn, that of the last one lowest; 1: a return. Returns that
// are missing belong partly to the beam (the same row and direction as a turn ago) and partly to what stands there, past
// which the sensor has moved: so there are two tables, and that of places is looked up where the place was a turn ago.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "motion/beams.hpp"
#include "mask/coder.hpp"
#include "mask/lookup.hpp"
#include "mask/rows.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

// What both ends know of a frame before its mask.
struct MaskView {
  MaskGeometry geometry;
  const std::uint16_t* azimuth = nullptr;          // (2, W), 0 to 35999
  std::array<std::int32_t, kMaskRows> vertical{};  // of each row: elevation, steps of 1e-8 rad
  const std::uint16_t* expected = nullptr;         // (64, W), ranges, 0: nothing; nullptr: nothing anywhere
  Motion motion;                                   // with which they were expected
};

// The tables; all returns to begin with.
class MaskPlaces {
 public:
  MaskPlaces();
  void forget();

 private:
  friend class MaskFrame;
  static constexpr std::size_t kBlock = 16, kBlocks = kPlaces / kBlock;  // directions that move as one

  std::vector<std::uint8_t> beams_, places_;  // [row][direction]
  std::vector<std::uint8_t> next_;            // places as they become in the frame at hand
  std::vector<std::uint8_t> everywhere_ = std::vector<std::uint8_t>(kPlaces, 255);  // a row beyond the image
  std::array<CosSin, kBlocks> towards_;       // of the middle of each block
};

// One frame in front of the tables: its rows are begun from the top, each looked up and then put down.
class MaskFrame {
 public:
  // Raises Section if an azimuth is out of range.
  MaskFrame(const MaskView& view, MaskPlaces& tables);

  const MaskLayout& layout() const { return layout_; }

  // Begins a row. expected: of each of its cells.
  void begin_row(std::size_t row, const std::uint16_t* expected);

  // Bytes of the directions of the cells, margins too, in the three rows above, of this frame already, in this row, and in
  // the one below. Forms: how cells are looked up.
  template <class Forms>
  void beams(const std::array<PaddedRow*, 5>& rows) const {
    std::array<const std::uint8_t*, 5> from;
    for (std::size_t j = 0; j < 5; ++j)
      from[j] = row_of(tables_.beams_, static_cast<std::ptrdiff_t>(row_ + j) - 3);
    look_up<Forms>(from, rows);
  }
  // Bytes of the places of the cells, and of those above and below, margins too.
  template <class Forms>
  void places(const std::array<PaddedRow*, 3>& rows) const {
    look_up<Forms, 3>({moved_places_[0].data(), moved_places_[1].data(), moved_places_[2].data()}, rows);
    for (PaddedRow* row : rows) row->pad(n_);
  }

  // Takes the row. beams, places: what was looked up for it; fresh: nothing was known.
  template <class Forms>
  void put(const std::uint8_t* cells, const PaddedRow& beams, const PaddedRow& places, bool fresh) {
    put_in<Forms>(cells, beams.cells(), fresh, tables_.beams_);
    put_in<Forms>(cells, places.cells(), fresh, tables_.next_);
  }

  // Takes the frame: until then places stay those of a turn ago.
  void end() { tables_.places_.swap(tables_.next_); }

 private:
  static constexpr std::size_t kBlock = MaskPlaces::kBlock, kBlocks = MaskPlaces::kBlocks;
  static constexpr std::ptrdiff_t kMargin = PaddedRow::kMargin;

  struct Moved {
    std::int32_t row = 0, directions = 0;
  };
  Moved moved(std::size_t block, std::uint32_t range) const;
  void take_places(std::size_t block);
  const std::uint8_t* row_of(const std::vector<std::uint8_t>& table, std::ptrdiff_t row) const {
    const bool inside = row >= 0 && row < static_cast<std::ptrdiff_t>(kMaskRows);
    return inside ? table.data() + static_cast<std::size_t>(row) * kPlaces : tables_.everywhere_.data();
  }
  template <class Forms, std::size_t count>
  void look_up(const std::array<const std::uint8_t*, count>& from, const std::array<PaddedRow*, count>& rows) const {
    std::array<std::uint8_t*, count> to;
    for (std::size_t j = 0; j < count; ++j) to[j] = rows[j]->cells() - kMargin;
    Forms::look_up(from, at_, picks_[layout_.half(row_)], to);
  }

  template <class Forms>
  void put_in(const std::uint8_t* cells, const std::uint8_t* were, bool fresh, std::vector<std::uint8_t>& table) {
    std::uint8_t* const to = values_.data();
    for (std::size_t k = 0; k < n_; ++k)
      to[k] = static_cast<std::uint8_t>(fresh ? 0u - cells[k] : were[k] * 2u + cells[k]);
    Forms::put(to, owned_[layout_.half(row_)], kPlaces - aside_, table.data() + row_ * kPlaces);
  }

  const MaskView& view_;
  MaskLayout layout_;
  MaskPlaces& tables_;
  std::array<std::vector<std::uint16_t>, 2> slots_;  // of each half's cells, margins too
  std::array<CellPicks, 2> picks_;                   // likewise
  std::array<DirectionPicks, 2> owned_;              // the cell whose each direction is
  struct Sway {
    std::int64_t across = 0, along = 0, tilt = 0;    // translation, 1/16 mm, and tilt, 2^-30 rad, as seen from a block
  };
  std::array<Sway, kBlocks> sway_;

  std::size_t row_ = 0, n_ = 0;
  std::int64_t sine_ = 0;                            // of the row's elevation, 2^-30
  std::size_t aside_ = 0;                            // by which its directions lie before those of its half
  std::vector<std::uint8_t> values_;                 // of its cells, as they become
  std::vector<std::uint16_t> at_;                    // direction of each cell, margins too
  std::array<Moved, kBlocks> moved_{};
  // Of the directions of the row: places where they were a turn ago, and those above and below.
  std::array<std::array<std::uint8_t, kPlaces>, 3> moved_places_{};
};

}  // namespace lidarcodec
