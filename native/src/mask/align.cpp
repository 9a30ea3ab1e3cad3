#include "mask/align.hpp"

#include <cstring>
#include <limits>

namespace lidarcodec {
namespace {

// The Hamming distance of n cells of 0 or 1. Eight bytes at a time; after 255 steps a byte of the sum may be full.
std::size_t hamming_distance(const std::uint8_t* a, const std::uint8_t* b, std::ptrdiff_t n) {
  std::size_t total = 0;
  while (n >= 8) {
    std::uint64_t lanes = 0;
    for (int i = 0; i < 255 && n >= 8; ++i, a += 8, b += 8, n -= 8) {
      std::uint64_t x, y;
      std::memcpy(&x, a, 8);
      std::memcpy(&y, b, 8);
      lanes += x ^ y;
    }
    for (; lanes != 0; lanes >>= 8) total += lanes & 0xFF;
  }
  for (; n > 0; --n) total += *a++ != *b++;
  return total;
}

// The Hamming distance of a[k] from b[k + shift] where both exist. Of the other cells every eighth counts as different.
std::size_t shifted_distance(const std::uint8_t* a, std::ptrdiff_t na, const std::uint8_t* b, std::ptrdiff_t nb,
                             std::ptrdiff_t shift) {
  const std::ptrdiff_t begin = std::clamp<std::ptrdiff_t>(-shift, 0, na);
  const std::ptrdiff_t end = std::clamp<std::ptrdiff_t>(nb - shift, begin, na);
  const std::size_t outside = static_cast<std::size_t>(na - (end - begin)) / 8;
  return outside + (end > begin ? hamming_distance(a + begin, b + begin + shift, end - begin) : 0);
}

class Minimum {
 public:
  // Of equal costs the first one is kept.
  void offer(std::int64_t value, std::size_t cost) {
    if (cost < cost_) {
      cost_ = cost;
      value_ = value;
    }
  }
  std::int64_t value() const { return value_; }
  std::size_t cost() const { return cost_; }

 private:
  std::int64_t value_ = 0;
  std::size_t cost_ = std::numeric_limits<std::size_t>::max();
};

}  // namespace

std::size_t unlike_above(const MaskLayout& layout, const std::uint8_t* rows, std::size_t width, std::uint32_t turn) {
  std::size_t sum = 0;
  for (std::size_t row = 2; row < kMaskRows; row += 4) {
    if (layout.half(row) != layout.half(row - 1)) continue;
    const auto n = static_cast<std::ptrdiff_t>(layout.cells(row));
    sum += shifted_distance(rows + row * width, n, rows + (row - 1) * width, n, layout.shift(row - 1, row, turn));
  }
  return sum;
}

std::uint32_t find_turn(const MaskLayout& layout, const std::uint8_t* rows, std::size_t width) {
  const auto cost = [&](std::int64_t turn) {
    return unlike_above(layout, rows, width, static_cast<std::uint32_t>(turn));
  };
  // Near the true turn the distance depends on the scene more than on the turn. So the nominal turn stays unless
  // another one is better by an eighth.
  Minimum coarse;
  coarse.offer(kNominalTurn, cost(kNominalTurn) / 8 * 7);
  for (std::int64_t turn = 960; turn < 9000; turn += turn / 20) coarse.offer(turn, cost(turn));
  if (coarse.value() == kNominalTurn) return kNominalTurn;
  Minimum fine;
  for (int step = -5; step <= 5; ++step) {
    const std::int64_t turn = coarse.value() + step * coarse.value() / 200;
    fine.offer(turn, cost(turn));
  }
  return static_cast<std::uint32_t>(fine.value());
}

EarlierShift find_earlier(const std::uint8_t* mask, std::size_t width, const EarlierMask& earlier) {
  const auto cost = [&](std::int64_t shift) {
    std::size_t sum = 0;
    for (std::size_t row = 2; row < kMaskRows; row += 4) {
      sum += shifted_distance(mask + row * width, static_cast<std::ptrdiff_t>(width),
                              earlier.cells + row * earlier.width, static_cast<std::ptrdiff_t>(earlier.width), shift);
    }
    return sum;
  };
  Minimum coarse;
  coarse.offer(0, cost(0));
  for (std::int64_t shift = -128; shift <= 128; shift += 4) coarse.offer(shift, cost(shift));
  Minimum fine;
  fine.offer(coarse.value(), cost(coarse.value()));
  for (std::int64_t step = 1; step <= 3; ++step) {
    fine.offer(coarse.value() - step, cost(coarse.value() - step));
    fine.offer(coarse.value() + step, cost(coarse.value() + step));
  }
  return {static_cast<std::int32_t>(fine.value()), fine.cost()};
}

}  // namespace lidarcodec
