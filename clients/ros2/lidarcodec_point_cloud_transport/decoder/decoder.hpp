// Decoder: messages of lidarcodec to the points of a sensor_msgs/PointCloud2, without any header of ROS.
#pragma once
#include <lidarcodec.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace lidarcodec_point_cloud_transport {

// A field of a point; `datatype` as sensor_msgs/PointField numbers it.
struct Field {
  std::string name;
  uint32_t offset;
  uint8_t datatype;
  uint32_t count = 1;
};

// Points as the ROS driver of Velodyne lays them out: x y z intensity (float32), ring (uint16, 0 is the lowest beam),
// and time (float32, seconds after the stamp). An HDL-64E has no `time`: the library does not read the times of its
// firings. A point cloud of a driver has all points of its message, also those without a return, and all fields, in
// their order and without padding.
struct Cloud {
  std::vector<Field> fields;
  uint32_t point_step = 0;
  uint32_t points = 0;
  bool dense = true;          // whether all coordinates are known to be numbers
  std::vector<uint8_t> data;  // little endian
};

enum class Outcome {
  Decoded,
  Waiting,  // the message builds on one that did not come: points come with the next key message
  Refused   // damaged, or of a codec that is not decoded here; `why` says which
};

// Decodes one stream, message after message. Used by one thread at a time.
class Decoder {
 public:
  // weights: folder of weight files that streams of codec riddle may name without sending them; empty: the installed
  // one. Throws std::runtime_error without memory, or for a file that cannot be read.
  explicit Decoder(const std::string& weights = "");

  // Writes the points into `cloud` if Decoded, and leaves it as it was if not. Throws std::bad_alloc only.
  Outcome decode(const uint8_t* message, size_t size, Cloud& cloud);

  // Of the last message that was not decoded, a sentence.
  const std::string& why() const { return why_; }

 private:
  struct Close {
    void operator()(lidarcodec_session* session) const { lidarcodec_close(session); }
  };

  bool take_fields(Cloud& cloud) const;

  std::unique_ptr<lidarcodec_session, Close> session_;
  std::vector<lidarcodec_point> points_;
  std::string why_;
};

}  // namespace lidarcodec_point_cloud_transport
