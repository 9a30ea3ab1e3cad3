// The proportion of one attribute to another at ranges of one class, learned on the way.
#pragma once
#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>

namespace lidarcodec {

// In steps of 2^-16.
struct Ratio {
  std::uint32_t value = 0;
  static constexpr std::int64_t kMost = 0x7FFFFFFF;

  std::int32_t times(std::int32_t mate, std::uint32_t other, std::int32_t most) const {
    const std::int64_t product = std::int64_t{mate} * (value != 0 ? value : other) + 32768;
    return static_cast<std::int32_t>(std::min<std::int64_t>(product >> 16, most));
  }
  void learn(std::int32_t of, std::int32_t mate, std::uint32_t& last) {
    if (mate < 4) return;
    const std::int64_t now = std::min(((std::int64_t{of} << 16) + mate / 2) / mate, kMost);
    value = static_cast<std::uint32_t>(value != 0 ? value + (now - std::int64_t{value}) / 4 : now);
    last = value;
  }
};

inline constexpr std::size_t kRatios = 320;

// 2^Bits classes an octave.
template <std::uint32_t Bits = 4>
std::size_t ratio_of(std::int32_t range) {
  constexpr std::uint32_t size = 1u << Bits;
  const auto x = static_cast<std::uint32_t>(range) + size;
  const auto above = static_cast<std::uint32_t>(std::bit_width(x)) - Bits - 1;
  return std::min<std::size_t>(size * above + (x >> above) - size, kRatios * size / 16 - 1);
}

}  // namespace lidarcodec
