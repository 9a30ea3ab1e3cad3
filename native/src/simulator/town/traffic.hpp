// Cars that drive through the town: they keep their distance, stop at lights, give way at crossings, and turn. Those
// that are far away are replaced out of sight. The first car carries the sensor.
#pragma once
#include <vector>

#include "simulator/town/models.hpp"
#include "simulator/town/route.hpp"

namespace lidarcodec::sim {

struct Driver {
  Route route;
  const Model* model;
  std::uint64_t id;
  float paint;
  double s = 0, v = 0, a = 0;     // distance driven, speed, acceleration: at the end of the tick
  double s_old = 0, v_old = 0;    // at its start
  double tilt = 0, tilt_old = 0;  // acceleration, low-pass filtered by the springs
  double eager = 1;               // factor of the usual speed
  double stuck = 0;               // seconds without moving
  bool granted = false;           // may cross the crossing ahead
  double cleared = -1;            // distance driven at which the crossing is behind it
  std::int64_t ci = 0, cj = 0;    // the crossing it holds
  Waypoint now{};                 // where it is at the end of the tick
};

class Traffic {
 public:
  static constexpr std::int64_t kTickNs = 50'000'000;
  static constexpr double kTick = 0.05;

  Traffic(const Town& town, const Models& models, std::uint64_t seed, double top_speed, double density);

  // Moves everything on until `t_ns` lies within the tick.
  void advance(std::int64_t t_ns);
  // Distance driven and speed of a driver at a time within the tick.
  double way(const Driver& d, std::int64_t t_ns, double& speed) const;
  double tilt(const Driver& d, std::int64_t t_ns) const;
  const std::vector<Driver>& drivers() const { return drivers_; }
  const Driver& ego() const { return drivers_.front(); }

 private:
  void tick();
  double accelerate(Driver& d, std::size_t self);
  bool may_cross(const Driver& d, std::size_t self, const Leg& leg) const;
  // Distance driven at which the crossing at the end of `leg` is behind a driver.
  double behind(const Driver& d, const Leg& leg) const;
  // Takes the crossing at the end of `leg`.
  void hold(Driver& d, const Leg& leg) const;
  bool red(const Leg& leg) const;
  void spawn(bool at_start);
  bool free_at(V2 p, double radius) const;

  const Town& town_;
  const Models& models_;
  Rng rng_;
  double top_speed_;
  int wanted_;
  std::int64_t ticks_ = 0;
  std::vector<Driver> drivers_;
};

}  // namespace lidarcodec::sim
