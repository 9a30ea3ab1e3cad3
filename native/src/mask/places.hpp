// The masks of the last eight turns, by direction and by place.
//
// A *history byte* for each of 4096 directions of a row holds one bit a turn, the last turn lowest; 1: a return. Some
// holes belong to the beam: they are in the same row and direction as a turn ago. Others belong to a place in the
// scene, which the sensor has moved past. So there are two tables. That of places is read where the place was a turn
// ago. For small motions its direction shifts by the rotation, and by the translation times the inverse range
// (Longuet-Higgins and Prazdny, "The interpretation of a moving retinal image", 1980).
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"
#include "mask/lookup.hpp"
#include "mask/rows.hpp"
#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

// What encoder and decoder know of a frame before its mask.
struct MaskView {
  MaskGeometry geometry;
  const std::uint16_t* azimuth = nullptr;          // (2, W), 0 to 35999
  std::array<std::int32_t, kMaskRows> vertical{};  // of each row: elevation, steps of 1e-8 rad
  const std::uint16_t* expected = nullptr;         // (64, W), expected ranges, 0 for none; nullptr without
  Motion motion;                                   // the motion that the expected ranges are from
};

// The two tables. At first all cells were returns.
class MaskTables {
 public:
  MaskTables();
  void forget();

 private:
  friend class MaskFrame;
  static constexpr std::size_t kBlock = 16, kBlocks = kDirections / kBlock;  // directions with one motion

  std::vector<std::uint8_t> beams_, places_;  // [row][direction]
  std::vector<std::uint8_t> next_;            // places_ after the current frame
  std::vector<std::uint8_t> outside_row_ =
      std::vector<std::uint8_t>(kDirections, 255);  // stands for rows outside of the image
  std::array<CosSin, kBlocks> block_directions_;    // direction of the middle of each block
};

// One frame and the tables: for each row from the top, its histories are read, and updated after it was coded.
class MaskFrame {
 public:
  // Raises Section if an azimuth is out of range.
  MaskFrame(const MaskView& view, MaskTables& tables);

  const MaskLayout& layout() const { return layout_; }

  // Begins a row. expected: the expected range of each of its cells.
  void begin_row(std::size_t row, const std::uint16_t* expected);

  // History bytes of the directions of the cells, with margins: in the three rows above, with this frame, in this row,
  // and in the row below. Forms: PlainMaskForms or Avx2MaskForms.
  template <class Forms>
  void beams(const std::array<PaddedRow*, 5>& rows) const {
    std::array<const std::uint8_t*, 5> from;
    for (std::size_t j = 0; j < 5; ++j) from[j] = row_of(tables_.beams_, static_cast<std::ptrdiff_t>(row_ + j) - 3);
    look_up<Forms>(from, rows);
  }
  // History bytes of the places above the cells, of the cells, and below them, with margins.
  template <class Forms>
  void places(const std::array<PaddedRow*, 3>& rows) const {
    look_up<Forms, 3>({moved_places_[0].data(), moved_places_[1].data(), moved_places_[2].data()}, rows);
    for (PaddedRow* row : rows) row->pad(n_);
  }

  // Adds the row to the histories. beams, places: its history bytes; fresh: there is no history, so all eight turns
  // become this one.
  template <class Forms>
  void put(const std::uint8_t* cells, const PaddedRow& beams, const PaddedRow& places, bool fresh) {
    put_in<Forms>(cells, beams.cells(), fresh, tables_.beams_);
    put_in<Forms>(cells, places.cells(), fresh, tables_.next_);
  }

  // Ends the frame: the places of this turn replace those of the last one.
  void end() { tables_.places_.swap(tables_.next_); }

 private:
  static constexpr std::size_t kBlock = MaskTables::kBlock, kBlocks = MaskTables::kBlocks;
  static constexpr std::ptrdiff_t kMargin = PaddedRow::kMargin;

  struct EarlierPlace {
    std::int32_t row = 0, directions = 0;
  };
  EarlierPlace earlier_place(std::size_t block, std::uint32_t range) const;
  void copy_places(std::size_t block);
  const std::uint8_t* row_of(const std::vector<std::uint8_t>& table, std::ptrdiff_t row) const {
    const bool inside = row >= 0 && row < static_cast<std::ptrdiff_t>(kMaskRows);
    return inside ? table.data() + static_cast<std::size_t>(row) * kDirections : tables_.outside_row_.data();
  }
  template <class Forms, std::size_t count>
  void look_up(const std::array<const std::uint8_t*, count>& from, const std::array<PaddedRow*, count>& rows) const {
    std::array<std::uint8_t*, count> to;
    for (std::size_t j = 0; j < count; ++j) to[j] = rows[j]->cells() - kMargin;
    Forms::look_up(from, at_, cell_groups_[layout_.half(row_)], to);
  }

  template <class Forms>
  void put_in(const std::uint8_t* cells, const std::uint8_t* were, bool fresh, std::vector<std::uint8_t>& table) {
    std::uint8_t* const to = values_.data();
    for (std::size_t k = 0; k < n_; ++k)
      to[k] = static_cast<std::uint8_t>(fresh ? 0u - cells[k] : were[k] * 2u + cells[k]);
    Forms::put(to, direction_groups_[layout_.half(row_)], kDirections - direction_offset_,
               table.data() + row_ * kDirections);
  }

  const MaskView& view_;
  MaskLayout layout_;
  MaskTables& tables_;
  std::array<std::vector<std::uint16_t>, 2> slots_;  // directions of each half's cells, with margins
  std::array<CellGroups, 2> cell_groups_;            // likewise
  std::array<DirectionGroups, 2> direction_groups_;  // the cell of each direction
  struct BlockMotion {
    std::int64_t across = 0, along = 0, tilt = 0;  // translation, 1/16 mm, and tilt, 2^-30 rad, in the axes of a block
  };
  std::array<BlockMotion, kBlocks> block_motion_;

  std::size_t row_ = 0, n_ = 0;
  std::int64_t sine_ = 0;             // of the row's elevation, 2^-30
  std::size_t direction_offset_ = 0;  // rotation correction of the row, in directions
  std::vector<std::uint8_t> values_;  // history bytes of its cells after the row
  std::vector<std::uint16_t> at_;     // direction of each cell, with margins
  std::array<EarlierPlace, kBlocks> earlier_places_{};
  // History bytes of the directions of the row: of the places above, of their own places, and below, where they were a
  // turn ago.
  std::array<std::array<std::uint8_t, kDirections>, 3> moved_places_{};
};

}  // namespace lidarcodec
