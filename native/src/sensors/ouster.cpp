#include "sensors/ouster.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace lidarcodec {
namespace {

constexpr std::size_t kEnds = 32;                            // bytes of a head, and of a tail
constexpr std::uint32_t kFreeStandard = 39, kFreeFusa = 38;  // bytes of head and tail that have no name

std::string lower(std::string_view words) {
  std::string made(words);
  for (char& one : made)
    if (one >= 'A' && one <= 'Z') one = static_cast<char>(one - 'A' + 'a');
  return made;
}

// Series of the packets: a number a column, then a number a packet.
std::vector<SeriesPlan> series_of(const OusterPackets& packets) {
  const auto each = static_cast<std::uint32_t>(packets.columns);
  if (packets.profile == kLegacyProfile)
    return {{"time_ns", 8, each},
            {"measurement_id", 2, each},
            {"frame_id", 2, each},
            {"encoder", 4, each},
            {"status", 4, each}};
  const bool fusa = packets.fusa_head;
  return {{"time_ns", 8, each},
          {"measurement_id", 2, each},
          {"status", 2, each},
          {"packet_type", static_cast<std::uint8_t>(fusa ? 1 : 2), 1},
          {"frame_id", static_cast<std::uint8_t>(fusa ? 4 : 2), 1},
          {"init_id", 4, 1},
          {"serial", 8, 1},
          {"alert_flags", 1, 1},
          {"thermal_countdown", 1, 1},
          {"shot_limiting_countdown", 1, 1},
          {"thermal_shutdown", 1, 1},
          {"shot_limiting", 1, 1},
          {"crc", 8, 1},
          {"reserved", 1, fusa ? kFreeFusa : kFreeStandard}};
}

// The formula is at the top of lidarcodec/sensors/models/ouster/sensor.py.
class OusterGeometry final : public FrameGeometry {
 public:
  OusterGeometry(const OusterMetadata& metadata, double step_mm, const std::vector<Series>& series)
      : step_mm_(step_mm),
        each_(metadata.packets.columns),
        stamps_(series_named(series, "time_ns")),
        ids_(series_named(series, "measurement_id")) {
    const auto turn = [&](std::size_t axis, std::size_t of) { return metadata.lidar_to_sensor[4 * axis + of]; };
    const double x = metadata.beam_to_lidar[3], z = metadata.beam_to_lidar[11];
    from_axis_ = std::hypot(x, z);
    per_id_ = -2 * std::numbers::pi / static_cast<double>(metadata.turn_columns);
    for (std::size_t axis = 0; axis < 3; ++axis)
      origin_[axis] = {turn(axis, 0) * x, turn(axis, 1) * x, turn(axis, 2) * z + turn(axis, 3)};
    for (std::size_t row = 0; row < metadata.altitude_deg.size(); ++row) {
      const double up = metadata.altitude_deg[row] * std::numbers::pi / 180,
                   aside = metadata.azimuth_deg[row] * std::numbers::pi / 180;
      const double flat = std::cos(up), cos = std::cos(aside), sin = std::sin(aside);
      std::array<std::array<double, 3>, 3>& of = directions_.emplace_back();
      for (std::size_t axis = 0; axis < 3; ++axis)
        of[axis] = {turn(axis, 0) * flat * cos - turn(axis, 1) * flat * sin,
                    turn(axis, 0) * flat * sin + turn(axis, 1) * flat * cos, turn(axis, 2) * std::sin(up)};
    }
  }

  std::array<double, 3> point(std::size_t row, std::size_t column, std::uint32_t range) const override {
    const double encoder = static_cast<double>(ids_[column]) * per_id_;
    const double cos = std::cos(encoder), sin = std::sin(encoder), along = range * step_mm_ - from_axis_;
    const auto times = [&](const std::array<double, 3>& of) { return of[0] * cos + of[1] * sin + of[2]; };
    std::array<double, 3> point;
    for (std::size_t axis = 0; axis < 3; ++axis)
      point[axis] = (along * times(directions_[row][axis]) + times(origin_[axis])) * 1e-3;
    return point;
  }
  std::int64_t since_stamp_ns(std::size_t, std::size_t column) const override {
    return static_cast<std::int64_t>(stamps_[column] - stamps_[column / each_ * each_]);
  }

 private:
  double step_mm_, from_axis_ = 0, per_id_ = 0;
  std::size_t each_;
  std::vector<std::uint64_t> stamps_, ids_;
  // Of x, y and z: factors of cos e, sin e and 1, e the angle of the encoder.
  std::array<std::array<double, 3>, 3> origin_{};
  std::vector<std::array<std::array<double, 3>, 3>> directions_;
};

class OusterFamily final : public SensorFamily {
 public:
  OusterFamily(const OusterPackets& packets, std::optional<OusterMetadata> metadata)
      : packets_(packets), metadata_(std::move(metadata)), series_(series_of(packets)) {
    name_ = lower(profile().name);
    if (packets.fusa_head != (packets.profile == kFusaProfile))
      name_ += packets.fusa_head ? "_head_fusa" : "_head_standard";
    layout_ = {name_, packets.columns, packets.columns, profile().two_returns, series_, {}};
  }

  std::size_t rows() const override { return packets_.rows; }
  const PacketLayout* layout(std::string_view name) const override { return name == name_ ? &layout_ : nullptr; }

  std::vector<std::uint16_t> azimuth(const PacketLayout&, const std::vector<Series>& series) const override {
    const std::vector<std::uint64_t>& ids = series_named(series, "measurement_id");
    const auto [columns, forward] = turn_of(ids);
    std::vector<std::uint16_t> found;
    for (const std::uint64_t id : ids) {
      const auto turned = static_cast<std::int64_t>((id % columns * kAzimuthTurn + columns / 2) / columns);
      const std::int64_t once = (turned - forward) % kAzimuthTurn;
      found.push_back(static_cast<std::uint16_t>(once < 0 ? once + kAzimuthTurn : once));
    }
    return found;
  }

  std::unique_ptr<FrameGeometry> geometry(const PacketLayout&, const std::vector<Series>& series,
                                          const CalibrationTable&) const override {
    if (!metadata_) return nullptr;
    return std::make_unique<OusterGeometry>(*metadata_, profile().coarse ? 8 : 1, series);
  }

 private:
  const OusterProfile& profile() const { return kOusterProfiles[packets_.profile]; }

  // Columns of a turn, and the azimuth that is forward.
  std::pair<std::size_t, std::int64_t> turn_of(const std::vector<std::uint64_t>& ids) const {
    if (metadata_) {
      const double turned = std::atan2(metadata_->lidar_to_sensor[4], metadata_->lidar_to_sensor[0]);
      return {metadata_->turn_columns,
              static_cast<std::int64_t>(std::nearbyint(turned * 180 / std::numbers::pi * 100))};
    }
    std::uint64_t most = 0;
    for (const std::uint64_t id : ids) most = std::max(most, id);
    const auto fits = std::find_if(kOusterTurns.begin(), kOusterTurns.end(), [&](std::size_t n) { return n > most; });
    return {fits == kOusterTurns.end() ? kOusterTurns.back() : *fits, kAzimuthTurn / 2};
  }

  OusterPackets packets_;
  std::optional<OusterMetadata> metadata_;
  std::vector<SeriesPlan> series_;
  std::string name_;
  PacketLayout layout_;
};

}  // namespace

std::size_t OusterPackets::bytes() const {
  const bool legacy = profile == kLegacyProfile;
  const std::size_t column = (legacy ? 20 : 12) + rows * 4 * kOusterProfiles[profile].words;
  return (legacy ? 0 : 2 * kEnds) + columns * column;
}

std::shared_ptr<const SensorFamily> ouster_family(const OusterPackets& packets,
                                                  std::optional<OusterMetadata> metadata) {
  return std::make_shared<OusterFamily>(packets, std::move(metadata));
}

}  // namespace lidarcodec
