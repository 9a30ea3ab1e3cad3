// The CALIBRATION section: the whole table in key messages, its hash in all others (docs/wire-format.md,
// "Calibration").
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <string>

#include "mask/coder.hpp"
#include "motion/beams.hpp"
#include "session/calibration_book.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

inline constexpr std::size_t kCalibrationFields = 11, kLasers = 64, kLowerLasers = 32;

struct Sensor {
  std::string name;
  std::string hash;              // 16 hex digits that name sensor and table
  std::uint8_t convention = 0;   // 0 `ros`, 1 `veloview`
  std::uint32_t range_step = 0;  // of one range unit, 1e-7 m
  std::array<std::int32_t, kCalibrationFields * kLasers>
      table{};                              // a row a value, a column a laser; docs/wire-format.md has the units
  std::array<std::uint8_t, kRows> laser{};  // of each row of an image
  BeamTable beams;                          // of each row
  std::array<std::int32_t, kRows> level{};  // range steps that are added to each row, so that all are on one scale

  std::int32_t value(std::size_t field, std::size_t row) const { return table[field * kLasers + laser[row]]; }
  MaskGeometry geometry(std::size_t width, const std::uint8_t* fired) const;
};

// HDL-64Es that a stream described.
class SensorBook {
 public:
  // That of a message. Raises Section, or Reference if it names one that no key message described.
  std::shared_ptr<const Sensor> of(const Message& message, const Outside& outside);

 private:
  CalibrationBook<Sensor> known_;
};

}  // namespace lidarcodec
