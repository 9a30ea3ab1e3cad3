// A session of the C library that closes itself, and weight files for it.
#pragma once
#include <lidarcodec.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

struct CloseSession {
  void operator()(lidarcodec_session* session) const { lidarcodec_close(session); }
};
using Session = std::unique_ptr<lidarcodec_session, CloseSession>;

// A session that knows the weight files of a folder; "" for none.
inline Session open_session(const std::string& weights) {
  Session session(lidarcodec_open());
  if (!session) throw std::runtime_error("no memory for a session");
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
inline std::vector<lidarcodec_point> points_of(const Session& session, const lidarcodec_frame& frame) {
  std::vector<lidarcodec_point> points(frame.points);
  points.resize(lidarcodec_points(session.get(), points.data(), points.size()));
  return points;
}
