#include "sensors/block_model.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace lidarcodec {
namespace {

std::uint16_t turned_once(std::uint64_t azimuth) { return static_cast<std::uint16_t>(azimuth % kAzimuthTurn); }

// A Hesai: a return has the azimuth of its block.
class HesaiGeometry final : public FrameGeometry {
 public:
  HesaiGeometry(const BlockModel& model, const PacketLayout& layout, const std::vector<Series>& series,
                const CalibrationTable& table)
      : model_(model), layout_(layout), azimuth_(series_named(series, "azimuth")), beams_(model, table) {
    if (model.kind == BlockKind::Qt128 && layout.columns == 1) loop_flags_ = series_named(series, "mode_flag");
  }
  std::array<double, 3> point(std::size_t row, std::size_t column, std::uint32_t range) const override {
    return beams_.point(row, turned_once(azimuth_[column]), range);
  }
  std::int64_t since_stamp_ns(std::size_t row, std::size_t column) const override {
    const std::size_t channel = model_.channels[row], within = column % layout_.columns;
    const bool first_loop = loop_flags_.empty() ? within % 2 == 0 : (loop_flags_[column] & 1) != 0;
    const bool second = model_.kind == BlockKind::Qt128 && !first_loop;
    return layout_.column_ns[within] + (second ? model_.second_loop_ns : model_.channel_ns)[channel];
  }

 private:
  const BlockModel& model_;
  const PacketLayout& layout_;
  std::vector<std::uint64_t> azimuth_, loop_flags_;
  Beams beams_;
};

class BlockFamily final : public SensorFamily {
 public:
  explicit BlockFamily(const BlockModel& model) : model_(model) {}
  std::size_t rows() const override { return model_.channels.size(); }
  const PacketLayout* layout(std::string_view name) const override {
    const auto found = std::find_if(model_.layouts.begin(), model_.layouts.end(),
                                    [&](const PacketLayout& layout) { return layout.name == name; });
    return found == model_.layouts.end() ? nullptr : &*found;
  }
  std::vector<std::uint16_t> azimuth(const PacketLayout& layout, const std::vector<Series>& series) const override {
    if (is_velodyne()) return velodyne_azimuth(model_, layout, series);
    std::vector<std::uint16_t> found;
    for (const std::uint64_t azimuth : series_named(series, "azimuth")) found.push_back(turned_once(azimuth));
    return found;
  }
  std::unique_ptr<FrameGeometry> geometry(const PacketLayout& layout, const std::vector<Series>& series,
                                          const CalibrationTable& table) const override {
    if (is_velodyne()) return velodyne_geometry(model_, layout, series, table);
    return std::make_unique<HesaiGeometry>(model_, layout, series, table);
  }

 private:
  bool is_velodyne() const { return model_.kind == BlockKind::Velodyne || model_.kind == BlockKind::Vls128; }
  const BlockModel& model_;
};

}  // namespace

std::shared_ptr<const SensorFamily> block_family(const BlockModel& model) {
  return std::make_shared<BlockFamily>(model);
}

std::array<double, 2> direction_of(std::uint16_t azimuth) {
  static const std::vector<std::array<double, 2>> directions = [] {
    std::vector<std::array<double, 2>> found(kAzimuthTurn);
    for (std::size_t i = 0; i < found.size(); ++i) {
      const float degrees = 0.01f * static_cast<float>(i);
      const double angle = degrees * static_cast<float>(std::numbers::pi / 180);
      found[i] = {std::cos(angle), std::sin(angle)};
    }
    return found;
  }();
  return directions[azimuth];
}

Beams::Beams(const BlockModel& model, const CalibrationTable& table) : step_(model.range_step * kLengthStep) {
  for (const std::uint8_t channel : model.channels) {
    const auto of = [&](std::size_t field) { return table.at(field, channel); };
    const double turn = of(kRotationRow) * kAngleStep, up = of(kElevationRow) * kAngleStep;
    beams_.push_back({std::cos(turn), std::sin(turn), std::cos(up), std::sin(up), of(kDistanceRow) * kLengthStep,
                      of(kHeightRow) * kLengthStep, of(kAsideRow) * kLengthStep});
  }
}

std::array<double, 3> Beams::point(std::size_t row, std::uint16_t azimuth, std::uint32_t range) const {
  const Beam& beam = beams_[row];
  const auto [cos_a, sin_a] = direction_of(azimuth);
  const double cos_b = cos_a * beam.cos_turn + sin_a * beam.sin_turn,
               sin_b = sin_a * beam.cos_turn - cos_a * beam.sin_turn;
  const double distance = range * step_ + beam.distance, flat = distance * beam.cos_up;
  return {flat * cos_b + beam.aside * sin_b, beam.aside * cos_b - flat * sin_b, distance * beam.sin_up + beam.height};
}

}  // namespace lidarcodec
