// The proportion of one attribute to another, its mate, learned on the way. Signal and reflectivity are an example: the
// sensor computes one from the other by the range, in whole numbers.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

// number = (mate + 1/2) * proportion(range) * factor(mate, range) * factor(row): a half, because sensors round down.
// The proportion is a line between points, 16 an octave of ranges. The factor by mate and octave is for scales that
// are not even at their upper end.
class Proportion {
 public:
  // The number that fits; most: the largest one. `learn` may follow.
  std::int32_t of(std::int32_t mate, std::int32_t range, std::int32_t most) {
    const auto x = static_cast<std::uint32_t>(range) + kPoints;
    const auto octave = static_cast<std::uint32_t>(std::bit_width(x)) - kPointBits - 1;
    point_ = &points_[kPoints * octave + (x >> octave) - kPoints];
    part_ = static_cast<std::int64_t>(((x & ((1u << octave) - 1)) << 8) >> octave);
    const std::int64_t first = point_[0].count > 0 ? point_[0].value : point_[1].count > 0 ? point_[1].value : last_;
    const std::int64_t second = point_[1].count > 0 ? point_[1].value : first;
    at_range_ = (first * (256 - part_) + second * part_) >> 8;
    expected_ = std::min((at_range_ * (2 * mate + 1)) >> 1, kMostExpected);
    factor_ = nullptr;
    if (mate >= kFirstUneven && mate < kEndUneven) {
      factor_ = &factors_[static_cast<std::size_t>(mate - kFirstUneven) * kOctaves + octave];
      expected_ = (expected_ * *factor_) >> 12;
    }
    expected_ = (expected_ * row_) >> 14;
    return static_cast<std::int32_t>(std::min<std::int64_t>((expected_ + 32768) >> 16, most));
  }

  // Learns from the number that there was where `of` was asked last.
  void learn(std::int32_t number, std::int32_t mate) {
    if (mate == 0) return;
    const std::int64_t off = std::clamp<std::int64_t>(
        (std::int64_t{number} << 28) / std::max<std::int64_t>(expected_, 4096) - 4096, -3500, 32768);
    learn(point_[0], 256 - part_, off);
    learn(point_[1], part_, off);
    last_ = point_[point_[0].count > 0 ? 0 : 1].value;
    if (factor_ != nullptr) *factor_ = std::clamp<std::int64_t>(*factor_ + ((*factor_ * off) >> 14), 64, 65536);
    ++cells_;
    const int slow = cells_ <= 32 ? 5 : cells_ <= 96 ? 6 : 7;
    row_ = std::clamp<std::int64_t>(row_ + ((row_ * std::clamp<std::int64_t>(off, -512, 512)) >> (12 + slow)), 4096,
                                    65536);
  }

  // A row begins: the factor of the row changes faster for a while.
  void next_row() { cells_ = 0; }

 private:
  struct Point {
    std::int64_t value = 0;  // in steps of 2^-16
    int count = 0;           // of numbers close to it, up to 4
  };
  static constexpr std::uint32_t kPointBits = 4, kPoints = 1u << kPointBits, kOctaves = 18;
  static constexpr std::int32_t kFirstUneven = 64, kEndUneven = 256;  // mates that have factors
  static constexpr std::int64_t kMostValue = 1 << 30, kMostExpected = std::int64_t{1} << 40;

  // off: how far the number was off the expected one, in 4096ths of that.
  void learn(Point& point, std::int64_t part, std::int64_t off) const {
    if (point.count == 0) {
      if (part < 64) return;
      point = {std::clamp<std::int64_t>(at_range_ + ((at_range_ * off) >> 12), 1, kMostValue), 1};
      return;
    }
    const std::int64_t by = (point.value * off * part) >> (20 + std::bit_width(static_cast<unsigned>(point.count)));
    point.value = std::clamp<std::int64_t>(point.value + by, 1, kMostValue);
    if (part >= 128) point.count = std::min(point.count + 1, 4);
  }

  std::vector<Point> points_ = std::vector<Point>(kPoints * kOctaves + 1);
  std::vector<std::int64_t> factors_ = std::vector<std::int64_t>((kEndUneven - kFirstUneven) * kOctaves, 4096);
  std::int64_t last_ = 1 << 16, row_ = 1 << 14;
  int cells_ = 0;  // of the row

  // Where `of` was asked last.
  Point* point_ = nullptr;
  std::int64_t* factor_ = nullptr;
  std::int64_t part_ = 0, at_range_ = 0, expected_ = 0;
};

}  // namespace lidarcodec
