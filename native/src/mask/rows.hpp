// The rows of a mask: closed up to the columns that fired, and aligned with each other.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "base/error.hpp"
#include "mask/coder.hpp"

namespace lidarcodec {

inline constexpr std::int64_t kTurn = 628318531;  // full turn, steps of 1e-8 rad

constexpr std::int64_t floor_div(std::int64_t a, std::int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }

// A row of n cells that may be read from -kMargin to n + kMargin - 1.
template <class Cell>
class PaddedRowOf {
 public:
  static constexpr std::ptrdiff_t kMargin = 8;
  explicit PaddedRowOf(std::size_t width) : cells_(width + 2 * kMargin) {}
  Cell* cells() { return cells_.data() + kMargin; }
  const Cell* cells() const { return cells_.data() + kMargin; }

  // Fills the margins with the first and the last of n cells.
  void pad(std::size_t n) {
    if (n == 0) return;
    std::fill(cells_.data(), cells(), *cells());
    std::fill_n(cells() + n, kMargin, cells()[n - 1]);
  }

 private:
  std::vector<Cell> cells_;
};
using PaddedRow = PaddedRowOf<std::uint8_t>;

// The fired columns of each half, and the map from the cells of one half to those of the other.
class MaskLayout {
 public:
  explicit MaskLayout(const MaskGeometry& geometry) : geometry_(geometry) {
    for (std::size_t half = 0; half < 2; ++half) {
      const std::uint8_t* fired = geometry.fired + half * geometry.width;
      const std::uint8_t* other = geometry.fired + (1 - half) * geometry.width;
      std::uint32_t others = 0;
      for (std::uint32_t column = 0; column < geometry.width; ++column) {
        if (fired[column]) {
          columns_[half].push_back(column);
          across_[half].push_back(others);
        }
        others += other[column] != 0;
      }
    }
  }

  std::size_t half(std::size_t row) const { return geometry_.half[row]; }
  std::size_t cells(std::size_t row) const { return columns_[half(row)].size(); }
  const std::vector<std::uint32_t>& columns(std::size_t row) const { return columns_[half(row)]; }

  // Whether cell k of a row is column k.
  bool whole(std::size_t row) const { return cells(row) == geometry_.width; }

  // (64, W), 0 where nothing fired, of rows that are closed up as in ClosedRows.
  std::vector<std::uint8_t> opened(const std::vector<std::uint8_t>& closed) const {
    std::vector<std::uint8_t> mask(closed.size());
    for (std::size_t row = 0; row < kMaskRows; ++row) {
      const std::uint8_t* from = closed.data() + row * geometry_.width;
      std::uint8_t* to = mask.data() + row * geometry_.width;
      if (whole(row)) {
        std::copy_n(from, geometry_.width, to);
      } else {
        for (const std::uint32_t column : columns(row)) to[column] = *from++;
      }
    }
    return mask;
  }

  // The shift, in cells, of row `above` to the right of the same directions in `row`; turn: columns in a full turn.
  std::int64_t shift(std::size_t above, std::size_t row, std::uint32_t turn) const {
    if (geometry_.width == 0) return 0;
    const auto width = static_cast<std::int64_t>(geometry_.width);
    const std::int64_t cells_in_turn =
        (static_cast<std::int64_t>(turn) * static_cast<std::int64_t>(cells(above)) + width / 2) / width;
    std::int64_t apart = (geometry_.rotation[above] - geometry_.rotation[row]) % kTurn;
    if (apart < -kTurn / 2) apart += kTurn;
    if (apart > kTurn / 2) apart -= kTurn;
    return floor_div(2 * apart * cells_in_turn + kTurn, 2 * kTurn);
  }

  // Fills `out` and its margins with row `above`, aligned with `row`. Beyond its ends a row repeats its last cell. A
  // row without cells gives `none` everywhere.
  template <class Cell>
  void align(const Cell* above_cells, std::size_t above, std::size_t row, std::int64_t shift, PaddedRowOf<Cell>& out,
             Cell none = 1) const {
    const auto n = static_cast<std::ptrdiff_t>(cells(row));
    const auto have = static_cast<std::ptrdiff_t>(cells(above));
    Cell* to = out.cells();
    constexpr std::ptrdiff_t margin = PaddedRowOf<Cell>::kMargin;
    if (have == 0) {
      std::fill(to - margin, to + n + margin, none);
    } else if (half(above) == half(row)) {
      copy_clamped(above_cells, have, shift - margin, to - margin, n + 2 * margin);
    } else {
      const std::vector<std::uint32_t>& across = across_[half(row)];
      for (std::ptrdiff_t k = 0; k < n; ++k) {
        const auto at = static_cast<std::ptrdiff_t>(across[static_cast<std::size_t>(k)]) + shift;
        to[k] = above_cells[std::clamp<std::ptrdiff_t>(at, 0, have - 1)];
      }
      out.pad(static_cast<std::size_t>(n));
    }
  }

  // Fills `out` and its margins with a row of an earlier mask, whose columns lie `shift` to the right of those of the
  // same direction here.
  void align_earlier(const EarlierMask& earlier, std::size_t row, std::int64_t shift, PaddedRow& out) const {
    const std::uint8_t* from = earlier.cells + row * earlier.width;
    const auto n = static_cast<std::ptrdiff_t>(cells(row));
    const auto have = static_cast<std::ptrdiff_t>(earlier.width);
    if (whole(row)) {
      copy_clamped(from, have, shift, out.cells(), n);
    } else {
      const std::vector<std::uint32_t>& at = columns(row);
      for (std::ptrdiff_t k = 0; k < n; ++k) {
        out.cells()[k] = from[std::clamp<std::ptrdiff_t>(
            static_cast<std::ptrdiff_t>(at[static_cast<std::size_t>(k)]) + shift, 0, have - 1)];
      }
    }
    out.pad(static_cast<std::size_t>(n));
  }

 private:
  // to[i] = from[clamp(i + first)] for i < n.
  template <class Cell>
  static void copy_clamped(const Cell* from, std::ptrdiff_t have, std::ptrdiff_t first, Cell* to, std::ptrdiff_t n) {
    const std::ptrdiff_t before = std::clamp<std::ptrdiff_t>(-first, 0, n);
    const std::ptrdiff_t middle = std::clamp<std::ptrdiff_t>(have - first, before, n);
    std::fill(to, to + before, from[0]);
    if (middle > before) std::copy(from + first + before, from + first + middle, to + before);
    std::fill(to + middle, to + n, from[have - 1]);
  }

  const MaskGeometry& geometry_;
  std::array<std::vector<std::uint32_t>, 2> columns_, across_;
};

// A mask with its rows closed up, row after row at distance W, of 0 and 1.
struct ClosedRows {
  std::vector<std::uint8_t> cells;
  std::size_t returns = 0, fired = 0;

  // `mask`: (64, width). Raises Section if a cell is set in a block that did not fire.
  ClosedRows(const std::uint8_t* mask, const MaskLayout& layout, std::size_t width) : cells(kMaskRows * width) {
    std::size_t closed = 0;
    for (std::size_t row = 0; row < kMaskRows; ++row) {
      const std::uint8_t* from = mask + row * width;
      std::uint8_t* to = cells.data() + row * width;
      std::size_t in_row = 0;
      for (std::size_t column = 0; column < width; ++column) in_row += from[column] != 0;
      returns += in_row;
      if (layout.whole(row)) {
        for (std::size_t column = 0; column < width; ++column) to[column] = from[column] != 0;
        closed += in_row;
      } else {
        for (const std::uint32_t column : layout.columns(row)) {
          *to = from[column] != 0;
          closed += *to++;
        }
      }
      fired += layout.cells(row);
    }
    if (closed != returns) throw Error(ErrorCode::Section, "a mask is set in a block that did not fire");
  }
};

}  // namespace lidarcodec
