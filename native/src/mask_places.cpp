#include "mask_places.hpp"

#include <algorithm>
#include <cstdlib>

namespace lidarcodec {
namespace {

constexpr std::size_t kMostFilled = 8;             // directions from a cell to the next one that both count as its own
constexpr std::size_t kStepBeyond = 2;             // directions between cells beyond the ends of a row
constexpr std::int64_t kMostMoved = 1 << 20;       // 65 m in a turn
constexpr std::int64_t kMostTurned = 1 << 30;      // a radian
constexpr std::int64_t kPlacesInRadian = 652;      // 4096 / 2 pi
constexpr std::int64_t kTableSteps = 100'000'000;  // of the calibration table in a radian

std::int64_t bounded(std::int64_t value, std::int64_t most) { return std::clamp(value, -most, most); }

}  // namespace

MaskPlaces::MaskPlaces() {
  forget();
  for (std::size_t b = 0; b < kBlocks; ++b) towards_[b] = turned(static_cast<Angle>((b * kBlock + kBlock / 2) << 20));
}

void MaskPlaces::forget() {
  beams_.assign(kMaskRows * kPlaces, 255);
  places_.assign(kMaskRows * kPlaces, 255);
}

MaskFrame::MaskFrame(const MaskView& view, MaskPlaces& tables)
    : view_(view), layout_(view.geometry), tables_(tables) {
  tables.next_ = tables.places_;
  const std::size_t width = view.geometry.width;
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
    std::vector<std::uint8_t>& filled = filled_[half];
    for (std::size_t k = 0; k + 1 < columns.size(); ++k) {
      const std::size_t apart = (first[k + 1] + kPlaces - first[k]) % kPlaces;
      filled.push_back(static_cast<std::uint8_t>(apart == 0 || apart > kMostFilled ? 1 : apart));
    }
    filled.push_back(kStepBeyond);
    for (std::ptrdiff_t j = 1; j <= kMargin; ++j) {
      first[-j] = static_cast<std::uint16_t>((*first + kPlaces - static_cast<std::size_t>(j) * kStepBeyond) % kPlaces);
      last[j] = static_cast<std::uint16_t>((*last + static_cast<std::size_t>(j) * kStepBeyond) % kPlaces);
    }
  }
  const Motion& motion = view.motion;
  const std::int64_t x = bounded(motion.translation[0], kMostMoved), y = bounded(motion.translation[1], kMostMoved);
  for (std::size_t b = 0; b < kBlocks; ++b) {
    const std::int64_t cos = tables.towards_[b].cos, sin = tables.towards_[b].sin;
    sway_[b].across = rounded30(x * sin + y * cos);
    sway_[b].along = rounded30(x * cos - y * sin);
    sway_[b].tilt = rounded30(motion.rotation[7] * sin + motion.rotation[2] * cos);
  }
}

void MaskFrame::begin_row(std::size_t row, const std::uint16_t* expected) {
  row_ = row;
  const std::vector<std::uint16_t>& slots = slots_[view_.geometry.half[row]];
  n_ = layout_.cells(row);
  at_.resize(slots.size());
  const std::uint32_t aside = (angle_of_table(static_cast<std::int32_t>(view_.geometry.rotation[row])) + (1u << 19)) >> 20;
  for (std::size_t i = 0; i < slots.size(); ++i)
    at_[i] = static_cast<std::uint16_t>((slots[i] + kPlaces - aside % kPlaces) % kPlaces);

  sine_ = turned(angle_of_table(view_.vertical[row])).sin;
  std::array<std::uint16_t, kBlocks> range{};  // the last that is expected in each block
  std::array<std::uint8_t, kBlocks> here{};
  for (std::size_t k = 0; k < n_; ++k) {
    const std::size_t block = at_[k + kMargin] / kBlock;
    here[block] = 1;
    if (expected[k] != 0) range[block] = expected[k];
  }
  for (std::size_t b = 0; b < kBlocks; ++b)
    if (here[b]) moved_[b] = moved(b, range[b]);
}

// Where the place of a range lay a turn ago; 0: infinitely far.
MaskFrame::Moved MaskFrame::moved(std::size_t block, std::uint32_t range) const {
  const Sway& sway = sway_[block];
  const std::int64_t nearness = range == 0 ? 0 : (std::int64_t{1} << 40) / (kLengthsPerStep * range);
  const std::int64_t down = bounded(view_.motion.translation[2], kMostMoved);
  const std::int64_t turn = view_.motion.rotation[3] + ((sway.across * nearness) >> 10);
  const std::int64_t rise = sway.tilt + (((rounded30(sway.along * sine_) - down) * nearness) >> 10);
  Moved found;
  found.directions = static_cast<std::int32_t>(rounded30(bounded(turn, kMostTurned) * kPlacesInRadian));
  const std::int64_t target = view_.vertical[row_] + rounded30(bounded(rise, kMostTurned) * kTableSteps);
  const auto off = [&](std::size_t row) { return std::abs(view_.vertical[row] - target); };
  std::size_t row = row_;
  while (row + 1 < kMaskRows && off(row + 1) < off(row)) ++row;
  while (row > 0 && off(row - 1) < off(row)) --row;
  found.row = static_cast<std::int32_t>(row);
  return found;
}

const std::uint8_t* MaskFrame::row_of(const std::vector<std::uint8_t>& table, std::ptrdiff_t row) const {
  const bool inside = row >= 0 && row < static_cast<std::ptrdiff_t>(kMaskRows);
  return inside ? table.data() + static_cast<std::size_t>(row) * kPlaces : tables_.everywhere_.data();
}

void MaskFrame::beams(PaddedRow& above3, PaddedRow& above2, PaddedRow& above, PaddedRow& here, PaddedRow& below) const {
  const auto row = static_cast<std::ptrdiff_t>(row_);
  const std::array<PaddedRow*, 5> out = {&above3, &above2, &above, &here, &below};
  std::array<const std::uint8_t*, 5> from;
  std::array<std::uint8_t*, 5> to;
  for (std::size_t j = 0; j < 5; ++j) {
    from[j] = row_of(tables_.beams_, row + static_cast<std::ptrdiff_t>(j) - 3);
    to[j] = out[j]->cells() - kMargin;
  }
  const std::uint16_t* const at = at_.data();
  const std::size_t all = at_.size();
  for (std::size_t i = 0; i < all; ++i)
    for (std::size_t j = 0; j < 5; ++j) to[j][i] = from[j][at[i]];
}

void MaskFrame::places(PaddedRow& above, PaddedRow& here, PaddedRow& below) const {
  std::uint8_t *const a = above.cells(), *const h = here.cells(), *const b = below.cells();
  std::size_t block = kBlocks;
  const std::uint8_t *from_a = nullptr, *from_h = nullptr, *from_b = nullptr;
  std::size_t by = 0;
  for (std::size_t k = 0; k < n_; ++k) {
    const std::size_t at = at_[k + kMargin];
    if (at / kBlock != block) {
      block = at / kBlock;
      from_a = row_of(tables_.places_, moved_[block].row - 1);
      from_h = row_of(tables_.places_, moved_[block].row);
      from_b = row_of(tables_.places_, moved_[block].row + 1);
      by = static_cast<std::size_t>(moved_[block].directions + static_cast<std::int32_t>(kPlaces));
    }
    const std::size_t then = (at + by) % kPlaces;
    a[k] = from_a[then];
    h[k] = from_h[then];
    b[k] = from_b[then];
  }
  for (PaddedRow* row : {&above, &here, &below}) row->pad(n_);
}

void MaskFrame::put(const std::uint8_t* cells, const PaddedRow& beams, const PaddedRow& places, bool fresh) {
  std::uint8_t* const beam = tables_.beams_.data() + row_ * kPlaces;
  std::uint8_t* const place = tables_.next_.data() + row_ * kPlaces;
  const std::uint8_t *const beam_was = beams.cells(), *const place_was = places.cells();
  const std::uint8_t* const filled = filled_[layout_.half(row_)].data();
  const std::uint16_t* const first = at_.data() + kMargin;
  for (std::size_t k = 0, n = n_; k < n; ++k) {
    const std::uint32_t bit = cells[k];
    const auto b = static_cast<std::uint8_t>(fresh ? 0u - bit : beam_was[k] * 2u + bit);
    const auto p = static_cast<std::uint8_t>(fresh ? 0u - bit : place_was[k] * 2u + bit);
    for (std::size_t j = 0; j < filled[k]; ++j) {
      const std::size_t at = (first[k] + j) % kPlaces;
      beam[at] = b;
      place[at] = p;
    }
  }
}

}  // namespace lidarcodec
