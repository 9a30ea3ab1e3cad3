// The CLOUD section (docs/wire-format-clouds.md): a `sensor_msgs/PointCloud2` message;
// lidarcodec/planes/clouds/section.py writes it.
#pragma once
#include "clouds/grid.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

// A payload, and the rows of its points, if the section has a range image.
struct DecodedCloud {
  std::vector<std::uint8_t> payload;
  std::optional<CloudRows> image;
};

// The message of a section. Raises Section or Truncated.
DecodedCloud decode_cloud(Bytes section, const Outside& outside);

}  // namespace lidarcodec
