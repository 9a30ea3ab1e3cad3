#include "clouds/message.hpp"

#include <algorithm>
#include <array>
#include <bit>

namespace lidarcodec {
namespace {

constexpr std::size_t kForm = 4, kMostFields = 64, kMostText = 4096;
constexpr std::array<std::uint8_t, kForm> kRos1 = {'r', 'o', 's', '1'}, kBigCdr = {0, 0, 0, 0},
                                          kLittleCdr = {0, 1, 0, 0};
constexpr std::int64_t kSecond = 1'000'000'000;

// Values one after the other; CDR aligns them to their size, ROS 1 does not.
class HeadReader {
 public:
  HeadReader(Bytes payload, bool big_endian, bool aligned)
      : payload_(payload), big_endian_(big_endian), aligned_(aligned) {}

  std::size_t at() const { return at_; }
  std::uint8_t u8() { return take(1)[0]; }
  std::uint32_t u32() {
    if (aligned_) at_ += (4 - at_ % 4) % 4;
    const Bytes found = take(4);
    const auto number = static_cast<std::uint32_t>(little_endian(found, 0, 4));
    if (!big_endian_) return number;
    return number >> 24 | (number >> 8 & 0xFF00u) | (number << 8 & 0xFF0000u) | number << 24;
  }
  // Without the zeros at its end.
  std::string text() {
    const std::uint32_t size = u32();
    if (size > kMostText)
      throw Error(ErrorCode::Section, "a text of " + std::to_string(size) + " bytes in a PointCloud2");
    Bytes found = take(size);
    while (!found.empty() && found.back() == 0) found = found.first(found.size() - 1);
    return {found.begin(), found.end()};
  }

 private:
  Bytes take(std::size_t size) {
    if (at_ > payload_.size() || size > payload_.size() - at_)
      throw Error(ErrorCode::Truncated, "a PointCloud2 message ends too early", at_);
    at_ += size;
    return payload_.subspan(at_ - size, size);
  }

  Bytes payload_;
  bool big_endian_, aligned_;
  std::size_t at_ = kForm;
};

bool begins_with(Bytes payload, const std::array<std::uint8_t, kForm>& form) {
  return payload.size() >= kForm && std::equal(form.begin(), form.end(), payload.begin());
}

}  // namespace

bool CloudHead::regular() const {
  const bool inside = std::all_of(fields.begin(), fields.end(),
                                  [&](const CloudField& field) { return field.offset + field.bytes() <= point_step; });
  const std::uint64_t used = std::uint64_t{width} * point_step, step = height > 1 ? row_step : used;
  return inside && point_step > 0 && used <= step && data_bytes == step * height;
}

const CloudField* CloudHead::named(std::string_view name) const {
  const auto found = std::find_if(fields.begin(), fields.end(),
                                  [&](const CloudField& field) { return field.repeated == 1 && field.name == name; });
  return found == fields.end() ? nullptr : &*found;
}

CloudHead read_cloud_head(Bytes payload) {
  const bool ros1 = begins_with(payload, kRos1), big_endian = begins_with(payload, kBigCdr);
  if (!ros1 && !big_endian && !begins_with(payload, kLittleCdr))
    throw Error(ErrorCode::Section, "a message that does not begin as a PointCloud2");
  HeadReader reader(payload, big_endian, !ros1);
  CloudHead head;
  if (ros1) reader.u32();  // the sequence number
  const std::uint32_t seconds = reader.u32(), rest = reader.u32();
  head.stamp_ns = (ros1 ? std::int64_t{seconds} : std::int64_t{static_cast<std::int32_t>(seconds)}) * kSecond + rest;
  reader.text();  // the frame of reference
  head.height = reader.u32();
  head.width = reader.u32();
  const std::uint32_t count = reader.u32();
  if (count > kMostFields)
    throw Error(ErrorCode::Section, "a PointCloud2 of " + std::to_string(count) + " fields: the limit is 64");
  while (head.fields.size() < count) {
    CloudField field;
    field.name = reader.text();
    field.offset = reader.u32();
    const std::uint8_t type = reader.u8();
    field.repeated = reader.u32();
    if (type < 1 || type > 8)
      throw Error(ErrorCode::Section, "a field of a PointCloud2 of unknown type " + std::to_string(type));
    field.type = static_cast<FieldType>(type);
    head.fields.push_back(std::move(field));
  }
  head.big_endian = reader.u8() != 0;
  head.point_step = reader.u32();
  head.row_step = reader.u32();
  head.data_bytes = reader.u32();
  head.size = reader.at();
  if (head.data_bytes > kMostCloudBytes || head.points() > kMostCloudBytes)
    throw Error(ErrorCode::Section, "a PointCloud2 of " + std::to_string(head.data_bytes) + " bytes");
  return head;
}

std::optional<CloudPoints> CloudPoints::of(Bytes payload) {
  try {
    CloudHead head = read_cloud_head(payload);
    if (!head.regular() || head.size > payload.size() || head.data_bytes > payload.size() - head.size)
      return std::nullopt;
    const Bytes data = payload.subspan(head.size, head.data_bytes);
    return CloudPoints(std::move(head), data);
  } catch (const Error&) {
    return std::nullopt;
  }
}

double CloudPoints::number(const CloudField& field, std::size_t point) const {
  const std::uint64_t found = bits(field, point);
  switch (field.type) {
    case FieldType::Int8:
      return static_cast<std::int8_t>(found);
    case FieldType::Int16:
      return static_cast<std::int16_t>(found);
    case FieldType::Int32:
      return static_cast<std::int32_t>(found);
    case FieldType::Float32:
      return static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(found)));
    case FieldType::Float64:
      return std::bit_cast<double>(found);
    default:
      return static_cast<double>(found);
  }
}

}  // namespace lidarcodec
