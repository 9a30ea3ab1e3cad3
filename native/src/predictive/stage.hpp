// Prepares each row of an image for the coder: aligns the neighbouring rows with it. Rows come from the top.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/error.hpp"
#include "mask/rows.hpp"
#include "predictive/coder.hpp"
#include "predictive/rows.hpp"

namespace lidarcodec {

// Rows of an image, from `first` up to, but not, `end`.
struct RowSpan {
  std::size_t first = 0, end = kMaskRows;
};

// An image: its mask, and W columns, of which the first `past` are known.
struct RowSource {
  const MaskLayout& layout;
  const ClosedRows& returned;
  const RangeCells& cells;
  const std::uint16_t* expected;  // (64, W), 0 where no range is expected; nullptr without
  std::size_t width, past;
  std::uint32_t turn;
  std::uint32_t firing;           // of column 0, modulo kFirings
  std::uint16_t* sent = nullptr;  // (64, W), receives the ranges as a decoder gets them; or nullptr
  RowSpan rows = {};              // of a whole frame: which of them are coded; a slab has all
};

// Ranges and differences of a row, in sixteenths of a cell, with values for cells that are no returns.
struct FilledRow {
  std::vector<std::int32_t> ranges;
  std::vector<std::uint32_t> sizes;
  explicit FilledRow(std::size_t width) : ranges(width + 1), sizes(width + 1) {}

  // Cells that are no returns take the values of the return to their left, those at the start of the first return.
  void fill(const std::vector<std::uint32_t>& returns, std::size_t count, std::size_t n) {
    std::size_t at = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t end = i + 1 < count ? returns[i + 1] : n;
      const std::int32_t range = ranges[returns[i]];
      const std::uint32_t size = sizes[returns[i]];
      for (; at < end; ++at) {
        ranges[at] = range;
        sizes[at] = size;
      }
    }
  }
};

// Known::returns of each of the n cells of a row, from the masks of this row (m), of the row above (a), of the row
// below (b), and of the expected ranges (e).
template <bool kExpects>
void describe_returns(const std::uint8_t* m, const std::uint8_t* a, const std::uint8_t* b, const std::uint8_t* e,
                      std::size_t n, std::uint16_t* around) {
  for (std::size_t k = 0; k < n; ++k, ++m, ++a, ++b) {
    std::uint32_t is =
        m[-1] | m[-2] << 1 | m[1] << 2 | m[2] << 3 | b[0] << 4 | b[-1] << 5 | b[1] << 6 | a[0] << 7 | a[1] << 8;
    if constexpr (kExpects) {
      is |= e[-1] << 9 | e[1] << 10 | e[0] << 11;
      ++e;
    }
    around[k] = static_cast<std::uint16_t>(is | m[1] << 12 | b[0] << 13 | a[0] << 14 | m[-1] << 15);
  }
}

// The expected ranges of a row, closed up, in sixteenths of a cell. Gaps are filled from the left, those at the start
// from the right.
struct ExpectedRow {
  std::vector<std::int32_t> ranges;
  std::vector<std::uint8_t> known;
  bool any = false;
  explicit ExpectedRow(std::size_t width) : ranges(width + 1), known(width + 1) {}
};

// The rows from `first` on, one after another. kReads: ranges are decoded; kNetwork: a network needs the masks.
template <bool kReads, bool kExpects, bool kNetwork>
class RowStage {
 public:
  // start, begin: the first difference and the first range, in sixteenths of a cell.
  RowStage(const RowSource& source, std::size_t first, std::uint32_t start, std::int32_t begin)
      : source_(source),
        first_(first),
        start_(start),
        begin_(begin),
        here_(source.width),
        before_(source.width),
        earlier_(source.width),
        above_(source.width),
        upper_(source.width),
        expected_here_(source.width),
        expected_above_(source.width),
        expected_below_(source.width),
        sizes_(source.width),
        mask_(source.width),
        above_mask_(source.width),
        below_mask_(source.width),
        known_(source.width),
        returns_(source.width + 1),
        expected_row_(source.width),
        expected_row_above_(source.width),
        expected_row_below_(source.width),
        around_(source.width),
        sizes_around_(source.width),
        firings_(source.width) {
    if constexpr (kExpects) close_up_expected(first, expected_row_below_);
    for (std::size_t c = 0; c < source.width; ++c)
      firings_[c] = static_cast<std::uint8_t>((source.firing + c) % kFirings);
  }

  // Begins a row. Reads the ranges that are known or to be encoded from the image. Raises Section if a return has no
  // range.
  template <class Image>
  RowTask begin(std::size_t row, Image* image) {
    row_ = row;
    const MaskLayout& layout = source_.layout;
    const std::size_t n = n_ = layout.cells(row);
    const std::uint8_t* const is_return = source_.returned.cells.data() + row * source_.width;
    const auto seen = [&](std::size_t other, const auto* from, auto& to) {
      layout.align(from, other, row, layout.shift(other, row, source_.turn), to);
    };
    const auto all = [&](auto& of, auto value) { std::fill(of.cells() - 8, of.cells() + n + 8, value); };
    layout.align(is_return, row, row, 0, mask_);
    RowSurroundings about{around_.data(), nullptr, nullptr, sizes_.cells(), sizes_around_.data()};
    if (row >= 1) {
      seen(row - 1, is_return - source_.width, above_mask_);
    } else {
      all(above_mask_, std::uint8_t{1});
    }
    if (row >= first_ + 1) {
      seen_ranges(row - 1, before_.ranges, above_);
      seen(row - 1, before_.sizes.data(), sizes_);
      about.above = above_.cells();
    } else {
      all(sizes_, start_);
    }
    if (row >= first_ + 2) {
      seen_ranges(row - 2, earlier_.ranges, upper_);
      about.upper = upper_.cells();
    }
    if (row + 1 < kMaskRows) {
      seen(row + 1, is_return + source_.width, below_mask_);
    } else {
      all(below_mask_, std::uint8_t{1});
    }
    if constexpr (kExpects) expect(about);
    if constexpr (kNetwork) {
      about.mask = mask_.cells();
      about.above_mask = above_mask_.cells();
      about.below_mask = below_mask_.cells();
    }
    about.row = static_cast<std::uint32_t>(row);
    about.columns = layout.columns(row).data();
    about.firings = firings_.data();
    about.first_firing = static_cast<std::uint32_t>(row) * kFirings;
    describe_returns<kExpects>(mask_.cells(), above_mask_.cells(), below_mask_.cells(), known_.cells(), n,
                               around_.data());
    const std::uint32_t* z = sizes_.cells();
    for (std::size_t k = 0; k < n; ++k, ++z) sizes_around_[k] = 3 * z[0] + z[-1] + 2 * (z[1] + z[2]);
    count_ = 0;
    for (std::size_t k = 0; k < n; ++k) {
      returns_[count_] = static_cast<std::uint32_t>(k);
      count_ += is_return[k];
    }
    take(image + row * source_.width);
    return {about, returns_.data() + known_returns_, count_ - known_returns_, here_.ranges.data(), here_.sizes.data()};
  }

  // Ends the row after it was coded: writes decoded ranges to the image, and keeps it for the rows below.
  template <class Image>
  void end(Image* image) {
    const std::size_t n = n_;
    std::uint16_t* to = source_.sent;
    if constexpr (kReads) to = image;
    if (to != nullptr) {
      const RangeCells::Row cells = source_.cells.row(row_);
      const std::vector<std::uint32_t>& columns = source_.layout.columns(row_);
      for (std::size_t i = known_returns_; i < count_; ++i) {
        const std::int32_t range = cells.range(here_.ranges[returns_[i]]);
        to[row_ * source_.width + columns[returns_[i]]] = static_cast<std::uint16_t>(std::clamp(range, 1, 65535));
      }
    }
    if (count_ != 0) {
      here_.fill(returns_, count_, n);
    } else if (row_ > first_) {
      std::copy_n(above_.cells(), n, here_.ranges.begin());
      std::copy_n(sizes_.cells(), n, here_.sizes.begin());
    } else {
      std::fill(here_.ranges.begin(), here_.ranges.end(), begin_);
      std::fill(here_.sizes.begin(), here_.sizes.end(), start_);
    }
    std::swap(earlier_, before_);
    std::swap(before_, here_);
  }

 private:
  // Aligns the ranges of another row with this one. A row without cells gives 16, one cell.
  void seen_ranges(std::size_t other, const std::vector<std::int32_t>& from, PaddedRowOf<std::int32_t>& to) const {
    source_.layout.align(from.data(), other, row_, source_.layout.shift(other, row_, source_.turn), to, 16);
  }

  // Closes up the expected ranges of a row.
  void close_up_expected(std::size_t row, ExpectedRow& into) const {
    const std::vector<std::uint32_t>& columns = source_.layout.columns(row);
    const std::uint16_t* const expected = source_.expected + row * source_.width;
    const std::size_t n = columns.size();
    const RangeCells::Row cells = source_.cells.row(row);
    std::int32_t last = -1;
    std::size_t first = n;
    for (std::size_t k = 0; k < n; ++k) {
      const std::int32_t range = expected[columns[k]];
      into.known[k] = range != 0;
      if (range != 0) {
        last = cells.sixteenths(range);
        first = std::min(first, k);
      }
      into.ranges[k] = last;
    }
    into.any = first < n;
    if (into.any) std::fill_n(into.ranges.begin(), first, into.ranges[first]);
  }

  // Aligns the expected ranges. A row without any takes the ranges of the row above.
  void expect(RowSurroundings& about) {
    const MaskLayout& layout = source_.layout;
    const bool above = row_ > first_;
    std::swap(expected_row_above_, expected_row_);
    std::swap(expected_row_, expected_row_below_);
    if (!expected_row_.any)
      for (std::size_t k = 0; k < n_; ++k) expected_row_.ranges[k] = above ? above_.cells()[k] : begin_;
    layout.align(expected_row_.ranges.data(), row_, row_, 0, expected_here_);
    layout.align(expected_row_.known.data(), row_, row_, 0, known_);
    if (above) seen_ranges(row_ - 1, expected_row_above_.ranges, expected_above_);
    about.expected = expected_here_.cells();
    about.expected_above = expected_above_.cells();
    about.known = known_.cells();
    if (row_ + 1 < kMaskRows) {
      close_up_expected(row_ + 1, expected_row_below_);
      if (kNetwork && expected_row_below_.any) {
        seen_ranges(row_ + 1, expected_row_below_.ranges, expected_below_);
        about.expected_below = expected_below_.cells();
      }
    }
  }

  // Reads the ranges of the returns that are known or to be encoded, and the differences of the known ones. Ranges that
  // are to be encoded freely are only levelled, not quantised.
  template <class Image>
  void take(Image* of_row) {
    const std::vector<std::uint32_t>& columns = source_.layout.columns(row_);
    known_returns_ = 0;
    while (known_returns_ < count_ && columns[returns_[known_returns_]] < source_.past) ++known_returns_;
    const std::size_t given = kReads ? known_returns_ : count_;
    const RangeCells::Row cells = source_.cells.row(row_);
    for (std::size_t i = 0; i < given; ++i) {
      const std::int32_t range = of_row[columns[returns_[i]]];
      if (range == 0) throw Error(ErrorCode::Section, "a return without a range");
      const bool as_it_is = !kReads && cells.free && i >= known_returns_;
      here_.ranges[returns_[i]] = as_it_is ? range + cells.level : cells.sixteenths(range);
    }
    for (std::size_t i = 0; i < known_returns_; ++i) {
      const std::int32_t range = here_.ranges[returns_[i]];
      here_.sizes[returns_[i]] = i == 0 ? start_ : difference(range - here_.ranges[returns_[i - 1]]);
    }
  }

  const RowSource& source_;
  std::size_t first_, row_ = 0, n_ = 0, count_ = 0, known_returns_ = 0;
  std::uint32_t start_;
  std::int32_t begin_;
  FilledRow here_, before_, earlier_;
  PaddedRowOf<std::int32_t> above_, upper_, expected_here_, expected_above_, expected_below_;
  PaddedRowOf<std::uint32_t> sizes_;
  PaddedRow mask_, above_mask_, below_mask_, known_;
  std::vector<std::uint32_t> returns_;
  ExpectedRow expected_row_, expected_row_above_, expected_row_below_;
  std::vector<std::uint16_t> around_;
  std::vector<std::uint32_t> sizes_around_;
  std::vector<std::uint8_t> firings_;  // of the columns
};

}  // namespace lidarcodec
