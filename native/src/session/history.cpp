#include "session/history.hpp"

#include <algorithm>
#include <cstdlib>

#include "base/error.hpp"
#include "motion/warp.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kTurn = 36'000, kNumberBytes = 3;
constexpr std::int64_t kTurnUnit = 1 << 24, kMostTurn = 1 << 22, kMostShift = 320'000;

// Azimuth steps from the first column of the upper half to its last.
std::size_t swept(const Columns& columns) {
  std::size_t steps = 0;
  for (std::size_t c = 1; c < columns.width; ++c)
    steps += (kTurn + columns.azimuth[c] - columns.azimuth[c - 1]) % kTurn;
  return steps;
}

std::int64_t signed_number(const std::uint8_t* from) {
  const std::int32_t value = from[0] | from[1] << 8 | from[2] << 16;
  return value >= 1 << 23 ? value - (1 << 24) : value;
}

// (2 * turned * 2^30 + scale) / (2 * scale), rounded down. The dividend needs 80 bits, so ten bits come at a time.
std::int32_t rotation_part(std::int64_t turned, std::int64_t scale) {
  std::int64_t quotient = 0, rest = turned;
  for (int i = 0; i < 3; ++i) {
    const std::int64_t part = floor_divided(rest * 1024, scale);
    rest = rest * 1024 - part * scale;
    quotient = quotient * 1024 + part;
  }
  return static_cast<std::int32_t>(quotient + floor_divided(2 * rest + scale, 2 * scale));
}

Motion motion_of(const std::uint8_t* data) {
  std::array<std::int64_t, 3> h{}, shift{};
  for (std::size_t i = 0; i < 3; ++i) {
    h[i] = signed_number(data + kNumberBytes * i);
    shift[i] = signed_number(data + kNumberBytes * (3 + i));
    if (std::abs(h[i]) > kMostTurn || std::abs(shift[i]) > kMostShift)
      throw Error(ErrorCode::Section, "a motion beyond the limits");
  }
  const std::int64_t square = h[0] * h[0] + h[1] * h[1] + h[2] * h[2], scale = kTurnUnit * kTurnUnit + square;
  const std::array<std::int64_t, 9> spin = {0, -h[2], h[1], h[2], 0, -h[0], -h[1], h[0], 0};
  Motion motion;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      const std::int64_t part = 2 * (kTurnUnit * spin[3 * i + j] + h[i] * h[j] - (i == j ? square : 0));
      motion.rotation[3 * i + j] = rotation_part(part + (i == j ? scale : 0), scale);
    }
    motion.translation[i] = static_cast<std::int32_t>(shift[i]);
  }
  return motion;
}

// Columns `from` to the end of each row, behind those of another image.
template <class T>
std::vector<T> joined(const std::vector<T>& a, std::size_t a_width, const std::vector<T>& b, std::size_t b_width,
                      std::size_t rows) {
  std::vector<T> both;
  both.reserve(rows * (a_width + b_width));
  for (std::size_t r = 0; r < rows; ++r) {
    both.insert(both.end(), a.begin() + static_cast<std::ptrdiff_t>(r * a_width),
                a.begin() + static_cast<std::ptrdiff_t>((r + 1) * a_width));
    both.insert(both.end(), b.begin() + static_cast<std::ptrdiff_t>(r * b_width),
                b.begin() + static_cast<std::ptrdiff_t>((r + 1) * b_width));
  }
  return both;
}

template <class T>
std::vector<T> ending(const std::vector<T>& image, std::size_t width, std::size_t columns, std::size_t rows) {
  std::vector<T> end;
  end.reserve(rows * columns);
  for (std::size_t r = 0; r < rows; ++r)
    end.insert(end.end(), image.begin() + static_cast<std::ptrdiff_t>((r + 1) * width - columns),
               image.begin() + static_cast<std::ptrdiff_t>((r + 1) * width));
  return end;
}

}  // namespace

void MaskMemory::forget() {
  sent_.assign(sent_.size(), 0);
  waiting_.reset();
}

void MaskMemory::begin(const std::vector<std::uint8_t>& mask, const Columns& columns, const Halves& half) {
  waiting_ = {mask, {columns.azimuth, columns.azimuth + 2 * columns.width}, half, columns.width};
}

void MaskMemory::take_waiting() {
  if (!waiting_) return;
  sent_.assign(sent_.size(), 0);
  put(waiting_->mask, waiting_->width, waiting_->azimuth.data(), waiting_->half);
  waiting_.reset();
}

std::vector<std::uint8_t> MaskMemory::before(const Columns& columns, const Halves& half) {
  take_waiting();
  std::vector<std::uint8_t> cells(kRows * columns.width);
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::uint16_t* azimuth = columns.azimuth + half[row] * columns.width;
    for (std::size_t c = 0; c < columns.width; ++c)
      cells[row * columns.width + c] = sent_[row * kDirections + azimuth[c] / kStep];
  }
  return cells;
}

void MaskMemory::remember(const std::vector<std::uint8_t>& mask, const Columns& columns, const Halves& half) {
  take_waiting();
  put(mask, columns.width, columns.azimuth, half);
}

void MaskMemory::put(const std::vector<std::uint8_t>& mask, std::size_t width, const std::uint16_t* azimuth,
                     const Halves& half) {
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::uint16_t* at = azimuth + half[row] * width;
    for (std::size_t c = 0; c < width; ++c) sent_[row * kDirections + at[c] / kStep] = mask[row * width + c];
  }
}

Edge Edge::last(std::size_t columns) const {
  if (columns >= width) return *this;
  return {columns, ending(ranges, width, columns, kRows), ending(expected, width, columns, kRows),
          ending(fired, width, columns, 2)};
}

Edge Edge::and_then(const Edge& other) const {
  return {width + other.width, joined(ranges, width, other.ranges, other.width, kRows),
          joined(expected, width, other.expected, other.width, kRows),
          joined(fired, width, other.fired, other.width, 2)};
}

void StreamMemory::forget() {
  seen_.forget();
  waiting_.clear();
  edge_ = {};
  motion_.reset();
}

const Motion& StreamMemory::motion(const std::uint8_t* data, std::size_t size) {
  if (size == 6 * kNumberBytes) {
    motion_ = motion_of(data);
  } else if (size != 0) {
    throw Error(ErrorCode::Section, "a motion that is not 18 bytes");
  } else if (!motion_) {
    throw Error(ErrorCode::Section, "the motion is to be that of the frame before, which has none");
  }
  return *motion_;
}

std::vector<std::uint16_t> StreamMemory::expected(const Motion& motion, const Columns& columns,
                                                  const BeamTable& table) const {
  return expected_ranges(seen_, table, motion, columns);
}

Edge StreamMemory::edge(std::size_t columns) const {
  if (columns > edge_.width) throw Error(ErrorCode::Section, "a slab refers to more columns before it than are known");
  return edge_.last(columns);
}

void StreamMemory::remember(const std::vector<std::uint16_t>& ranges, const Columns& columns, const Halves& half,
                            bool slab) {
  waiting_.push_back({ranges,
                      {columns.azimuth, columns.azimuth + 2 * columns.width},
                      {columns.fired, columns.fired + 2 * columns.width},
                      half,
                      columns.width,
                      swept(columns)});
  std::size_t sweep = 0, wide = 0;
  for (const Sent& sent : waiting_) sweep += sent.swept, wide += sent.width;
  while (!waiting_.empty()) {
    const Sent& first = waiting_.front();
    sweep -= first.swept;
    wide -= first.width;
    if (slab && sweep < kWaitingSweep && wide < kWaitingColumns) break;
    seen_.remember(first.ranges.data(), {first.width, first.azimuth.data(), first.fired.data()}, first.half);
    waiting_.pop_front();
  }
}

}  // namespace lidarcodec
