// What a stream sent last in each direction of each row: the intensities of the turn before, but for what was sent
// since. MaskMemory (session/history.hpp) is the same for masks.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"
#include "planes/intensity_symbols.hpp"

namespace lidarcodec {

class IntensityTurn {
 public:
  static constexpr std::uint16_t kNothing = 0x100;

  // The direction of an azimuth below 36000, 0 to 1999.
  static std::uint16_t direction(std::uint16_t azimuth) {
    return static_cast<std::uint16_t>(azimuth / kStep % kDirections);
  }

  // The class of what was sent around a direction, 1 to 16; 0 if nothing was. The direction itself counts twice.
  std::uint8_t before(std::size_t row, std::size_t direction, const Symbols& symbols) const {
    if (values_.empty()) return 0;
    const std::uint16_t* const of_row = values_.data() + row * kDirections;
    const std::uint16_t here = of_row[direction];
    const std::uint16_t left = of_row[direction == 0 ? kDirections - 1 : direction - 1];
    const std::uint16_t right = of_row[direction == kDirections - 1 ? 0 : direction + 1];
    const auto known = [&](std::uint16_t value) { return value == kNothing ? 0u : 1u; };
    const auto symbol = [&](std::uint16_t value) -> std::uint32_t {
      return value == kNothing ? 0 : symbols.of_value[value];
    };
    const std::uint32_t weights = 2 * known(here) + known(left) + known(right);
    const std::uint32_t sum = 2 * symbol(here) + symbol(left) + symbol(right);
    if (weights == 0) return 0;
    const std::uint32_t mean = weights == 4 ? sum / 4 : sum / weights;  // mostly 4, and quicker
    return static_cast<std::uint8_t>(1 + symbols.mass_class[mean] / 3);
  }

  // value: of a return, or kNothing.
  void remember(std::size_t row, std::size_t direction, std::uint16_t value) {
    if (values_.empty()) values_.assign(kMaskRows * kDirections, kNothing);
    values_[row * kDirections + direction] = value;
  }

 private:
  static constexpr std::size_t kDirections = 2000, kStep = 18;  // of 0.01 degree

  std::vector<std::uint16_t> values_;  // (64, 2000); empty before anything was sent
};

}  // namespace lidarcodec
