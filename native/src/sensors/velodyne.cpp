// How a Velodyne turns while its lasers fire one after the other: lidarcodec/sensors/models/velodyne_packet.py and
// vls128.py. Arithmetic in float and rounding are as there, so that both give the same azimuths.
#include <algorithm>
#include <cmath>

#include "sensors/block_model.hpp"

namespace lidarcodec {
namespace {

constexpr double kEarlyShotUs = 8.0 / 3, kEarliestUs = 153, kLimitUs = 167, kHourStampUs = 7;
constexpr std::size_t kShotsPerColumn = 20, kCycleChannel = 32;  // of a VLS-128

std::int64_t turned(std::uint64_t before, std::uint64_t after) {
  const std::int64_t steps = (static_cast<std::int64_t>(after) - static_cast<std::int64_t>(before)) % kAzimuthTurn;
  return steps < 0 ? steps + kAzimuthTurn : steps;
}

// The middle number, or the mean of the two in the middle. There is at least one.
template <class Number>
Number median(std::vector<Number> values) {
  std::sort(values.begin(), values.end());
  const std::size_t half = values.size() / 2;
  return values.size() % 2 != 0 ? values[half] : (values[half - 1] + values[half]) / 2;
}

class Turning {
 public:
  Turning(const BlockModel& model, const PacketLayout& layout, const std::vector<Series>& series)
      : model_(model),
        layout_(layout),
        channels_(model.channels.size()),
        each_(layout.columns / layout.groups),
        azimuth_(series_named(series, "azimuth")) {
    const bool is_vls = model.kind == BlockKind::Vls128;
    timing_ = is_vls ? vls_timing(series_named(series, "time_us")) : usual_timing();
    speed_ = is_vls ? vls_speed() : usual_speed();
  }

  // Seconds from the packet's time stamp to the firing of a channel.
  float since_stamp(std::size_t column, std::size_t channel) const {
    return timing_[column % layout_.columns * channels_ + channel];
  }

  // Of a firing, 0.01 degree, 0 to 35999.
  std::uint16_t azimuth(std::size_t column, std::size_t channel) const {
    const std::size_t within = column % layout_.columns, packet = column / layout_.columns;
    const float since = since_stamp(within, channel) - since_stamp(within / each_ * each_, 0);
    const float angle = static_cast<float>(azimuth_[column / each_]) + speed_[packet] * since;
    const double steps = std::floor(static_cast<double>(angle + static_cast<float>(kAzimuthTurn)) + 0.5);
    const double once = steps - kAzimuthTurn * std::floor(steps / kAzimuthTurn);
    return once >= 0 && once < kAzimuthTurn ? static_cast<std::uint16_t>(once) : 0;
  }
  std::size_t columns() const { return azimuth_.size() * each_; }

 private:
  std::vector<float> usual_timing() const {
    std::vector<float> timing;
    for (std::size_t column = 0; column < layout_.columns; ++column)
      for (std::size_t channel = 0; channel < channels_; ++channel)
        timing.push_back(static_cast<float>(model_.cycle_us * 1e-6 * static_cast<double>(column) +
                                            model_.shot_us * 1e-6 * static_cast<double>(channel / model_.together)));
    return timing;
  }

  // Of 0.01 degree a second: from each packet's first block to its last one.
  std::vector<float> usual_speed() const {
    const float duration = since_stamp((layout_.groups - 1) * each_, 0) - since_stamp(0, 0);
    std::vector<float> speed;
    for (std::size_t at = 0; at < azimuth_.size(); at += layout_.groups)
      speed.push_back(static_cast<float>(turned(azimuth_[at], azimuth_[at + layout_.groups - 1])) / duration);
    return speed;
  }

  // A firing of eight lasers takes less time with early firmware, whose packets come faster.
  std::vector<float> vls_timing(const std::vector<std::uint64_t>& stamps_us) const {
    std::vector<double> between;
    for (std::size_t i = 1; i < stamps_us.size(); ++i)
      between.push_back(
          static_cast<double>(static_cast<std::int64_t>(stamps_us[i]) - static_cast<std::int64_t>(stamps_us[i - 1])));
    const double usual = between.empty() ? 0 : median(between) * 3 / static_cast<double>(layout_.columns);
    const bool early = usual >= kEarliestUs && usual < kLimitUs;
    std::vector<float> timing;
    for (std::size_t column = 0; column < layout_.columns; ++column)
      for (std::size_t channel = 0; channel < channels_; ++channel) {
        const auto shots = static_cast<double>(kShotsPerColumn * column + channel / 8 + 2 * (channel / 64));
        const auto usually = static_cast<float>(shots * (model_.shot_us * 1e-6) - kHourStampUs * 1e-6);
        timing.push_back(early ? usually * static_cast<float>(kEarlyShotUs / model_.shot_us) : usually);
      }
    return timing;
  }

  // From the packet before to this one; a speed of more than 1.8 times the median is a gap, and becomes the median.
  std::vector<float> vls_speed() const {
    const std::size_t columns = layout_.columns, packets = azimuth_.size() / columns;
    float cycle = (since_stamp(0, kCycleChannel) - since_stamp(0, 0)) / 4 * static_cast<float>(kShotsPerColumn);
    if (columns > 1) cycle = since_stamp(1, 0) - since_stamp(0, 0);
    std::vector<float> speed(packets);
    for (std::size_t packet = 1; packet < packets; ++packet)
      speed[packet] = static_cast<float>(turned(azimuth_[(packet - 1) * columns], azimuth_[packet * columns])) /
                      (cycle * static_cast<float>(columns));
    if (packets > 1) {
      const float usual = median(std::vector<float>(speed.begin() + 1, speed.end()));
      for (float& one : speed)
        if (one > 1.8f * usual) one = usual;
      speed[0] = speed[1];
    } else if (packets == 1 && columns > 1) {
      speed[0] = static_cast<float>(turned(azimuth_[0], azimuth_[1])) / cycle;
    }
    return speed;
  }

  const BlockModel& model_;
  const PacketLayout& layout_;
  std::size_t channels_, each_;  // each: columns of a group of blocks
  std::vector<std::uint64_t> azimuth_;
  std::vector<float> timing_, speed_;  // (columns of a packet, channels), s; of each packet
};

class VelodyneGeometry final : public FrameGeometry {
 public:
  VelodyneGeometry(const BlockModel& model, const PacketLayout& layout, const std::vector<Series>& series,
                   const CalibrationTable& table)
      : model_(model), turning_(model, layout, series), beams_(model, table) {}
  std::array<double, 3> point(std::size_t row, std::size_t column, std::uint32_t range) const override {
    return beams_.point(row, turning_.azimuth(column, model_.channels[row]), range);
  }
  std::int64_t since_stamp_ns(std::size_t row, std::size_t column) const override {
    const double seconds = turning_.since_stamp(column, model_.channels[row]);
    return static_cast<std::int64_t>(std::nearbyint(seconds * 1e9));
  }

 private:
  const BlockModel& model_;
  Turning turning_;
  Beams beams_;
};

}  // namespace

std::unique_ptr<FrameGeometry> velodyne_geometry(const BlockModel& model, const PacketLayout& layout,
                                                 const std::vector<Series>& series, const CalibrationTable& table) {
  return std::make_unique<VelodyneGeometry>(model, layout, series, table);
}

std::vector<std::uint16_t> velodyne_azimuth(const BlockModel& model, const PacketLayout& layout,
                                            const std::vector<Series>& series) {
  const Turning turning(model, layout, series);
  std::vector<std::uint16_t> found(turning.columns());
  for (std::size_t column = 0; column < found.size(); ++column) found[column] = turning.azimuth(column, 0);
  return found;
}

}  // namespace lidarcodec
