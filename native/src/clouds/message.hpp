// A `sensor_msgs/PointCloud2` message taken apart: the head before its points, and where they are; in Python
// lidarcodec/sensors/clouds/message.py, which says what a payload is.
#pragma once
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "base/bytes.hpp"

namespace lidarcodec {

inline constexpr std::size_t kMostCloudBytes = std::size_t{32} << 20;
inline constexpr std::size_t kMostCloudPoints = std::size_t{1} << 20;  // of which columns are coded apart

// As sensor_msgs/PointField numbers them.
enum class FieldType : std::uint8_t { Int8 = 1, UInt8, Int16, UInt16, Int32, UInt32, Float32, Float64 };

inline constexpr std::size_t bytes_of(FieldType type) {
  constexpr std::size_t kBytes[] = {0, 1, 1, 2, 2, 4, 4, 4, 8};
  return kBytes[static_cast<std::size_t>(type)];
}

// A field of each point; repeated: how many values it has.
struct CloudField {
  std::string name;
  std::uint32_t offset = 0;
  FieldType type = FieldType::Float32;
  std::uint32_t repeated = 1;

  std::uint64_t bytes() const { return std::uint64_t{bytes_of(type)} * repeated; }
  bool is_float() const { return type >= FieldType::Float32; }
};

// What stands before the points. size: its bytes; data_bytes: of all rows of points; big_endian: of the points.
struct CloudHead {
  std::size_t size = 0;
  std::int64_t stamp_ns = 0;
  std::uint32_t height = 0, width = 0;
  std::vector<CloudField> fields;
  bool big_endian = false;
  std::uint32_t point_step = 0, row_step = 0, data_bytes = 0;

  std::uint64_t points() const { return std::uint64_t{height} * width; }
  // Whether the points lie where step and row step say, and each field within its point.
  bool regular() const;
  // The first field of that name that has one value; nullptr if there is none.
  const CloudField* named(std::string_view name) const;
};

// The head of a payload; the points need not be there. Raises Section if this is no PointCloud2, Truncated if it ends
// within the head.
CloudHead read_cloud_head(Bytes payload);

// A payload whose points lie as its head says.
class CloudPoints {
 public:
  // Nothing for other payloads. They outlive the points.
  static std::optional<CloudPoints> of(Bytes payload);

  const CloudHead& head() const { return head_; }
  std::size_t size() const { return static_cast<std::size_t>(head_.points()); }

  // The bits of a value of a field of a point, in the machine's order.
  std::uint64_t bits(const CloudField& field, std::size_t point, std::size_t number = 0) const {
    const std::size_t width = bytes_of(field.type);
    const Bytes value = data_.subspan(place(point) + field.offset + number * width, width);
    if (!head_.big_endian) return little_endian(value, 0, width);
    std::uint64_t found = 0;
    for (const std::uint8_t byte : value) found = found << 8 | byte;
    return found;
  }
  // The same as a number.
  double number(const CloudField& field, std::size_t point) const;

 private:
  CloudPoints(CloudHead head, Bytes data) : head_(std::move(head)), data_(data) {}

  std::size_t place(std::size_t point) const {
    if (head_.height <= 1) return point * head_.point_step;
    return point / head_.width * head_.row_step + point % head_.width * head_.point_step;
  }

  CloudHead head_;
  Bytes data_;
};

}  // namespace lidarcodec
