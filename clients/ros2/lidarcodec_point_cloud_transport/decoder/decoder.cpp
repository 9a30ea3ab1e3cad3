#include "decoder.hpp"

#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>

namespace lidarcodec_point_cloud_transport {
namespace {

constexpr uint8_t kUint16 = 4, kFloat32 = 7;

template <class Value>
void put(uint8_t* at, Value value) {
  std::memcpy(at, &value, sizeof(value));  // of a little-endian machine, as all that ROS 2 supports are
}

bool is_hdl64e(const lidarcodec_frame& frame) { return std::strcmp(frame.model, "hdl64e") == 0; }

std::vector<uint8_t> bytes_of(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error("cannot read " + path.string());
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

bool is_cloud(const lidarcodec_frame& frame) { return std::strcmp(frame.model, "pointcloud2") == 0; }

}  // namespace

Decoder::Decoder(const std::string& weights) : session_(lidarcodec_open()) {
  if (!session_) throw std::runtime_error("no memory for a decoder");
  std::error_code missing;
  for (const auto& entry :
       std::filesystem::directory_iterator(weights.empty() ? LIDARCODEC_WEIGHTS : weights, missing)) {
    if (entry.path().extension() != ".lcrw") continue;
    const std::vector<uint8_t> data = bytes_of(entry.path());
    if (lidarcodec_give_weights(session_.get(), data.data(), data.size()) != LIDARCODEC_OK)
      throw std::runtime_error(entry.path().string() + ": " + lidarcodec_error_text(session_.get()));
  }
  if (missing && !weights.empty()) throw std::runtime_error("cannot read " + weights + ": " + missing.message());
}

// Takes the points of a driver's message, with all fields. False if fields lie over each other, as no driver's do.
bool Decoder::take_fields(Cloud& cloud) const {
  std::vector<lidarcodec_field> fields(lidarcodec_fields(session_.get(), nullptr, 0));
  lidarcodec_fields(session_.get(), fields.data(), fields.size());
  size_t most = 0;
  lidarcodec_message(session_.get(), &most);
  for (size_t place = 0; place < fields.size(); ++place) {
    const lidarcodec_field& field = fields[place];
    cloud.fields.push_back({field.name, cloud.point_step, field.type, field.count});
    cloud.point_step += field.count * field.bytes;
    if (field.count > 0)
      cloud.points = static_cast<uint32_t>(lidarcodec_values(session_.get(), place, nullptr, 0) / field.count);
    if (size_t{cloud.points} * cloud.point_step > most) return false;
  }
  cloud.dense = false;
  cloud.data.resize(size_t{cloud.points} * cloud.point_step);
  std::vector<uint8_t> values;
  for (size_t place = 0; place < fields.size(); ++place) {
    const size_t step = size_t{fields[place].count} * fields[place].bytes;
    values.resize(cloud.points * step);
    lidarcodec_values(session_.get(), place, values.data(), size_t{cloud.points} * fields[place].count);
    uint8_t* to = cloud.data.data() + cloud.fields[place].offset;
    for (size_t at = 0; at < values.size(); at += step, to += cloud.point_step)
      std::memcpy(to, values.data() + at, step);
  }
  return true;
}

Outcome Decoder::decode(const uint8_t* message, size_t size, Cloud& cloud) {
  lidarcodec_frame frame;
  const lidarcodec_status status = lidarcodec_push(session_.get(), message, size, &frame);
  if (status != LIDARCODEC_OK) {
    why_ = lidarcodec_error_text(session_.get());
    return status == LIDARCODEC_MISSING_REFERENCE ? Outcome::Waiting : Outcome::Refused;
  }
  if (is_cloud(frame)) {
    Cloud found;
    if (!take_fields(found)) {
      why_ = "a point cloud whose fields lie over each other";
      return Outcome::Refused;
    }
    cloud = std::move(found);
    return Outcome::Decoded;
  }
  const uint32_t rows = frame.rows, returns = frame.points;
  const bool timed = !is_hdl64e(frame);
  const int64_t stamp_ns = frame.stamp_ns;
  const size_t count = lidarcodec_points(session_.get(), LIDARCODEC_FIRST, nullptr, 0);
  if (count == 0 && returns > 0) {
    why_ = "the directions of the beams are not known: an Ouster needs its metadata";
    return Outcome::Refused;
  }
  points_.resize(count);
  lidarcodec_points(session_.get(), LIDARCODEC_FIRST, points_.data(), count);
  cloud.dense = true;
  cloud.fields = {
      {"x", 0, kFloat32}, {"y", 4, kFloat32}, {"z", 8, kFloat32}, {"intensity", 12, kFloat32}, {"ring", 16, kUint16}};
  if (timed) cloud.fields.push_back({"time", 18, kFloat32});
  cloud.point_step = timed ? 22 : 18;
  cloud.points = static_cast<uint32_t>(count);
  cloud.data.resize(count * cloud.point_step);
  uint8_t* at = cloud.data.data();
  for (const lidarcodec_point& point : points_) {
    put(at, point.x);
    put(at + 4, point.y);
    put(at + 8, point.z);
    put(at + 12, static_cast<float>(point.intensity));
    put(at + 16, static_cast<uint16_t>(rows - 1 - point.ring));
    if (timed) put(at + 18, static_cast<float>(static_cast<double>(point.t_ns - stamp_ns) * 1e-9));
    at += cloud.point_step;
  }
  return Outcome::Decoded;
}

}  // namespace lidarcodec_point_cloud_transport
