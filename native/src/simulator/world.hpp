// The interface of a scene to the sensor: the pose of the car, the objects around it, and the ground. Times are
// nanoseconds since the start of the drive and never go back.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "simulator/scene.hpp"

namespace lidarcodec::sim {

// Rigid transform from the sensor to the world.
struct Pose {
  V3 at;
  std::array<double, 9> m{1, 0, 0, 0, 1, 0, 0, 0, 1};  // rows
  V3 turn(V3 v) const {
    return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
            m[6] * v.x + m[7] * v.y + m[8] * v.z};
  }
};
// Heading (c, s), then nose up by `pitch` and left side up by `roll`, small angles in radians.
Pose pose_of(V3 at, double c, double s, double pitch, double roll);

class World {
 public:
  virtual ~World() = default;
  World() = default;
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  // Pose of the sensor.
  virtual Pose pose(std::int64_t t_ns) = 0;
  // Everything within `reach` metres, standing or moving; the pointers live until the next call.
  virtual void gather(std::int64_t t_ns, double reach, std::vector<const Object*>& out) = 0;
  virtual void trace_ground(const Ray& ray, Hit& hit) = 0;
  virtual double ground_height(V2 p) = 0;
  // Whether a car carries the sensor, whose roof hides a part of what is below.
  virtual bool on_a_car() const { return true; }
};

constexpr double kSensorHeight = 1.73;  // of the sensor's base over the road

struct WorldOptions {
  std::uint64_t seed = 1;
  double speed = 0;    // top speed in m/s, 0 = what the scene has
  double traffic = 1;  // share of the usual traffic
};
std::unique_ptr<World> make_city(const WorldOptions& options);
std::unique_ptr<World> make_road(const WorldOptions& options);
std::unique_ptr<World> make_street(const WorldOptions& options);
std::unique_ptr<World> make_bend(const WorldOptions& options);
std::unique_ptr<World> make_motorway(const WorldOptions& options);
std::unique_ptr<World> make_garage(const WorldOptions& options);
std::unique_ptr<World> make_room(const WorldOptions& options);

}  // namespace lidarcodec::sim
