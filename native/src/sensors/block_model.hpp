// Sensors whose packets are made of blocks: Velodyne and Hesai. In Python lidarcodec/sensors/models/blocks.py and
// block_sensor.py.
#pragma once
#include "sensors/model.hpp"

namespace lidarcodec {

enum class BlockKind : std::uint8_t { Velodyne, Vls128, Hesai, Qt128 };

// A model. range_step: 1e-7 m; channels: hardware channel of each row, from the top beam down. Of a Velodyne, in us:
// cycle from a column to the next, shot from a firing to the next; together: lasers that fire at once. Of a Hesai, ns
// from the start of a column to the firing of each channel; of a QT128 in each of its two loops.
struct BlockModel {
  std::string_view name;
  BlockKind kind;
  std::uint32_t range_step;
  std::span<const std::uint8_t> channels;
  std::span<const PacketLayout> layouts;
  double cycle_us, shot_us;
  std::size_t together;
  std::span<const std::int32_t> channel_ns, second_loop_ns;
};

// All of them (model_tables.cpp).
std::span<const BlockModel> block_models();

std::shared_ptr<const SensorFamily> block_family(const BlockModel& model);

// Cosine and sine of an azimuth, 0.01 degree, 0 to 35999. The angle is rounded as velodyne-decoder rounds it.
std::array<double, 2> direction_of(std::uint16_t azimuth);

// Points of cells by their row's calibration: the formula of lidarcodec/sensors/models/block_sensor.py.
class Beams {
 public:
  Beams(const BlockModel& model, const CalibrationTable& table);
  std::array<double, 3> point(std::size_t row, std::uint16_t azimuth, std::uint32_t range) const;

 private:
  struct Beam {
    double cos_turn, sin_turn, cos_up, sin_up, distance, height, aside;
  };
  std::vector<Beam> beams_;
  double step_;
};

// How a Velodyne turns and fires within the packets of one frame (velodyne.cpp).
std::unique_ptr<FrameGeometry> velodyne_geometry(const BlockModel& model, const PacketLayout& layout,
                                                 const std::vector<Series>& series, const CalibrationTable& table);
std::vector<std::uint16_t> velodyne_azimuth(const BlockModel& model, const PacketLayout& layout,
                                            const std::vector<Series>& series);

}  // namespace lidarcodec
