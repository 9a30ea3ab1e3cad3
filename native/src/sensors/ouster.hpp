// Ousters, which say in metadata what their packets do not. In Python lidarcodec/sensors/models/ouster.
#pragma once
#include <optional>
#include <string>

#include "sensors/model.hpp"

namespace lidarcodec {

// What is in a pixel. words: of 32 bits; coarse: a range unit is 8 mm, not 1 mm.
struct OusterProfile {
  std::string_view name;  // "LEGACY"
  std::size_t words;
  bool coarse, two_returns;
};

inline constexpr std::array<OusterProfile, 5> kOusterProfiles = {{{"LEGACY", 3, false, false},
                                                                  {"RNG15_RFL8_NIR8", 1, true, false},
                                                                  {"RNG19_RFL8_SIG16_NIR16", 3, false, false},
                                                                  {"RNG19_RFL8_SIG16_NIR16_DUAL", 4, false, true},
                                                                  {"FUSA_RNG15_RFL8_NIR8_DUAL", 2, true, true}}};
inline constexpr std::size_t kLegacyProfile = 0, kFusaProfile = 4;
inline constexpr std::array<std::size_t, 4> kOusterRows = {16, 32, 64, 128}, kOusterTurns = {512, 1024, 2048, 4096};

// Packets of a unit: profile, rows, columns of a packet, and whether their head is that of functional safety.
struct OusterPackets {
  std::size_t profile = 0, rows = 0, columns = 16;
  bool fusa_head = false;

  std::size_t bytes() const;
};

// The metadata of a unit; lengths in mm, matrices row after row.
struct OusterMetadata {
  std::string model;  // "os1-128"
  OusterPackets packets;
  std::size_t turn_columns = 0;
  std::vector<double> altitude_deg, azimuth_deg;  // (H,)
  std::array<double, 16> beam_to_lidar{}, lidar_to_sensor{};
};

// Raises Section if it is not that of an Ouster whose packets have a layout here.
OusterMetadata read_ouster_metadata(Bytes json);

// metadata: nothing if only its packets are known; then the columns of a turn are guessed, and there are no points.
std::shared_ptr<const SensorFamily> ouster_family(const OusterPackets& packets, std::optional<OusterMetadata> metadata);

}  // namespace lidarcodec
