#include "simulator/town/blocks.hpp"
#include "simulator/town/traffic.hpp"
#include "simulator/world.hpp"

namespace lidarcodec::sim {

Pose pose_of(V3 at, double c, double s, double pitch, double roll) {
  const double cp = cos_of(pitch), sp = sin_of(pitch), cr = cos_of(roll), sr = sin_of(roll);
  Pose p;
  p.at = at;
  // Rotation by the heading, then by the pitch, then by the roll.
  p.m = {c * cp,
         -s * cr - c * sp * sr,
         s * sr - c * sp * cr,
         s * cp,
         c * cr - s * sp * sr,
         -c * sr - s * sp * cr,
         sp,
         cp * sr,
         cp * cr};
  return p;
}

namespace {

class City final : public World {
 public:
  explicit City(const WorldOptions& options)
      : town_(options.seed),
        ground_(town_),
        blocks_(town_, ground_, models_),
        traffic_(town_, models_, options.seed, options.speed > 0 ? options.speed : 14.0, options.traffic) {}

  Pose pose(std::int64_t t_ns) override {
    traffic_.advance(t_ns);
    const Driver& ego = traffic_.ego();
    double speed = 0;
    const double s = traffic_.way(ego, t_ns, speed);
    const Waypoint w = ego.route.at(s);
    const double seconds = static_cast<double>(t_ns) * 1e-9;
    // The driver deviates from the lane by a few centimetres.
    const double drift = 0.10 * sin_turns(s / 47.0) + 0.05 * sin_turns(s / 19.0);
    const double yaw = 6.283185307179586477 * (0.10 / 47.0 * cos_turns(s / 47.0) + 0.05 / 19.0 * cos_turns(s / 19.0));
    const V2 h = w.heading;
    const V2 at{w.at.x - drift * h.y, w.at.y + drift * h.x};
    const double n = 1.0 / std::sqrt(1.0 + yaw * yaw);
    const double c = (h.x - yaw * h.y) * n, sn = (h.y + yaw * h.x) * n;
    const double front = town_.height(at + V2{c, sn} * 1.3), rear = town_.height(at - V2{c, sn} * 1.4);
    const double left = town_.height(at + V2{-sn, c} * 0.75), right = town_.height(at - V2{-sn, c} * 0.75);
    const double bounce = min_of(speed, 10.0) * 0.1;
    const double bump = 0.006 * bounce * noise_at(3, s / 2.3, 0.0) + 0.003 * bounce * noise_at(4, s / 0.9, 0.0);
    const double pitch =
        (front - rear) / 2.7 + 0.0045 * traffic_.tilt(ego, t_ns) + 0.0022 * bounce * noise_at(5, s / 2.9, 0.5);
    const double roll =
        (left - right) / 1.5 + 0.0025 * bounce * noise_at(6, s / 2.1, 0.5) + 0.0003 * sin_turns(seconds * 1.7);
    return pose_of({at.x, at.y, 0.5 * (front + rear) + 0.06 + bump + kSensorHeight}, c, sn, pitch, roll);
  }

  void gather(std::int64_t t_ns, double reach, std::vector<const Object*>& out) override {
    traffic_.advance(t_ns);
    double speed = 0;
    const V2 here = traffic_.ego().route.at(traffic_.way(traffic_.ego(), t_ns, speed)).at;
    moving_.clear();
    for (std::size_t k = 1; k < traffic_.drivers().size(); ++k) add_driver(traffic_.drivers()[k], t_ns);
    const auto& blocks = blocks_.around(here, reach);
    for (const Block* block : blocks) add_walkers(*block, t_ns);
    for (const Block* block : blocks)
      for (const Object& o : block->objects) out.push_back(&o);
    for (const Object& o : moving_) out.push_back(&o);
  }

  void trace_ground(const Ray& ray, Hit& hit) override { ground_.trace(ray, hit); }
  double ground_height(V2 p) override { return ground_.surface(p); }

 private:
  void add_driver(const Driver& d, std::int64_t t_ns) {
    Object o;
    double speed = 0;
    const Waypoint w = d.route.at(traffic_.way(d, t_ns, speed));
    o.at = {w.at.x, w.at.y, town_.height(w.at) + 0.05};
    o.c = w.heading.x, o.s = w.heading.y;
    o.vx = speed * w.heading.x, o.vy = speed * w.heading.y;
    o.parts = d.model->parts.data();
    o.part_count = static_cast<std::uint32_t>(d.model->parts.size());
    o.id = static_cast<std::uint32_t>(mix(d.id));
    o.paint = d.paint;
    o.label = Label::Vehicle;
    o.kind = d.model->kind;
    set_bounds(o);
    moving_.push_back(o);
  }

  // Walkers go round their block in one direction or the other, and stop at times.
  void add_walkers(const Block& block, std::int64_t t_ns) {
    if (block.round.size() < 3) return;
    double around = 0;
    for (std::size_t k = 0; k < block.round.size(); ++k)
      around += length(block.round[(k + 1) % block.round.size()] - block.round[k]);
    const double seconds = static_cast<double>(t_ns) * 1e-9;
    for (int n = 0; n < block.walkers; ++n) {
      const std::uint64_t id = hash_of(block.id, 81, n);
      Rng rng(id);
      const bool back = rng.chance(0.5);
      const bool cycles = rng.chance(0.12);
      const double pace = cycles ? rng.between(3.0, 5.0) : (rng.chance(0.2) ? 0.0 : rng.between(0.8, 1.7));
      const double start = rng.between(0.0, around), side = rng.between(-0.7, 0.7);
      double s = fraction_of((start + (back ? -pace : pace) * seconds) / around) * around;
      std::size_t k = 0;
      V2 step{};
      double size = 0;
      for (;; ++k) {
        step = block.round[(k + 1) % block.round.size()] - block.round[k];
        size = length(step);
        if (s < size || k + 1 == block.round.size()) break;
        s -= size;
      }
      const V2 dir = step * (1.0 / size);
      const V2 at = block.round[k] + dir * s + V2{-dir.y, dir.x} * side;
      const Model& model =
          cycles ? models_.vehicle(Vehicle::Bicycle, id) : models_.walker(mix(id ^ 4), pace * seconds / 1.45 + start);
      Object o;
      o.at = {at.x, at.y, ground_.surface(at)};
      const double sign = back ? -1.0 : 1.0;
      o.c = sign * dir.x, o.s = sign * dir.y;
      o.vx = pace * o.c, o.vy = pace * o.s;
      o.parts = model.parts.data();
      o.part_count = static_cast<std::uint32_t>(model.parts.size());
      o.id = static_cast<std::uint32_t>(id);
      o.paint = static_cast<float>(0.08 + 0.5 * unit_of(mix(id ^ 5)));
      o.label = Label::Person;
      o.kind = model.kind;
      set_bounds(o);
      moving_.push_back(o);
    }
  }

  Town town_;
  Models models_;
  TownGround ground_;
  Blocks blocks_;
  Traffic traffic_;
  std::vector<Object> moving_;
};

}  // namespace

std::unique_ptr<World> make_city(const WorldOptions& options) { return std::make_unique<City>(options); }

}  // namespace lidarcodec::sim
