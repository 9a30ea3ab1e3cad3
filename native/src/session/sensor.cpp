#include "session/sensor.hpp"

#include <algorithm>
#include <numeric>

#include "base/sha256.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kFormHash = 0, kFormTable = 1, kFormPlainTable = 2;
constexpr std::size_t kHeadBytes = 6, kTableBytes = kCalibrationFields * kLasers * 4, kKept = 8;
constexpr std::size_t kRotation = 0, kVertical = 1, kDistance = 2, kVerticalOffset = 5, kHorizontalOffset = 6;
constexpr std::int64_t kMostLevel = 1000, kLengthsPerLevel = 20'000;

// Whether bytes are UTF-8 (RFC 3629): no surrogates, none longer than it has to be, none beyond U+10FFFF.
bool is_utf8(Bytes text) {
  for (std::size_t i = 0; i < text.size();) {
    const std::uint8_t first = text[i++];
    if (first < 0x80) continue;
    const std::size_t more = first >= 0xF0 ? 3 : first >= 0xE0 ? 2 : 1;
    if (first < 0xC2 || first > 0xF4 || text.size() - i < more) return false;
    std::uint32_t point = first & (0x3Fu >> more);
    for (std::size_t j = 0; j < more; ++j, ++i) {
      if ((text[i] & 0xC0) != 0x80) return false;
      point = point << 6 | (text[i] & 0x3Fu);
    }
    if (point > 0x10FFFF || (point >= 0xD800 && point < 0xE000) || (more == 2 && point < 0x800) ||
        (more == 3 && point < 0x10000))
      return false;
  }
  return true;
}

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
  if (const std::string called = hex(data.subspan(1, kHashBytes)); sensor->hash != called)
    throw Error(ErrorCode::Section, "a calibration with hash " + sensor->hash + " that calls itself " + called);
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
  const Bytes data = message.section(SectionType::Calibration);
  if (data.size() < 1 + kHashBytes || data[0] > kFormPlainTable)
    throw Error(ErrorCode::Section,
                "a calibration section of " + std::to_string(data.size()) + " bytes, or of an unknown form");
  const std::string name = hex(data.subspan(1, kHashBytes));
  auto found =
      std::find_if(known_.begin(), known_.end(), [&](const Known& known) { return known.sensor->hash == name; });
  Known used;
  if (found != known_.end()) used = *found;
  if (data[0] == kFormHash) {
    if (data.size() != 1 + kHashBytes)
      throw Error(ErrorCode::Section, std::to_string(data.size()) + " bytes for a calibration's hash");
    if (used.sensor == nullptr)
      throw Error(ErrorCode::Reference,
                  "frame " + std::to_string(message.frame_index) + " needs calibration " + name +
                      ", which no key frame has brought yet: ask for a key frame",
                  message.frame_index);
  } else if (used.sensor == nullptr || !std::equal(data.begin(), data.end(), used.data.begin(), used.data.end())) {
    used = {{data.begin(), data.end()}, read_sensor(data, outside)};
  }
  if (found != known_.end()) known_.erase(found);
  known_.push_back(used);
  if (known_.size() > kKept) known_.pop_front();
  return used.sensor;
}

}  // namespace lidarcodec
