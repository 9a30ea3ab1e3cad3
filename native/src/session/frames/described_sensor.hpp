// Form 3 of the CALIBRATION section: sensors beside the HDL-64E (docs/wire-format.md, "Calibration"); written
// by lidarcodec/planes/other_calibrations.py.
#pragma once
#include "sensors/model.hpp"
#include "session/calibration_book.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

struct DescribedSensor {
  std::string name, model;
  std::string hash;                       // 16 hex digits that name sensor, table and description
  std::uint8_t convention = 0;            // 0 `ros`, 1 `veloview`
  std::uint32_t range_step = 0;           // of one range unit, 1e-7 m
  std::vector<std::uint8_t> description;  // what the sensor says of itself
  CalibrationTable table;
  std::vector<std::uint8_t> laser;             // of each row
  std::shared_ptr<const SensorFamily> family;  // nothing if its packets are only carried

  std::size_t rows() const { return table.lasers; }
};

class DescribedSensorBook {
 public:
  // The sensor of a message. Raises Section, or Reference if it names one that no key message described.
  std::shared_ptr<const DescribedSensor> of(const Message& message, const Outside& outside);

 private:
  CalibrationBook<DescribedSensor> known_;
};

}  // namespace lidarcodec
