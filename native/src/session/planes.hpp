// Sections that all codecs have beside ranges: intensities, pose, side information; and all planes of codec `raw`.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "planes/intensity_coder.hpp"
#include "session/message.hpp"
#include "session/outside.hpp"
#include "session/sensor.hpp"

namespace lidarcodec {

// A frame, W columns. Images are (64, W) or, of halves of columns, (2, W), row after row.
struct Planes {
  std::size_t width = 0;
  std::vector<std::uint16_t> range;     // (64, W), range steps; 0: no return
  std::vector<std::uint16_t> azimuth;   // (2, W), 0.01 degree, 0 to 35999
  std::vector<std::uint8_t> intensity;  // (64, W)
  std::vector<std::uint8_t> fired;      // (2, W), 0 or 1
  std::vector<std::uint8_t> returns;    // (64, W), 0 or 1

  bool any_return() const {
    return std::any_of(returns.begin(), returns.end(), [](std::uint8_t one) { return one != 0; });
  }
};

// An INTENSITY section; `sent` is false where a message has none. Raises Section.
struct IntensitySection {
  explicit IntensitySection(const Message& message);

  bool sent = false, modelled = false, few = false;  // few: values of the sensor were replaced by a few others
  Bytes of_returns;
  std::optional<Bytes> of_others;  // of the cells that fired without a return
};

// Intensities of the returns where they are modelled, (64, W), else zeros. Calls nothing from outside, so that a thread
// can do it. memory: what lossless intensities go on from; changed. Raises Section or Truncated.
std::vector<std::uint8_t> decode_modelled(const IntensitySection& section, const Sensor& sensor, const Planes& planes,
                                          IntensityMemory& memory);

// Adds to `intensity` what is not modelled: grouped returns, and cells without a return. Raises Section or Truncated.
void decode_other_intensities(const IntensitySection& section, const Outside& outside, const Sensor& sensor,
                              Planes& planes);

// T_world_sensor, the first three rows; nothing without a POSE section. Raises Section.
std::optional<std::array<double, 12>> decode_pose(const Message& message);

// Raises Section if packets or position packets are announced without side information, which is not looked into.
void check_side(const Message& message);

// Raises Section.
Planes decode_raw(const Message& message, const Sensor& sensor);

}  // namespace lidarcodec
