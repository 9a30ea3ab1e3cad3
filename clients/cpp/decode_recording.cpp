// Decodes a recording of any sensor: a line for each frame, and its points in files as KITTI has them (x, y, z and
// reflectance from 0 to 1; f32) if a folder is given, which is made; with --all second returns, too.
//   decode_recording FILE.mcap [OUT] [--all] [--weights FOLDER]
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>

#include "recording.hpp"
#include "session.hpp"

namespace {

// The largest intensity that a sensor can send.
float most_intensity(const lidarcodec_frame& frame) {
  for (uint32_t i = 0; i < frame.plane_count; ++i)
    if (frame.planes[i].name == std::string("intensity") && frame.planes[i].bits > 8) return 65535;
  return 255;
}

void write_points(const std::filesystem::path& path, const lidarcodec_frame& frame,
                  const std::vector<lidarcodec_point>& points) {
  std::ofstream file(path, std::ios::binary);
  const float most = most_intensity(frame);
  for (const lidarcodec_point& point : points) {
    const float values[4] = {point.x, point.y, point.z, static_cast<float>(point.intensity) / most};
    file.write(reinterpret_cast<const char*>(values), sizeof(values));
  }
  if (!file) throw std::runtime_error("cannot write " + path.string());
}

int run(const std::string& recording, const std::string& out, lidarcodec_returns returns, const std::string& weights) {
  if (!out.empty()) std::filesystem::create_directories(out);
  std::map<std::string, Session> sessions;  // a stream has a session of its own
  int frames = 0, refused = 0;
  Recording(recording).read([&](const std::string& topic, const uint8_t* message, size_t size) {
    Session& session = sessions[topic];
    if (!session) session = open_session(weights);
    lidarcodec_frame frame;
    if (lidarcodec_push(session.get(), message, size, &frame) != LIDARCODEC_OK) {
      std::cerr << topic << ": " << lidarcodec_error_text(session.get()) << "\n";
      ++refused;
      return;
    }
    do {
      const std::vector<lidarcodec_point> points = points_of(session, returns);
      std::cout << topic << " frame " << frame.index << " of a " << frame.model << " at " << frame.stamp_ns
                << " ns: " << points.size() << " points\n";
      char name[16];
      std::snprintf(name, sizeof(name), "%06d.bin", frames);
      if (!out.empty()) write_points(std::filesystem::path(out) / name, frame, points);
      ++frames;
    } while (lidarcodec_next(session.get(), &frame) != 0);
  });
  std::cout << frames << " frames, " << refused << " messages refused\n";
  if (sessions.empty()) throw std::runtime_error(recording + " has no messages of lidarcodec");
  return refused > 0;
}

}  // namespace

int main(int count, char** words) {
  std::string recording, out, weights;
  bool understood = true;
  lidarcodec_returns returns = LIDARCODEC_FIRST;
  for (int i = 1; i < count; ++i) {
    const std::string word = words[i];
    if (word == "--weights" && i + 1 < count)
      weights = words[++i];
    else if (word == "--all")
      returns = LIDARCODEC_ALL;
    else if (word[0] == '-' || !out.empty())
      understood = false;
    else
      (recording.empty() ? recording : out) = word;
  }
  if (recording.empty() || !understood) {
    std::cerr << "usage: decode_recording FILE.mcap [OUT] [--all] [--weights FOLDER]\n";
    return 2;
  }
  try {
    return run(recording, out, returns, weights);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
