#include "planes/keep_coder.hpp"

#include "base/error.hpp"
#include "bits/rangecoder.hpp"
#include "mask/rows.hpp"
#include "motion/range_history.hpp"
#include "planes/keep_model.hpp"

namespace lidarcodec {
namespace {

enum Kind : std::uint8_t { kSparse = 4, kSparseWithEarlier = 5 };

// Below 1 in 128, or above 127 in 128, the first model is used alone.
constexpr std::uint32_t kSure = 512;

// The direction and the level of each cell of a row.
struct RowDirections {
  std::vector<std::uint16_t> direction;
  std::vector<std::uint8_t> level;

  void of(const MaskLayout& layout, const MaskGeometry& geometry, const std::uint16_t* azimuth, std::size_t row) {
    const std::vector<std::uint32_t>& columns = layout.columns(row);
    const std::uint16_t* at = azimuth + layout.half(row) * geometry.width;
    const std::uint32_t aside = direction_offset(static_cast<std::int32_t>(geometry.rotation[row]));
    direction.resize(columns.size());
    level.resize(columns.size());
    std::uint32_t before = kDirections;
    for (std::size_t k = 0; k < columns.size(); ++k) {
      const std::uint32_t here = direction_of(at[columns[k]], aside);
      direction[k] = static_cast<std::uint16_t>(here);
      level[k] = static_cast<std::uint8_t>(here == before ? kSharedDirection : direction_level(here));
      before = here;
    }
  }
};

// The directions that each row of the earlier mask kept.
class EarlierDirections {
 public:
  EarlierDirections(const MaskLayout& layout, const MaskGeometry& geometry, const std::uint16_t* azimuth,
                    const EarlierMask& earlier)
      : kept_(earlier.width > 0 ? kMaskRows + 2 : 0) {
    RowDirections directions;
    for (std::size_t row = 0; row < kMaskRows && earlier.width > 0; ++row) {
      directions.of(layout, geometry, azimuth, row);
      const std::vector<std::uint32_t>& columns = layout.columns(row);
      for (std::size_t k = 0; k < columns.size(); ++k)
        if (earlier.cells[row * earlier.width + columns[k]]) kept_[row + 1].add(directions.direction[k]);
    }
  }

  // Whether the direction was kept, one beside it, or the same one in the row above or below; a bit each.
  std::uint32_t about(std::size_t row, std::uint32_t direction) const {
    const std::uint64_t three = kept_[row + 1].from((direction + kDirections - 1) % kDirections, 3);
    const std::uint64_t upright = kept_[row].from(direction, 1) | kept_[row + 2].from(direction, 1);
    return static_cast<std::uint32_t>((three >> 1 & 1u) * 4 + (three & 5u ? 2 : 0) + upright);
  }

 private:
  std::vector<DirectionSet> kept_;  // with an empty row before the first and after the last
};

// Codes all rows, writing or reading as `Bits` does. `keep`: (64, W), read or written.
template <bool kEarlier, class Bits, class Cell>
void code_rows(Bits& bits, const MaskGeometry& geometry, const std::uint16_t* azimuth, const EarlierMask& earlier,
               Cell* keep) {
  const MaskLayout layout(geometry);
  const EarlierDirections before(layout, geometry, azimuth, earlier);
  KeepModels models;
  RowsAbove above;
  RowDirections directions;
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    directions.of(layout, geometry, azimuth, row);
    const std::vector<std::uint32_t>& columns = layout.columns(row);
    const std::uint32_t lattice = row_level(row);
    std::uint32_t gap = kLongestGap, last = 7;
    for (std::size_t k = 0; k < columns.size(); ++k) {
      const std::uint32_t direction = directions.direction[k], level = directions.level[k], gap_class = kGapClass[gap];
      Cell& cell = keep[row * geometry.width + columns[k]];
      BitModel& first = models.gap.of(level, lattice * kGapClasses + gap_class);
      const std::uint32_t sure = first.probability();
      bool bit;
      if (sure < kSure || sure > 65536u - kSure) {
        bit = bits.bit(cell != 0, sure);
        first.update(bit);
      } else {
        const std::array<BitModel*, kKeepModels> used = {
            &first, &models.crowd.of(level, lattice * 42 + above.crowd(direction)),
            &models.last.of(level, last * kGapClasses + gap_class),
            kEarlier ? &models.earlier.of(level, lattice * 8 + before.about(row, direction))
                     : &models.above.of(level, (lattice * 5 + above.near(direction)) * 5 + above.wide(direction))};
        KeepMixer& mixer = models.mixers[level];
        bit = bits.bit(cell != 0, mixer.mix(used));
        mixer.update(bit);
        for (BitModel* model : used) model->update(bit);
      }
      if constexpr (Bits::kReads) cell = bit;
      if (bit) {
        above.keep(direction);
        last = level;
        gap = 1;
      } else {
        gap = std::min(gap + 1, kLongestGap);
      }
    }
    above.next();
  }
  bits.finish();
}

void check(const MaskGeometry& geometry, const std::uint16_t* azimuth, const EarlierMask& earlier) {
  check_azimuths({geometry.width, azimuth, geometry.fired});
  if (earlier.width != 0 && earlier.width != geometry.width)
    throw Error(ErrorCode::Section, "an earlier mask that is not as wide as the frame");
}

}  // namespace

std::vector<std::uint8_t> encode_keep(const std::uint8_t* keep, const MaskGeometry& geometry,
                                      const std::uint16_t* azimuth, EarlierMask earlier) {
  check(geometry, azimuth, earlier);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::uint8_t* fired = geometry.fired + geometry.half[row] * geometry.width;
    for (std::size_t column = 0; column < geometry.width; ++column)
      if (keep[row * geometry.width + column] && !fired[column])
        throw Error(ErrorCode::Section, "a mask is set in a block that did not fire");
  }
  std::vector<std::uint8_t> out = {earlier.width > 0 ? kSparseWithEarlier : kSparse};
  BitWriter bits(out);
  if (earlier.width > 0)
    code_rows<true>(bits, geometry, azimuth, earlier, keep);
  else
    code_rows<false>(bits, geometry, azimuth, earlier, keep);
  return out;
}

std::vector<std::uint8_t> decode_keep(const std::uint8_t* data, std::size_t size, const MaskGeometry& geometry,
                                      const std::uint16_t* azimuth, EarlierMask earlier) {
  if (size == 0) throw Error(ErrorCode::Truncated, "a keep section holds no bytes");
  check(geometry, azimuth, earlier);
  if (data[0] != kSparse && data[0] != kSparseWithEarlier)
    throw Error(ErrorCode::Section, "a keep section of an unknown kind");
  if (data[0] == kSparseWithEarlier && earlier.width == 0)
    throw Error(ErrorCode::Section, "a keep section needs the mask of an earlier frame");
  std::vector<std::uint8_t> keep(kMaskRows * geometry.width);
  BitReader bits(data + 1, size - 1);
  if (data[0] == kSparseWithEarlier)
    code_rows<true>(bits, geometry, azimuth, earlier, keep.data());
  else
    code_rows<false>(bits, geometry, azimuth, EarlierMask{}, keep.data());
  return keep;
}

}  // namespace lidarcodec
