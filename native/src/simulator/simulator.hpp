// The simulated drive: a scene, a sensor in it, and packets out of it.
#pragma once
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "simulator/index.hpp"
#include "simulator/packets.hpp"
#include "simulator/world.hpp"

namespace lidarcodec::sim {

struct SimulatorOptions {
  std::string scene = "city";  // as in make_world
  WorldOptions world;
  std::int64_t start_ns = 0;  // GPS time at packet 0, ns since 1970
};

// Throws Error(Settings) for an unknown scene, or a speed or traffic out of range.
std::unique_ptr<World> make_world(const SimulatorOptions& options);

// Ground truth of each return: the true distance along the beam in metres (0 = nothing) and a Label.
struct Truth {
  std::vector<float> distance_m;
  std::vector<std::uint8_t> label;
};

// One call at a time: callers in several threads wait for each other.
class Simulator {
 public:
  // Throws Error(Settings) for an unknown scene, or a speed or traffic out of range.
  explicit Simulator(const SimulatorOptions& options);

  // The next `count` packets, 1206 bytes each; with `truth`, 384 values a packet, firing by firing, laser by laser.
  void packets(std::size_t count, std::uint8_t* out, Truth* truth = nullptr);
  // Drives on for `count` packets without tracing beams.
  void skip(std::uint64_t count);

  // Heights of the ground at `count` places x, y.
  void ground_height(const double* places, std::size_t count, double* out);

 private:
  void look_around(std::int64_t t_ns, V3 at);

  std::mutex busy_;
  std::unique_ptr<World> world_;
  Sensor sensor_;
  Receiver receiver_;
  Rotor rotor_;
  Status status_;
  Index index_;
  std::vector<const Object*> objects_;
  std::uint64_t packet_ = 0;
  std::uint64_t luck_;
  std::int64_t index_ns_ = 0;
  bool looked_ = false;
};

// A road user at a time: the box of its parts, in its own frame and in the world.
struct RoadUser {
  ObjectKind kind;
  std::uint32_t id;
  V3 at;               // origin of its own frame: its middle, on the ground
  double c, s;         // heading
  double vx, vy;       // m/s in the world
  float lo[3], hi[3];  // of its parts, along its heading, to its left, and up
};

// The exact poses of a drive, without tracing beams: 0.1 ms for a second of the city.
class PoseFinder {
 public:
  explicit PoseFinder(const SimulatorOptions& options);
  // T_world_sensor, 16 numbers each, at `count` times >= 0 since packet 0. A time before the last one drives again from
  // the start.
  void at(const std::int64_t* t_ns, std::size_t count, double* out);
  // Road users within `reach` metres of the sensor at a time >= 0 since packet 0, standing ones included.
  std::vector<RoadUser> road_users(std::int64_t t_ns, double reach);

 private:
  void drive_to(std::int64_t t_ns);

  std::mutex busy_;
  SimulatorOptions options_;
  std::unique_ptr<World> world_;
  std::int64_t last_ns_ = 0;
};

}  // namespace lidarcodec::sim
