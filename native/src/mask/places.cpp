#include "mask/places.hpp"

#include <algorithm>
#include <cstdlib>

namespace lidarcodec {
namespace {

constexpr std::size_t kMostFilled = 8;  // a cell owns the directions up to the next cell if that is at most so far
constexpr std::size_t kStepBeyond = 2;  // directions between cells beyond the ends of a row
constexpr std::int64_t kMostMoved = 1 << 20;       // 65 m, the largest translation in a turn
constexpr std::int64_t kMostTurned = 1 << 30;      // a radian, the largest rotation
constexpr std::int64_t kDirectionsInRadian = 652;  // 4096 / (2 pi)
constexpr std::int64_t kTableSteps = 100'000'000;  // steps of the calibration table in a radian

std::int64_t bounded(std::int64_t value, std::int64_t most) { return std::clamp(value, -most, most); }

}  // namespace

MaskTables::MaskTables() {
  forget();
  for (std::size_t b = 0; b < kBlocks; ++b)
    block_directions_[b] = cos_sin(static_cast<Angle>((b * kBlock + kBlock / 2) << 20));
}

void MaskTables::forget() {
  beams_.assign(kMaskRows * kDirections, 255);
  places_.assign(kMaskRows * kDirections, 255);
}

MaskFrame::MaskFrame(const MaskView& view, MaskTables& tables) : view_(view), layout_(view.geometry), tables_(tables) {
  tables.next_ = tables.places_;
  const std::size_t width = view.geometry.width;
  values_.resize(width + DirectionGroups::kRoom);
  check_azimuths({width, view.azimuth, view.geometry.fired});
  std::array<bool, 2> done{};
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const std::size_t half = layout_.half(row);
    const std::vector<std::uint32_t>& columns = layout_.columns(row);
    if (done[half] || columns.empty()) continue;
    done[half] = true;
    std::vector<std::uint16_t>& slots = slots_[half];
    slots.resize(columns.size() + 2 * kMargin);
    std::uint16_t *const first = slots.data() + kMargin, *const last = first + columns.size() - 1;
    for (std::size_t k = 0; k < columns.size(); ++k)
      first[k] = static_cast<std::uint16_t>(RangeHistory::slot_of(view.azimuth[half * width + columns[k]]));
    std::vector<std::uint32_t> cell_of(kDirections, DirectionGroups::kNoCell);
    for (std::size_t k = 0; k < columns.size(); ++k) {
      std::size_t own = kStepBeyond;
      if (k + 1 < columns.size()) {
        const std::size_t apart = (first[k + 1] + kDirections - first[k]) % kDirections;
        own = apart == 0 || apart > kMostFilled ? 1 : apart;
      }
      for (std::size_t j = 0; j < own; ++j) cell_of[(first[k] + j) % kDirections] = static_cast<std::uint32_t>(k);
    }
    direction_groups_[half].begin(std::move(cell_of));
    for (std::ptrdiff_t j = 1; j <= kMargin; ++j) {
      first[-j] =
          static_cast<std::uint16_t>((*first + kDirections - static_cast<std::size_t>(j) * kStepBeyond) % kDirections);
      last[j] = static_cast<std::uint16_t>((*last + static_cast<std::size_t>(j) * kStepBeyond) % kDirections);
    }
    cell_groups_[half] = CellGroups(slots);
  }
  const Motion& motion = view.motion;
  const std::int64_t x = bounded(motion.translation[0], kMostMoved), y = bounded(motion.translation[1], kMostMoved);
  for (std::size_t b = 0; b < kBlocks; ++b) {
    const std::int64_t cos = tables.block_directions_[b].cos, sin = tables.block_directions_[b].sin;
    block_motion_[b].across = rounded30(x * sin + y * cos);
    block_motion_[b].along = rounded30(x * cos - y * sin);
    block_motion_[b].tilt = rounded30(motion.rotation[7] * sin + motion.rotation[2] * cos);
  }
}

void MaskFrame::begin_row(std::size_t row, const std::uint16_t* expected) {
  row_ = row;
  const std::vector<std::uint16_t>& slots = slots_[view_.geometry.half[row]];
  n_ = layout_.cells(row);
  at_.resize(slots.size());
  direction_offset_ =
      ((angle_of_table(static_cast<std::int32_t>(view_.geometry.rotation[row])) + (1u << 19)) >> 20) % kDirections;
  for (std::size_t i = 0; i < slots.size(); ++i)
    at_[i] = static_cast<std::uint16_t>((slots[i] + kDirections - direction_offset_) % kDirections);

  sine_ = cos_sin(angle_of_table(view_.vertical[row])).sin;
  std::array<std::uint16_t, kBlocks> range{};  // the last expected range of each block
  std::array<std::uint8_t, kBlocks> here{};
  std::size_t block = kBlocks;
  std::uint16_t last = 0;
  for (std::size_t k = 0; k < n_; ++k) {
    if (at_[k + kMargin] / kBlock != block) {
      block = at_[k + kMargin] / kBlock;
      here[block] = 1;
      last = range[block];
    }
    if (expected[k] != 0) last = expected[k];
    range[block] = last;
  }
  for (std::size_t b = 0; b < kBlocks; ++b) {
    if (!here[b]) continue;
    earlier_places_[b] = earlier_place(b, range[b]);
    copy_places(b);
  }
}

void MaskFrame::copy_places(std::size_t block) {
  const std::size_t begin = block * kBlock;
  const std::size_t then =
      (begin + kDirections + static_cast<std::size_t>(static_cast<std::ptrdiff_t>(earlier_places_[block].directions))) %
      kDirections;
  for (std::size_t j = 0; j < 3; ++j) {
    const std::uint8_t* const from =
        row_of(tables_.places_, earlier_places_[block].row + static_cast<std::ptrdiff_t>(j) - 1);
    std::uint8_t* const to = moved_places_[j].data() + begin;
    if (then + kBlock <= kDirections) {
      std::copy_n(from + then, kBlock, to);
    } else {
      for (std::size_t i = 0; i < kBlock; ++i) to[i] = from[(then + i) % kDirections];
    }
  }
}

// The row and the shift in directions where a place at `range` was a turn ago; 0: infinitely far.
MaskFrame::EarlierPlace MaskFrame::earlier_place(std::size_t block, std::uint32_t range) const {
  const BlockMotion& sway = block_motion_[block];
  const std::int64_t inverse_range = range == 0 ? 0 : (std::int64_t{1} << 40) / (kLengthsPerStep * range);
  const std::int64_t down = bounded(view_.motion.translation[2], kMostMoved);
  const std::int64_t turn = view_.motion.rotation[3] + ((sway.across * inverse_range) >> 10);
  const std::int64_t rise = sway.tilt + (((rounded30(sway.along * sine_) - down) * inverse_range) >> 10);
  EarlierPlace found;
  found.directions = static_cast<std::int32_t>(rounded30(bounded(turn, kMostTurned) * kDirectionsInRadian));
  const std::int64_t target = view_.vertical[row_] + rounded30(bounded(rise, kMostTurned) * kTableSteps);
  const auto off = [&](std::size_t row) { return std::abs(view_.vertical[row] - target); };
  std::size_t row = row_;
  while (row + 1 < kMaskRows && off(row + 1) < off(row)) ++row;
  while (row > 0 && off(row - 1) < off(row)) --row;
  found.row = static_cast<std::int32_t>(row);
  return found;
}

}  // namespace lidarcodec
