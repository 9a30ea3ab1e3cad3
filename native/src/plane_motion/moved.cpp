#include "plane_motion/moved.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>

namespace lidarcodec {
namespace {

constexpr std::int64_t kNearest = 512;  // horizontal distance, in eighths, of points that are moved
constexpr std::int64_t kFull = 256;     // weight of a point in the middle of a cell
constexpr std::int64_t kLeastWeight = 8;
constexpr std::int32_t kMostWeight = 1 << 16;  // a cell takes no more then
constexpr std::size_t kRowBins = 1024;
constexpr int kColumnBinBits = 20;

// The change from one step to the next: a mean on a smooth surface, the smaller one at an edge, 0 beyond.
std::int64_t slope(std::int64_t one, bool has_one, std::int64_t other, bool has_other, std::int64_t limit) {
  std::int64_t found = has_one ? one : other;
  if (has_one && has_other) {
    if (std::abs(one - other) <= limit)
      found = (one + other) / 2;
    else if (std::abs(other) < std::abs(one))
      found = other;
  }
  return (has_one || has_other) && std::abs(found) <= 8 * limit ? found : 0;
}

}  // namespace

PlaneMover::PlaneMover(const PlaneBeams& beams, const PlaneColumns& before, const PlaneColumns& now)
    : rows_(beams.up.size()), beams_(beams), before_(before), now_(now), above_(rows_) {
  const std::int64_t step = before.step();
  for (std::size_t row = 0; row < rows_; ++row) {
    up_.push_back(cos_sin(static_cast<Angle>(beams.up[row]) << 12));
    aside_.push_back(cos_sin(static_cast<Angle>(beams.aside[row]) << 12));
    tan_.push_back(floor_divided(std::int64_t{up_[row].sin} * (1 << 24), up_[row].cos));
    if (row > 0)
      above_[row] = floor_divided((std::int64_t{beams.aside[row]} - beams.aside[row - 1]) * 4096 + step / 2, step);
  }
  for (std::size_t row = 0; row + 1 < rows_; ++row)
    per_gap_.push_back((std::int64_t{1} << 40) / (tan_[row] - tan_[row + 1]));
  for (std::size_t row = 0; row < rows_; ++row)
    per_gaps_.push_back(row == 0           ? per_gap_[0]
                        : row + 1 == rows_ ? per_gap_[row - 1]
                                           : (std::int64_t{1} << 41) / (tan_[row - 1] - tan_[row + 1]));
  for (const std::int64_t at : before.at) turned_.push_back(cos_sin(before.first + static_cast<Angle>(at)));

  per_tan_ = ((std::int64_t{1} << 40) * static_cast<std::int64_t>(kRowBins)) / (tan_[0] - tan_[rows_ - 1] + 1);
  first_row_.assign(kRowBins + 1, 0);
  for (const std::int64_t tan : tan_) ++first_row_[static_cast<std::size_t>(((tan_[0] - tan) * per_tan_) >> 40) + 1];
  for (std::size_t bin = 1; bin <= kRowBins; ++bin) first_row_[bin] += first_row_[bin - 1];

  const std::size_t columns = now.at.size();
  first_column_.assign((2 * kWholeTurn >> kColumnBinBits) + 1, 0);
  for (const std::int64_t at : now.at) ++first_column_[static_cast<std::size_t>(at >> kColumnBinBits) + 1];
  for (std::size_t bin = 1; bin < first_column_.size(); ++bin) first_column_[bin] += first_column_[bin - 1];
  for (std::size_t x = 0; x < columns; ++x) {
    const std::int64_t next = x + 1 < columns ? now.at[x + 1] : kWholeTurn, gap = next - now.at[x];
    column_gap_.push_back(gap > 0 && gap <= 3 * now.step() ? gap : 0);
    per_column_.push_back(column_gap_[x] > 0 ? (std::int64_t{1} << 40) / gap : 0);
  }
}

std::int64_t PlaneMover::inverse_at(std::size_t row, std::int64_t column) const {
  const auto columns = static_cast<std::int64_t>(before_.at.size());
  return column < 0 || column >= columns ? 0 : inverse_[row * before_.at.size() + static_cast<std::size_t>(column)];
}

std::int64_t PlaneMover::rise(std::size_t row, std::size_t column, std::int64_t here) const {
  const auto x = static_cast<std::int64_t>(column);
  const std::int64_t above = row > 0 ? inverse_at(row - 1, x + above_[row]) : 0;
  const std::int64_t below = row + 1 < rows_ ? inverse_at(row + 1, x - above_[row + 1]) : 0;
  const std::int64_t up = above > 0 ? ((above - here) * per_gap_[row - 1]) >> 16 : 0;
  const std::int64_t down = below > 0 ? ((here - below) * per_gap_[row]) >> 16 : 0;
  return slope(up, above > 0, down, below > 0, ((here >> 5) * per_gaps_[row]) >> 16);
}

std::int64_t PlaneMover::along(std::size_t row, std::size_t column, std::int64_t here) const {
  const auto x = static_cast<std::int64_t>(column);
  const std::int64_t left = inverse_at(row, x - 1), right = inverse_at(row, x + 1);
  return slope(here - left, left > 0, right - here, right > 0, here >> 5);
}

void PlaneMover::add(std::size_t cell, std::int64_t weight, std::int64_t inverse, const Surface& surface) {
  if (2 * inverse <= surface.inverse || inverse >= 2 * surface.inverse) return;
  Cell& of = cells_[cell];
  if (of.weight >= kMostWeight) return;
  if (of.weight > 0) {
    const std::int64_t off = inverse * of.weight - of.sum;
    if (32 * std::abs(off) > of.sum) {  // another surface: the nearer one hides it, but not with a corner of a cell
      if (weight <= 2 * of.weight && (off <= 0 || 2 * weight <= of.weight)) return;
      of = Cell();
    }
  }
  of.sum += weight * inverse;
  of.weight += static_cast<std::int32_t>(weight);
  if (weight > of.best) {
    of.best = static_cast<std::int32_t>(weight);
    of.source = surface.source;
  }
}

// at: angle from the first column.
void PlaneMover::place_at(std::size_t row, std::int64_t at, std::int64_t weight, const Surface& surface) {
  const std::size_t columns = now_.at.size();
  std::size_t next = first_column_[static_cast<std::size_t>(at >> kColumnBinBits)];
  while (next < columns && now_.at[next] <= at) ++next;
  const std::size_t column = next - 1;
  if (column_gap_[column] == 0) return;
  if (next == columns) next = 0;
  const std::int64_t part = ((at - now_.at[column]) * per_column_[column]) >> 32;
  if (part > kFull) return;  // beyond the end of a turn
  const std::int64_t risen = surface.inverse + ((surface.rise * (tan_[row] - surface.tan)) >> 24);
  const std::int64_t left = (weight * (kFull - part)) >> 8, right = (weight * part) >> 8;
  if (left >= kLeastWeight) add(row * columns + column, left, risen - ((surface.along * part) >> 8), surface);
  if (right >= kLeastWeight) add(row * columns + next, right, risen + ((surface.along * (kFull - part)) >> 8), surface);
}

void PlaneMover::place_in(std::size_t row, std::int64_t weight, const Surface& surface) {
  const std::int64_t at = surface.angle - (static_cast<Angle>(beams_.aside[row]) << 12) - now_.first;
  place_at(row, at, weight, surface);
  if (at + kWholeTurn <= now_.at.back()) place_at(row, at + kWholeTurn, weight, surface);
}

void PlaneMover::place(const Surface& surface) {
  const std::int64_t tan = surface.tan, last = tan_[rows_ - 1];
  if (tan > tan_[0]) {
    if (2 * (tan - tan_[0]) < tan_[0] - tan_[1]) place_in(0, kFull, surface);
    return;
  }
  if (tan < last) {
    if (2 * (last - tan) < tan_[rows_ - 2] - last) place_in(rows_ - 1, kFull, surface);
    return;
  }
  std::size_t below = first_row_[static_cast<std::size_t>(((tan_[0] - tan) * per_tan_) >> 40)];
  while (below < rows_ && tan_[below] >= tan) ++below;
  if (below == rows_) return place_in(rows_ - 1, kFull, surface);
  const std::int64_t part = ((tan - tan_[below]) * per_gap_[below - 1]) >> 32;
  if (part > 0) place_in(below - 1, part, surface);
  if (part < kFull) place_in(below, kFull - part, surface);
}

MovedPlane PlaneMover::move(const std::vector<std::int32_t>& mean, const PlaneMotion& motion, std::int32_t most) {
  const std::size_t width = before_.at.size(), columns = now_.at.size();
  inverse_.assign(mean.size(), 0);
  std::vector<std::int32_t> away(mean.size());
  for (std::size_t row = 0; row < rows_; ++row)
    for (std::size_t i = row * width; i < (row + 1) * width; ++i) {
      away[i] = static_cast<std::int32_t>(rounded30(std::int64_t{mean[i]} * up_[row].cos));
      // Exact: the quotient of whole numbers below 2^53 is rounded to no whole number that it is not.
      if (away[i] >= kNearest) inverse_[i] = static_cast<std::int32_t>(274'877'906'944.0 / away[i]);
    }

  cells_.assign(rows_ * columns, Cell());
  const std::array<std::int64_t, 9> turn = motion.rotation();
  const auto turned = [&](std::size_t axis, std::int64_t x, std::int64_t y, std::int64_t z) {
    const std::int64_t sum = turn[3 * axis] * x + turn[3 * axis + 1] * y + turn[3 * axis + 2] * z;
    return static_cast<std::int32_t>((sum + (1 << 23)) >> 24) + motion.shift[axis];
  };
  std::vector<std::int32_t> xs(width), ys(width), zs(width), from(width);
  std::vector<Angle> angles(width);
  for (std::size_t row = 0; row < rows_; ++row) {
    std::size_t count = 0;
    for (std::size_t column = 0; column < width; ++column) {
      const std::size_t cell = row * width + column;
      if (inverse_[cell] == 0 || before_.at[column] <= before_.at.back() - kWholeTurn) continue;
      const std::int64_t ahead = rounded30(std::int64_t{away[cell]} * aside_[row].cos),
                         beside = rounded30(std::int64_t{away[cell]} * aside_[row].sin);
      const std::int64_t x = rounded30(ahead * turned_[column].cos - beside * turned_[column].sin),
                         y = rounded30(ahead * turned_[column].sin + beside * turned_[column].cos),
                         z = rounded30(std::int64_t{mean[cell]} * up_[row].sin);
      xs[count] = turned(0, x, y, z);
      ys[count] = turned(1, x, y, z);
      zs[count] = turned(2, x, y, z);
      from[count++] = static_cast<std::int32_t>(column);
    }
    to_polar(xs.data(), ys.data(), angles.data(), count);
    for (std::size_t i = 0; i < count; ++i) {
      const std::int64_t distance = rounded30(xs[i] * kInverseCordicGain);
      if (distance < kNearest) continue;
      const auto column = static_cast<std::size_t>(from[i]);
      const std::size_t cell = row * width + column;
      const std::int64_t here = inverse_[cell];
      place({floor_divided(std::int64_t{zs[i]} * (1 << 24), distance), (std::int64_t{1} << 38) / distance,
             rise(row, column, here), along(row, column, here), angles[i], static_cast<std::int32_t>(cell)});
    }
  }

  MovedPlane moved;
  moved.source.resize(cells_.size());
  moved.mean.resize(cells_.size());
  for (std::size_t i = 0; i < cells_.size(); ++i) {
    const Cell& cell = cells_[i];
    moved.source[i] = cell.source;
    if (cell.source < 0) continue;
    const std::int64_t distance = (std::int64_t{cell.weight} << 38) / cell.sum;
    moved.mean[i] = static_cast<std::int32_t>(std::min<std::int64_t>((distance << 30) / up_[i / columns].cos, most));
  }
  return moved;
}

}  // namespace lidarcodec
