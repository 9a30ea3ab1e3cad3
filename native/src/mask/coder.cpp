#include "mask/coder.hpp"

#include <limits>

#include "base/error.hpp"
#include "bits/bitmodel.hpp"
#include "bits/rangecoder.hpp"
#include "mask/align.hpp"
#include "mask/rows.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kNone = kMaskNone, kAll = kMaskAll, kAlone = 2, kWithEarlier = 3;

// The first model is used alone where its probability is below this or above 65536 minus this: 1 in 128. Mixing gains
// little there.
constexpr std::uint32_t kAloneLimit = 512;

// Class, 0 to 7, of the length of the run of equal cells before this one.
constexpr std::array<std::uint8_t, 16> kRunClass = {0, 1, 2, 3, 4, 4, 5, 5, 5, 6, 6, 6, 6, 6, 6, 7};

// The prior probability of a context, of 65536, by 2 * left + above: the cells to the left and above.
constexpr std::array<std::uint32_t, 4> kPrior = {10000, 24000, 42000, 61000};

template <std::size_t N>
class Models {
 public:
  // left, above: the bits of a context number that hold these cells, and select the prior.
  Models(int left, int above) {
    for (std::size_t i = 0; i < N; ++i) models_[i] = BitModel(kPrior[2 * ((i >> left) & 1) + ((i >> above) & 1)]);
  }
  BitModel& operator[](std::size_t i) { return models_[i]; }

 private:
  std::array<BitModel, N> models_;
};

// The part of each cell's two contexts that does not depend on the row itself. Each step is one loop over the row, so
// that compilers vectorise it.
class KnownContext {
 public:
  std::vector<std::uint8_t> first, second;

  explicit KnownContext(std::size_t width)
      : first(width), second(width), twos_(width + kRoom), fours_(width + kRoom), counts_(width) {}

  // Without an earlier mask. u, v: the row above and the second row above, of n cells.
  void find_contexts(const std::uint8_t* u, const std::uint8_t* v, std::size_t n) {
    count(v - 6, n);
    const std::uint8_t* const four = fours_.data();
    fill(counts_, n, [=](std::ptrdiff_t k) { return four[k] + four[k + 4] + four[k + 8] + v[k + 6]; });
    const std::uint8_t* const among = counts_.data();
    fill(first, n, [=](std::ptrdiff_t k) { return 2 * class_of<13>(among[k]) + u[k]; });
    fill(second, n, [=](std::ptrdiff_t k) {
      return 64 * v[k + 1] + 32 * v[k] + 16 * u[k + 2] + 8 * u[k + 1] + 4 * u[k - 1] + 2 * u[k - 2] + u[k];
    });
  }

  // With an earlier mask. p: its row.
  void find_contexts(const std::uint8_t* u, const std::uint8_t* v, const std::uint8_t* p, std::size_t n) {
    count(p - 3, n);
    const std::uint8_t *const two = twos_.data(), *const four = fours_.data();
    fill(counts_, n, [=](std::ptrdiff_t k) { return four[k] + two[k + 4] + p[k + 3]; });
    const std::uint8_t* const among = counts_.data();
    fill(first, n, [=](std::ptrdiff_t k) { return 8 * class_of<7>(among[k]) + 4 * p[k] + 2 * v[k + 1] + u[k]; });
    fill(second, n, [=](std::ptrdiff_t k) {
      return 64 * p[k + 1] + 32 * p[k - 1] + 16 * p[k - 3] + 8 * p[k] + 4 * u[k + 1] + 2 * u[k - 1] + u[k];
    });
  }

 private:
  static constexpr std::size_t kRoom = 12;  // sums are needed for so many more cells

  template <class Number>
  static void fill(std::vector<std::uint8_t>& to, std::size_t n, const Number& number) {
    std::uint8_t* const at = to.data();
    for (std::ptrdiff_t k = 0; k < static_cast<std::ptrdiff_t>(n); ++k) at[k] = static_cast<std::uint8_t>(number(k));
  }

  // Sums of two and of four adjacent cells.
  void count(const std::uint8_t* cells, std::size_t n) {
    fill(twos_, n + kRoom - 2, [=](std::ptrdiff_t k) { return cells[k] + cells[k + 1]; });
    const std::uint8_t* const two = twos_.data();
    fill(fours_, n + kRoom - 4, [=](std::ptrdiff_t k) { return two[k] + two[k + 2]; });
  }

  // Class of the number of returns in a window of `size` cells: none, some, at least three quarters, all.
  template <int size>
  static int class_of(std::uint8_t count) {
    return (count > 0) + (count >= size - size / 4) + (count == size);
  }

  std::vector<std::uint8_t> twos_, fours_, counts_;
};

struct MaskModels {
  Models<256> first{7, 0};  // left is bit 7, above is bit 0
  Models<2048> second{7, 0};
  std::array<Mixer, 4> mixers;  // by left and above
};

// Codes the n cells of a row. Bits: BitWriter or BitReader.
template <bool kEarlier, class Bits>
void code_row(Bits& bits, MaskModels& models, const KnownContext& known, std::uint8_t* cells, std::size_t n) {
  std::uint32_t left = 1, left2 = 1, run = 0;
  std::uint32_t held =
      0;  // first context of the last cell; its model is in a register, as the next cell mostly has the same
  BitModel a = models.first[held];
  for (std::size_t k = 0; k < n; ++k) {
    const std::uint32_t run_class = kRunClass[run];
    const std::uint32_t first =
        kEarlier ? known.first[k] | left2 << 5 | left << 7 : known.first[k] | run_class << 3 | left << 7;
    if (first != held) {
      models.first[held] = a;
      a = models.first[first];
      held = first;
    }
    const std::uint32_t alone = a.probability();
    bool bit;
    if (alone < kAloneLimit || alone > 65536u - kAloneLimit) {
      bit = bits.bit(cells[k], alone);
    } else {
      const std::uint32_t second = known.second[k] | left << 7 | (kEarlier ? run_class : left2) << 8;
      BitModel& b = models.second[second];
      Mixer& mixer = models.mixers[left << 1 | (known.first[k] & 1u)];
      bit = bits.bit(cells[k], mixer.mix(a, b));
      mixer.update(bit);
      b.update(bit);
    }
    a.update(bit);
    if constexpr (Bits::kReads) cells[k] = bit;
    run = bit == (left != 0) ? run + (run < 15) : 0;
    left2 = left;
    left = bit;
  }
  models.first[held] = a;
}

// Codes all rows. rows: the cells of each row, closed up, row after row at distance `width`; a decoder fills them.
template <class Bits>
void code_mask(Bits& bits, const MaskLayout& layout, std::size_t width, const MaskShifts& shifts,
               const EarlierMask& earlier, std::uint8_t* rows) {
  MaskModels models;
  KnownContext known(width);
  PaddedRow above(width), above2(width), before(width);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::size_t n = layout.cells(row);
    for (std::size_t up = 1; up <= 2; ++up) {
      PaddedRow& out = up == 1 ? above : above2;
      if (row < up) {
        std::fill(out.cells() - PaddedRow::kMargin, out.cells() + n + PaddedRow::kMargin, std::uint8_t{1});
      } else {
        layout.align(rows + (row - up) * width, row - up, row, layout.shift(row - up, row, shifts.turn), out);
      }
    }
    std::uint8_t* cells = rows + row * width;
    if (earlier.width > 0) {
      layout.align_earlier(earlier, row, shifts.earlier, before);
      known.find_contexts(above.cells(), above2.cells(), before.cells(), n);
      code_row<true>(bits, models, known, cells, n);
    } else {
      known.find_contexts(above.cells(), above2.cells(), n);
      code_row<false>(bits, models, known, cells, n);
    }
  }
  bits.finish();
}

}  // namespace

std::vector<std::uint8_t> encode_mask(const std::uint8_t* mask, const MaskGeometry& geometry, EarlierMask earlier,
                                      std::uint32_t turn) {
  if (turn > 65535) throw Error(ErrorCode::Section, "a turn of more than 65535 columns");
  const std::size_t width = geometry.width;
  const MaskLayout layout(geometry);
  ClosedRows closed(mask, layout, width);
  std::vector<std::uint8_t>& rows = closed.cells;
  if (closed.returns == 0) return {kNone};
  if (closed.returns == closed.fired) return {kAll};

  MaskShifts shifts;
  shifts.turn = turn != 0 ? turn : find_turn(layout, rows.data(), width);
  if (earlier.width > 0) {
    const EarlierShift found = find_earlier(mask, width, earlier);
    shifts.earlier = found.columns;
    // One that tells less than the row above only spreads what there is to learn over more contexts.
    if (found.unlike >= unlike_above(layout, rows.data(), width, shifts.turn)) earlier = {};
  }
  std::vector<std::uint8_t> out = {earlier.width > 0 ? kWithEarlier : kAlone,
                                   static_cast<std::uint8_t>(shifts.turn & 0xFF),
                                   static_cast<std::uint8_t>(shifts.turn >> 8)};
  if (earlier.width > 0) {
    const auto shift = static_cast<std::uint16_t>(shifts.earlier);
    out.push_back(static_cast<std::uint8_t>(shift & 0xFF));
    out.push_back(static_cast<std::uint8_t>(shift >> 8));
  }
  BitWriter bits(out);
  code_mask(bits, layout, width, shifts, earlier, rows.data());
  return out;
}

std::vector<std::uint8_t> decode_mask(const std::uint8_t* data, std::size_t size, const MaskGeometry& geometry,
                                      EarlierMask earlier) {
  if (size == 0) throw Error(ErrorCode::Truncated, "a mask section holds no bytes");
  const std::size_t width = geometry.width;
  const std::uint8_t kind = data[0];
  if (kind == kNone || kind == kAll) {
    if (size != 1) throw Error(ErrorCode::Section, "bytes after the end of a mask section", 1);
    std::vector<std::uint8_t> mask(kMaskRows * width);
    for (std::size_t row = 0; kind == kAll && row < kMaskRows; ++row) {
      std::copy_n(geometry.fired + geometry.half[row] * width, width, mask.data() + row * width);
    }
    return mask;
  }
  if (kind > kWithEarlier) throw Error(ErrorCode::Section, "a mask section of an unknown kind");
  const std::size_t header = kind == kWithEarlier ? 5 : 3;
  if (size < header) throw Error(ErrorCode::Truncated, "a mask section ends within its header", size);
  if (kind == kAlone) earlier = {};
  if (kind == kWithEarlier && earlier.width == 0)
    throw Error(ErrorCode::Section, "a mask section needs the mask of an earlier frame");
  MaskShifts shifts;
  shifts.turn = static_cast<std::uint32_t>(data[1] | data[2] << 8);
  if (kind == kWithEarlier) shifts.earlier = static_cast<std::int16_t>(data[3] | data[4] << 8);

  const MaskLayout layout(geometry);
  std::vector<std::uint8_t> rows(kMaskRows * width);
  BitReader bits(data + header, size - header);
  code_mask(bits, layout, width, shifts, earlier, rows.data());
  return layout.opened(rows);
}

}  // namespace lidarcodec
