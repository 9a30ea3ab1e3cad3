#include "mask_coder.hpp"

#include <limits>

#include "bitmodel.hpp"
#include "error.hpp"
#include "mask_align.hpp"
#include "mask_rows.hpp"
#include "rangecoder.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kNone = kMaskNone, kAll = kMaskAll, kAlone = 2, kWithEarlier = 3;

// Surer than 1 in 128, the first model is used alone: nothing to gain, and two thirds of the cells are done fast.
constexpr std::uint32_t kSure = 512;

// Length of the run of equal cells before this one, in eight classes.
constexpr std::array<std::uint8_t, 16> kRunClass = {0, 1, 2, 3, 4, 4, 5, 5, 5, 6, 6, 6, 6, 6, 6, 7};

// Where the probability of a context starts, by the cells to the left and above: {00, 01, 10, 11} = 2 * left + above.
constexpr std::array<std::uint32_t, 4> kPrior = {10000, 24000, 42000, 61000};

template <std::size_t N>
class Models {
 public:
  // Bits `left` and `above` of a context's number say which prior it starts from.
  Models(int left, int above) {
    for (std::size_t i = 0; i < N; ++i) models_[i] = BitModel(kPrior[2 * ((i >> left) & 1) + ((i >> above) & 1)]);
  }
  BitModel& operator[](std::size_t i) { return models_[i]; }

 private:
  std::array<BitModel, N> models_;
};

// The part of each cell's two contexts that is known before the row is begun.
struct KnownContext {
  std::vector<std::uint8_t> first;
  std::vector<std::uint8_t> second;
};

// Classes of a count of returns in a window of `size` cells: none, some, nearly all, all.
constexpr std::uint8_t count_class(int count, int size) {
  return count == size ? 3 : count >= size - size / 4 ? 2 : count > 0 ? 1 : 0;
}

void known_alone(const std::uint8_t* u, const std::uint8_t* v, std::size_t n, KnownContext& known) {
  int wide = 0;  // row two above, 13 cells about this one
  for (int j = -6; j < 6; ++j) wide += v[j];
  for (std::size_t k = 0; k < n; ++k, ++u, ++v) {
    wide += v[6];
    known.first[k] = static_cast<std::uint8_t>(u[0] | count_class(wide, 13) << 1);
    known.second[k] =
        static_cast<std::uint8_t>(u[0] | u[-2] << 1 | u[-1] << 2 | u[1] << 3 | u[2] << 4 | v[0] << 5 | v[1] << 6);
    wide -= v[-6];
  }
}

void known_with_earlier(const std::uint8_t* u, const std::uint8_t* v, const std::uint8_t* p, std::size_t n,
                        KnownContext& known) {
  int about = 0;  // the same row earlier, 7 cells about this one
  for (int j = -3; j < 3; ++j) about += p[j];
  for (std::size_t k = 0; k < n; ++k, ++u, ++v, ++p) {
    about += p[3];
    known.first[k] = static_cast<std::uint8_t>(u[0] | v[1] << 1 | p[0] << 2 | count_class(about, 7) << 3);
    known.second[k] =
        static_cast<std::uint8_t>(u[0] | u[-1] << 1 | u[1] << 2 | p[0] << 3 | p[-3] << 4 | p[-1] << 5 | p[1] << 6);
    about -= p[-3];
  }
}

struct MaskModels {
  Models<256> first{7, 0};  // left at bit 7 in both forms, above at bit 0
  Models<2048> second{7, 0};
  std::array<Mixer, 4> mixers;  // by left and above
};

// Codes `n` cells in `cells`, writing or reading as `Bits` does.
template <bool kEarlier, class Bits>
void code_row(Bits& bits, MaskModels& models, const KnownContext& known, std::uint8_t* cells, std::size_t n) {
  std::uint32_t left = 1, left2 = 1, run = 0;
  for (std::size_t k = 0; k < n; ++k) {
    const std::uint32_t run_class = kRunClass[run];
    const std::uint32_t first =
        kEarlier ? known.first[k] | left2 << 5 | left << 7 : known.first[k] | run_class << 3 | left << 7;
    const std::uint32_t second = known.second[k] | left << 7 | (kEarlier ? run_class : left2) << 8;
    BitModel& a = models.first[first];
    const std::uint32_t sure = a.probability();
    bool bit;
    if (sure < kSure || sure > 65536u - kSure) {
      bit = bits.bit(cells[k], sure);
    } else {
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
}

// Codes all rows. `rows[r]` holds the cells of row r, closed up; of rows not yet decoded only the room.
template <class Bits>
void code_mask(Bits& bits, const MaskLayout& layout, std::size_t width, const MaskShifts& shifts,
               const EarlierMask& earlier, std::uint8_t* rows) {
  MaskModels models;
  KnownContext known{std::vector<std::uint8_t>(width), std::vector<std::uint8_t>(width)};
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
      known_with_earlier(above.cells(), above2.cells(), before.cells(), n, known);
      code_row<true>(bits, models, known, cells, n);
    } else {
      known_alone(above.cells(), above2.cells(), n, known);
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
  std::vector<std::uint8_t> mask(kMaskRows * width);
  if (kind == kNone || kind == kAll) {
    if (size != 1) throw Error(ErrorCode::Section, "bytes after the end of a mask section", 1);
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
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::uint8_t* from = rows.data() + row * width;
    if (layout.whole(row)) {
      std::copy_n(from, width, mask.data() + row * width);
    } else {
      for (const std::uint32_t column : layout.columns(row)) mask[row * width + column] = *from++;
    }
  }
  return mask;
}

}  // namespace lidarcodec
