// Models of sensors beside the HDL-64E, as far as images and points need them: layouts of packets, directions and
// times. In Python lidarcodec/sensors/models, from which model_tables.cpp is written.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "base/bytes.hpp"

namespace lidarcodec {

// A series of numbers that packets of a layout have. bytes: of a number, 1, 2, 4 or 8; each: numbers in one packet.
struct SeriesPlan {
  std::string_view name;
  std::uint8_t bytes;
  std::uint32_t each;
};

// How packets of one size hold images. columns: of one packet; groups: of blocks that share one azimuth, in one packet;
// two_returns: whether they have a plane `range2`; column_ns: time of each column after the packet's own time stamp, of
// a Hesai.
struct PacketLayout {
  std::string_view name;
  std::size_t columns;
  std::size_t groups;
  bool two_returns;
  std::span<const SeriesPlan> series;
  std::span<const std::int32_t> column_ns;
};

// Numbers of a frame's packets, in their order.
struct Series {
  std::string name;
  std::uint8_t bytes = 1;  // of a number, 1, 2, 4 or 8
  std::vector<std::uint64_t> values;
};

// The series of that name. Raises Section if there is none.
const std::vector<std::uint64_t>& series_named(const std::vector<Series>& series, std::string_view name);

// Calibration values of each laser; docs/wire-format.md ("Calibration") has the rows and their units.
struct CalibrationTable {
  std::size_t lasers = 0;
  std::vector<std::int32_t> values;  // (11, lasers)

  std::int32_t at(std::size_t field, std::size_t laser) const { return values[field * lasers + laser]; }
};
inline constexpr std::size_t kCalibrationRows = 11, kRotationRow = 0, kElevationRow = 1, kDistanceRow = 2,
                             kHeightRow = 5, kAsideRow = 6;
inline constexpr double kAngleStep = 1e-8, kLengthStep = 1e-7;  // of calibration values: rad and m

// Directions and times of the cells of one frame.
class FrameGeometry {
 public:
  virtual ~FrameGeometry() = default;
  // x forward, y left, z up, in metres, of a range in steps of the sensor.
  virtual std::array<double, 3> point(std::size_t row, std::size_t column, std::uint32_t range) const = 0;
  // ns from the time stamp of the packet to the firing; negative: before it.
  virtual std::int64_t since_stamp_ns(std::size_t row, std::size_t column) const = 0;
};

// A model, or a unit that describes itself. It outlives what it gives.
class SensorFamily {
 public:
  virtual ~SensorFamily() = default;
  virtual std::size_t rows() const = 0;
  // Nothing if the sensor has no layout of that name.
  virtual const PacketLayout* layout(std::string_view name) const = 0;
  // (W,) direction of each column, 0.01 degree, 0 to 35999, clockwise. series: as the layout has them.
  virtual std::vector<std::uint16_t> azimuth(const PacketLayout& layout, const std::vector<Series>& series) const = 0;
  // Nothing where the directions of beams are not known. The table has a laser for each row.
  virtual std::unique_ptr<FrameGeometry> geometry(const PacketLayout& layout, const std::vector<Series>& series,
                                                  const CalibrationTable& table) const = 0;
};

inline constexpr std::uint16_t kAzimuthTurn = 36'000;

// Of packets that are carried, and have no images.
inline constexpr std::string_view kAnyPackets = "packets";

// Of point clouds, each of which is one message of a driver; their images are made of their points.
inline constexpr std::string_view kPointCloud = "pointcloud2";

// Whether there is a sensor of that name beside the HDL-64E, or kAnyPackets or kPointCloud.
bool is_known_model(std::string_view model);

// The family of a known model; nothing of kAnyPackets and kPointCloud. description: of an Ouster, its metadata;
// range_step: in 1e-7 m. Raises Section if the description is not that of such a sensor.
std::shared_ptr<const SensorFamily> family_of(std::string_view model, Bytes description, std::size_t rows,
                                              std::uint32_t range_step);

}  // namespace lidarcodec
