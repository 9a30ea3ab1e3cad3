// The simulated drive: a scene, a sensor in it, and packets out of it.
#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "sim_index.hpp"
#include "sim_packets.hpp"
#include "sim_world.hpp"

namespace lidarcodec::sim {

struct SimulatorOptions {
  std::string scene = "city";  // city, road, street
  WorldOptions world;
  std::int64_t start_s = 0;  // GPS time at packet 0, seconds since 1970
};

// What is behind each return: the true distance along the beam in metres (0 = nothing) and a Label.
struct Truth {
  std::vector<float> distance_m;
  std::vector<std::uint8_t> label;
};

class Simulator {
 public:
  // Throws Error(Settings) for an unknown scene or a speed or traffic that is no number of use.
  explicit Simulator(const SimulatorOptions& options);

  // The next `count` packets, 1206 bytes each; with `truth`, 384 values a packet, firing by firing, laser by laser.
  void packets(std::size_t count, std::uint8_t* out, Truth* truth = nullptr);
  std::uint64_t packets_made() const { return packet_; }

  // Poses of the sensor, T_world_sensor, at times in ns since packet 0, in rising order; 16 numbers each.
  static void poses(const SimulatorOptions& options, const std::vector<std::int64_t>& t_ns, double* out);
  double ground_height(double x, double y) { return world_->ground_height({x, y}); }

 private:
  void look_around(std::int64_t t_ns, V3 at);

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
};

}  // namespace lidarcodec::sim
