#include "session/sensor.hpp"

#include <algorithm>
#include <numeric>

#include "base/sha256.hpp"
#include "base/utf8.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kFormTable = 1, kFormPlainTable = 2;
constexpr std::size_t kHeadBytes = 6, kTableBytes = kCalibrationFields * kLasers * 4;
constexpr std::size_t kRotation = 0, kVertical = 1, kDistance = 2, kVerticalOffset = 5, kHorizontalOffset = 6;
constexpr std::int64_t kMostLevel = 1000, kLengthsPerLevel = 20'000;

void arrange_rows(Sensor& sensor) {
  const auto of_laser = [&](std::size_t field, std::size_t laser) { return sensor.table[field * kLasers + laser]; };
  std::iota(sensor.laser.begin(), sensor.laser.end(), std::uint8_t{0});
  std::stable_sort(sensor.laser.begin(), sensor.laser.end(),
                   [&](std::uint8_t a, std::uint8_t b) { return of_laser(kVertical, a) > of_laser(kVertical, b); });
  std::int64_t nearest = sensor.value(kDistance, 0), furthest = nearest;
  for (std::size_t r = 0; r < kRows; ++r) {
    sensor.beams.half[r] = sensor.laser[r] >= kLowerLasers;
    sensor.beams.rotation[r] = sensor.value(kRotation, r);
    sensor.beams.vertical[r] = sensor.value(kVertical, r);
    sensor.beams.distance[r] = sensor.value(kDistance, r);
    sensor.beams.vertical_offset[r] = sensor.value(kVerticalOffset, r);
    sensor.beams.horizontal_offset[r] = sensor.value(kHorizontalOffset, r);
    nearest = std::min<std::int64_t>(nearest, sensor.beams.distance[r]);
    furthest = std::max<std::int64_t>(furthest, sensor.beams.distance[r]);
  }
  const auto level = [&](std::int64_t distance) {
    return (distance - nearest + kLengthsPerLevel / 2) / kLengthsPerLevel;
  };
  if (level(furthest) > kMostLevel) return;  // then they are no corrections
  for (std::size_t r = 0; r < kRows; ++r) sensor.level[r] = static_cast<std::int32_t>(level(sensor.beams.distance[r]));
}

std::shared_ptr<const Sensor> read_sensor(Bytes data, const Outside& outside) {
  const std::size_t at = 1 + kHashBytes;
  if (data.size() < at + kHeadBytes)
    throw Error(ErrorCode::Section,
                "a calibration section of " + std::to_string(data.size()) + " bytes ends within its head");
  auto sensor = std::make_shared<Sensor>();
  sensor->convention = data[at];
  sensor->range_step = static_cast<std::uint32_t>(little_endian(data, at + 1, 4));
  if (sensor->convention > 1 || sensor->range_step == 0)
    throw Error(ErrorCode::Section, "calibration of unknown convention " + std::to_string(data[at]) +
                                        " or range step " + std::to_string(sensor->range_step));
  const Bytes rest = data.subspan(at + kHeadBytes);
  const Bytes name = rest.first(std::min<std::size_t>(data[at + 5], rest.size()));
  if (!is_utf8(name)) throw Error(ErrorCode::Section, "a sensor name that is not UTF-8");
  sensor->name.assign(name.begin(), name.end());
  const Bytes coded = rest.subspan(name.size());
  std::vector<std::uint8_t> hashed(name.begin(), name.end());
  hashed.push_back(0);
  if (data[0] == kFormTable) {
    const std::vector<std::uint8_t> table = zstd_frame(outside, coded, kTableBytes);
    hashed.insert(hashed.end(), table.begin(), table.end());
  } else {
    if (coded.size() != kTableBytes)
      throw Error(ErrorCode::Section, "a calibration table of " + std::to_string(coded.size()) + " bytes, not " +
                                          std::to_string(kTableBytes));
    hashed.insert(hashed.end(), coded.begin(), coded.end());
  }
  const Bytes table = Bytes(hashed).subspan(name.size() + 1);
  for (std::size_t i = 0; i < sensor->table.size(); ++i)
    sensor->table[i] = static_cast<std::int32_t>(little_endian(table, 4 * i, 4));
  sensor->hash = hex(Bytes(sha256(hashed)).first(kHashBytes));
  arrange_rows(*sensor);
  return sensor;
}

}  // namespace

MaskGeometry Sensor::geometry(std::size_t width, const std::uint8_t* fired) const {
  MaskGeometry geometry;
  geometry.width = width;
  geometry.fired = fired;
  for (std::size_t r = 0; r < kRows; ++r) {
    geometry.half[r] = beams.half[r];
    geometry.rotation[r] = beams.rotation[r];
  }
  return geometry;
}

std::shared_ptr<const Sensor> SensorBook::of(const Message& message, const Outside& outside) {
  return known_.of(
      message, [](std::uint8_t form) { return form <= kFormPlainTable; },
      [&](Bytes data) { return read_sensor(data, outside); });
}

}  // namespace lidarcodec
