#include "predictive_coder.hpp"

#include "error.hpp"
#include "mask_align.hpp"
#include "mask_rows.hpp"
#include "predictive_avx2.hpp"
#include "predictive_rows.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kAlone = 1, kExpecting = 2;  // kinds: contexts of this frame only; of what is expected, too
constexpr std::size_t kHeadBytes = 7;  // kind, turn u16, bytes of the first stream u32
constexpr std::int32_t kMaxLevel = 1000;
constexpr std::int32_t kMaxRange = 65535;

void check(const RangeCells& cells) {
  if (cells.step % 2 == 0 || cells.step > 65535) throw Error(ErrorCode::Section, "a step that is not odd, or too long");
  for (const std::int32_t level : cells.level)
    if (level < 0 || level > kMaxLevel) throw Error(ErrorCode::Section, "a row's level beyond the limits");
}

// Ranges and differences of the row above, as filled in where there are no returns.
struct FilledRow {
  std::vector<std::int32_t> ranges;
  std::vector<std::uint32_t> sizes;
  explicit FilledRow(std::size_t width) : ranges(width + 1), sizes(width + 1) {}

  // No returns take what is to their left, those at the start the first return's.
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

// What Known::returns says of each of the n cells of a row, from the returns of this row (m), the one above (a) and the
// one below (b), and what is known (e).
template <bool kExpects>
void look_around(const std::uint8_t* m, const std::uint8_t* a, const std::uint8_t* b, const std::uint8_t* e,
                 std::size_t n, std::uint16_t* around) {
  for (std::size_t k = 0; k < n; ++k, ++m, ++a, ++b) {
    std::uint32_t is = m[-1] | m[-2] << 1 | m[1] << 2 | m[2] << 3 | b[0] << 4 | b[-1] << 5 | b[1] << 6 | a[0] << 7 | a[1] << 8;
    if constexpr (kExpects) {
      is |= e[-1] << 9 | e[1] << 10 | e[0] << 11;
      ++e;
    }
    around[k] = static_cast<std::uint16_t>(is | m[1] << 12 | b[0] << 13 | a[0] << 14 | m[-1] << 15);
  }
}

// Codes all rows of an image, (64, W); only returns are looked at, or written.
template <class Forms, bool kExpects, class Coder, class Image>
void code_rows(PredictiveModel& model, const RangeCells& cells, std::uint32_t turn, const MaskLayout& layout,
               const ClosedRows& returned, std::size_t width, std::array<PredictiveHalf<Coder>, 2>& halves,
               const std::uint16_t* expected, Image* image) {
  using Rows = PredictiveRows<Coder, Forms, kExpects>;
  const auto step = static_cast<std::int32_t>(cells.step);
  Rows coder(model, cells.step, (kMaxRange + kMaxLevel) / step + 1, halves);
  FilledRow here(width), before(width), earlier(width);
  PaddedRowOf<std::int32_t> above(width), upper(width);
  PaddedRowOf<std::uint32_t> sizes(width);
  PaddedRow mask(width), above_mask(width), below_mask(width);
  std::vector<std::uint32_t> returns(width + 1);
  std::vector<std::uint16_t> around(width);
  std::vector<std::uint32_t> sizes_around(width);
  PaddedRowOf<std::int32_t> expected_here(width), expected_above(width);
  PaddedRow known(width);
  std::vector<std::int32_t> foreseen(width + 1), foreseen_above(width + 1);
  std::vector<std::uint8_t> is_known(width + 1);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::size_t n = layout.cells(row);
    const std::uint8_t* is_return = returned.cells.data() + row * width;
    const auto seen = [&](std::size_t other, const auto* from, auto& to) {
      layout.align(from, other, row, layout.shift(other, row, turn), to);
    };
    layout.align(is_return, row, row, 0, mask);
    RowSurroundings about{around.data(), nullptr, nullptr, sizes.cells(), sizes_around.data()};
    if (row >= 1) {
      seen(row - 1, is_return - width, above_mask);
      seen(row - 1, before.ranges.data(), above);
      seen(row - 1, before.sizes.data(), sizes);
      about.above = above.cells();
    } else {
      std::fill(above_mask.cells() - 8, above_mask.cells() + n + 8, std::uint8_t{1});
      std::fill(sizes.cells() - 8, sizes.cells() + n + 8, coder.start());
    }
    if (row >= 2) {
      seen(row - 2, earlier.ranges.data(), upper);
      about.upper = upper.cells();
    }
    if (row + 1 < kMaskRows) {
      seen(row + 1, is_return + width, below_mask);
    } else {
      std::fill(below_mask.cells() - 8, below_mask.cells() + n + 8, std::uint8_t{1});
    }

    if constexpr (kExpects) {
      const std::uint16_t* of_expected = expected + row * width;
      std::int32_t last = -1;
      std::size_t first = n;
      for (std::size_t k = 0; k < n; ++k) {
        const std::int32_t range = of_expected[layout.columns(row)[k]];
        is_known[k] = range != 0;
        if (range != 0) {
          last = (range + cells.level[row] + step / 2) / step;
          first = std::min(first, k);
        }
        foreseen[k] = last;
      }
      for (std::size_t k = 0; k < n && k < first; ++k)
        foreseen[k] = first < n ? foreseen[first] : row >= 1 ? above.cells()[k] : coder.first();
      layout.align(foreseen.data(), row, row, 0, expected_here);
      layout.align(is_known.data(), row, row, 0, known);
      if (row >= 1) seen(row - 1, foreseen_above.data(), expected_above);
      about.expected = expected_here.cells();
      about.expected_above = expected_above.cells();
      std::copy_n(foreseen.begin(), n, foreseen_above.begin());
    }
    look_around<kExpects>(mask.cells(), above_mask.cells(), below_mask.cells(), known.cells(), n, around.data());
    const std::uint32_t* z = sizes.cells();
    for (std::size_t k = 0; k < n; ++k, ++z) sizes_around[k] = 3 * z[0] + z[-1] + 2 * (z[1] + z[2]);
    std::size_t count = 0;
    for (std::size_t k = 0; k < n; ++k) {
      returns[count] = static_cast<std::uint32_t>(k);
      count += is_return[k];
    }
    const std::vector<std::uint32_t>& columns = layout.columns(row);
    Image* const of_row = image + row * width;
    const std::int32_t level = cells.level[row];
    if constexpr (!Rows::kReads) {
      for (std::size_t i = 0; i < count; ++i) {
        const std::int32_t range = of_row[columns[returns[i]]];
        if (range == 0) throw Error(ErrorCode::Section, "a return without a range");
        here.ranges[returns[i]] = (range + level + step / 2) / step;
      }
    }
    coder.code(about, returns, count, here.ranges.data(), here.sizes.data());
    if constexpr (Rows::kReads) {
      for (std::size_t i = 0; i < count; ++i) {
        const std::int32_t range = here.ranges[returns[i]] * step - level;
        of_row[columns[returns[i]]] = static_cast<std::uint16_t>(std::clamp(range, 1, kMaxRange));
      }
    }
    if (count != 0) {
      here.fill(returns, count, n);
    } else if (row >= 1) {
      std::copy_n(above.cells(), n, here.ranges.begin());
      std::copy_n(sizes.cells(), n, here.sizes.begin());
    } else {
      std::fill(here.ranges.begin(), here.ranges.end(), coder.first());
      std::fill(here.sizes.begin(), here.sizes.end(), coder.start());
    }
    std::swap(earlier, before);
    std::swap(before, here);
  }
}

// The same, on a path, with or without something expected.
template <class Coder, class Image>
void code_rows(Path path, PredictiveModel& model, const RangeCells& cells, std::uint32_t turn, const MaskLayout& layout,
               const ClosedRows& returned, std::size_t width, std::array<PredictiveHalf<Coder>, 2>& halves,
               const std::uint16_t* expected, Image* image) {
  const auto code = [&]<class Forms>(const Forms&) {
    if (expected != nullptr) {
      code_rows<Forms, true>(model, cells, turn, layout, returned, width, halves, expected, image);
    } else {
      code_rows<Forms, false>(model, cells, turn, layout, returned, width, halves, expected, image);
    }
  };
  switch (path) {
    case Path::Plain:
      return code(PlainForms{});
    case Path::Vector:
      return code(VectorForms{});
    case Path::Avx2:
#if defined(__x86_64__)
      return code(Avx2Forms{});
#else
      return code(VectorForms{});
#endif
  }
}

void put(std::vector<std::uint8_t>& out, std::size_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

std::size_t take(const std::uint8_t* from, int bytes) {
  std::size_t value = 0;
  for (int i = bytes - 1; i >= 0; --i) value = value << 8 | from[i];
  return value;
}

}  // namespace

std::vector<std::uint8_t> PredictiveCoder::encode(const std::uint16_t* ranges, const std::uint8_t* returns,
                                                  const RangeCells& cells, const MaskGeometry& geometry,
                                                  std::uint32_t turn, const std::uint16_t* expected) {
  check(cells);
  if (turn > 65535) throw Error(ErrorCode::Section, "a turn of more than 65535 columns");
  const std::size_t width = geometry.width;
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, width);
  if (returned.returns == 0) return {};
  if (turn == 0) turn = find_turn(layout, returned.cells.data(), width);
  std::array<PredictiveHalf<WideEncoder>, 2> halves;
  code_rows(path_, model_, cells, turn, layout, returned, width, halves, expected, ranges);
  const std::vector<std::uint8_t>& first = halves[0].coder.finish(halves[0].interval);
  const std::vector<std::uint8_t>& second = halves[1].coder.finish(halves[1].interval);
  std::vector<std::uint8_t> out;
  out.reserve(kHeadBytes + first.size() + second.size());
  put(out, expected == nullptr ? kAlone : kExpecting, 1);
  put(out, turn, 2);
  put(out, first.size(), 4);
  out.insert(out.end(), first.begin(), first.end());
  out.insert(out.end(), second.begin(), second.end());
  return out;
}

std::vector<std::uint16_t> PredictiveCoder::decode(const std::uint8_t* data, std::size_t size,
                                                   const std::uint8_t* returns, const RangeCells& cells,
                                                   const MaskGeometry& geometry, const std::uint16_t* expected) {
  check(cells);
  const std::size_t width = geometry.width;
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, width);
  std::vector<std::uint16_t> image(kMaskRows * width);
  if (returned.returns == 0) {
    if (size != 0) throw Error(ErrorCode::Section, "ranges where there are no returns");
    return image;
  }
  if (size < kHeadBytes) throw Error(ErrorCode::Truncated, "ranges end within their header", size);
  if (data[0] != (expected == nullptr ? kAlone : kExpecting))
    throw Error(ErrorCode::Section, "ranges of an unknown kind");
  const auto turn = static_cast<std::uint32_t>(take(data + 1, 2));
  const std::size_t first = take(data + 3, 4), rest = size - kHeadBytes;
  if (first > rest) throw Error(ErrorCode::Truncated, "ranges end before their streams do", size);
  const std::uint8_t* streams = data + kHeadBytes;
  std::array<PredictiveHalf<WideDecoder>, 2> halves = {
      PredictiveHalf<WideDecoder>{WideDecoder(streams, first)},
      PredictiveHalf<WideDecoder>{WideDecoder(streams + first, rest - first)}};
  for (auto& half : halves) half.interval = half.coder.start();
  code_rows(path_, model_, cells, turn, layout, returned, width, halves, expected, image.data());
  for (const auto& half : halves) half.coder.finish(half.interval);
  return image;
}

}  // namespace lidarcodec
