// A session of the C library that closes itself, and weight files and decoders of pictures for it.
#pragma once
#include <lidarcodec.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "pictures.hpp"

// Frees a session, and the decoders of pictures that it was given.
struct CloseSession {
  std::shared_ptr<Decoders> decoders;
  void operator()(lidarcodec_session* session) const { lidarcodec_close(session); }
};
using Session = std::unique_ptr<lidarcodec_session, CloseSession>;

// A session that knows the weight files of a folder, "" for none, and opens the pictures for which there are libraries.
inline Session open_session(const std::string& weights) {
  Session session(lidarcodec_open(), CloseSession{std::make_shared<Decoders>()});
  if (!session) throw std::runtime_error("no memory for a session");
  session.get_deleter().decoders->give(session.get());
  if (weights.empty()) return session;
  for (const auto& entry : std::filesystem::directory_iterator(weights)) {
    if (entry.path().extension() != ".lcrw") continue;
    std::ifstream file(entry.path(), std::ios::binary);
    const std::vector<char> data((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    if (lidarcodec_give_weights(session.get(), reinterpret_cast<const uint8_t*>(data.data()), data.size()) !=
        LIDARCODEC_OK)
      throw std::runtime_error(entry.path().string() + ": " + lidarcodec_error_text(session.get()));
  }
  return session;
}

// The points of the frame that was pushed last.
inline std::vector<lidarcodec_point> points_of(const Session& session, lidarcodec_returns returns) {
  std::vector<lidarcodec_point> points(lidarcodec_points(session.get(), returns, nullptr, 0));
  points.resize(lidarcodec_points(session.get(), returns, points.data(), points.size()));
  return points;
}

// Fields of the point cloud that was pushed last; none of another sensor.
inline std::vector<lidarcodec_field> fields_of(const Session& session) {
  std::vector<lidarcodec_field> fields(lidarcodec_fields(session.get(), nullptr, 0));
  lidarcodec_fields(session.get(), fields.data(), fields.size());
  return fields;
}

// The values of the field at a place in `fields_of`, as numbers.
inline std::vector<double> values_of(const Session& session, const std::vector<lidarcodec_field>& fields,
                                     size_t place) {
  const lidarcodec_field& field = fields[place];
  const size_t count = lidarcodec_values(session.get(), place, nullptr, 0);
  const auto as = [&](auto zero) {
    std::vector<decltype(zero)> values(count);
    lidarcodec_values(session.get(), place, values.data(), count);
    return std::vector<double>(values.begin(), values.end());
  };
  switch (field.type) {
    case LIDARCODEC_INT8:
      return as(int8_t{});
    case LIDARCODEC_UINT8:
      return as(uint8_t{});
    case LIDARCODEC_INT16:
      return as(int16_t{});
    case LIDARCODEC_UINT16:
      return as(uint16_t{});
    case LIDARCODEC_INT32:
      return as(int32_t{});
    case LIDARCODEC_UINT32:
      return as(uint32_t{});
    case LIDARCODEC_FLOAT32:
      return as(float{});
    default:
      return as(double{});
  }
}

// The number of an image at a place.
inline uint32_t value_at(const lidarcodec_plane& plane, size_t cell) {
  if (plane.bytes == 1) return static_cast<const uint8_t*>(plane.values)[cell];
  if (plane.bytes == 2) return static_cast<const uint16_t*>(plane.values)[cell];
  return static_cast<const uint32_t*>(plane.values)[cell];
}

// What a frame says of a point by an attribute's name: of a second return that of `NAME2`, if there is such a plane.
inline uint32_t attribute_of(const lidarcodec_frame& frame, const lidarcodec_point& point, const std::string& name) {
  uint32_t value = 0;
  for (uint32_t i = 0; i < frame.plane_count; ++i) {
    const lidarcodec_plane& plane = frame.planes[i];
    if (plane.name == name) value = value_at(plane, point.cell);
    if (point.return_number == 2 && plane.name == name + "2") return value_at(plane, point.cell);
  }
  return value;
}
