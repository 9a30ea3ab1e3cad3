// Plain scenes with the layouts of the reduction experiments: `street` (facades, trees, parked cars: easy) and `road`
// (bare and wide, a guard rail, cars alongside, far bushes: hard). Two more are hard: `bend`, with wide bends, a rail
// on one side and traffic, and `motorway`, with a rail in the middle and lorries and vans alongside. They are endless:
// the objects of each stretch of 60 m are drawn from the seed.
#include <map>

#include "simulator/town/models.hpp"
#include "simulator/world.hpp"

namespace lidarcodec::sim {
namespace {

using M = Material;

constexpr double kStretch = 60.0;

enum class Kind { Street, Road, Bend, Motorway };

// Where the middle of the road lies: y = kBendWidth sin(x / kBendLength), radii from 200 m up.
constexpr double kBendWidth = 24.0, kBendLength = 70.0;

struct Mate {  // a vehicle that drives along at the car's own speed
  double ahead, y, sway;
  Vehicle kind;
};
constexpr Mate kBendMates[] = {{12.0, 0.0, 1.2, Vehicle::Van},
                               {-11.0, 0.3, 0.8, Vehicle::Saloon},
                               {21.0, -3.5, 0.0, Vehicle::Estate},
                               {30.0, 0.1, 0.6, Vehicle::Truck}};
constexpr Mate kMotorwayMates[] = {{16.0, 0.1, 1.0, Vehicle::Saloon},   {-13.0, 0.2, 0.7, Vehicle::Estate},
                                   {4.0, -3.8, 0.5, Vehicle::Truck},    {-22.0, -3.6, 0.0, Vehicle::Van},
                                   {27.0, -3.7, 0.0, Vehicle::Truck},   {9.0, 3.6, 1.5, Vehicle::Offroad},
                                   {-7.0, 3.5, 0.9, Vehicle::Hatchback}};

struct Stretch {
  std::vector<Object> objects;
  std::vector<Part> parts;
  std::vector<std::size_t> first;

  // Adds an object with its own parts at (x, y). Shared models are added by `add_model`.
  void add(double x, double y, const Parts& own, Label label, std::uint64_t id) {
    Object o;
    o.at = {x, y, 0};
    o.part_count = static_cast<std::uint32_t>(own.size());
    o.parts = own.data();
    o.id = static_cast<std::uint32_t>(mix(id));
    o.label = label;
    set_bounds(o);
    o.parts = nullptr;
    first.push_back(parts.size());
    parts.insert(parts.end(), own.begin(), own.end());
    objects.push_back(o);
  }
};

class Plain final : public World {
 public:
  Plain(const WorldOptions& options, Kind kind)
      : seed_(hash_of(options.seed, 201 + static_cast<int>(kind))),
        kind_(kind),
        road_(kind != Kind::Street),
        speed_(options.speed > 0 ? options.speed : 12.0),
        traffic_(options.traffic) {}

  Pose pose(std::int64_t t_ns) override {
    const double t = static_cast<double>(t_ns) * 1e-9;
    const double yaw = 0.06 * sin_of(t / 4.0) + 0.01 * sin_of(t * 2.1);
    const double x = ahead(t), y = 1.2 * sin_of(t / 5.0) - 0.5;
    const double z = kSensorHeight + 0.02 * sin_of(t * 6.0);
    const double c = cos_of(yaw), s = sin_of(yaw), pitch = -0.006 * sin_of(t * 5.0), roll = 0.008 * sin_of(t * 3.3);
    if (kind_ != Kind::Bend) return pose_of({x, y, z}, c, s, pitch, roll);
    const V2 way = along(x);
    return pose_of({x, y + middle(x), z}, c * way.x - s * way.y, s * way.x + c * way.y, pitch, roll);
  }

  void gather(std::int64_t t_ns, double reach, std::vector<const Object*>& out) override {
    const double t = static_cast<double>(t_ns) * 1e-9, x = ahead(t);
    const std::int64_t a = floor_of((x - reach) / kStretch) - 1, b = floor_of((x + reach) / kStretch);
    while (!stretches_.empty() && stretches_.begin()->first < a) stretches_.erase(stretches_.begin());
    for (std::int64_t n = a; n <= b; ++n) {
      auto found = stretches_.find(n);
      if (found == stretches_.end()) found = stretches_.emplace(n, std::make_unique<Stretch>(make(n))).first;
      if (n == a) continue;  // kept for objects that reach out of it, dropped next time
      for (const Object& o : found->second->objects) out.push_back(&o);
    }
    moving_.clear();
    if (traffic_ > 0) add_traffic(t, x);
    for (const Object& o : moving_) out.push_back(&o);
  }

  void trace_ground(const Ray& ray, Hit& hit) override {
    const V3 &o = ray.origin, &d = ray.direction;
    if (d.z > -0.004) return;
    double t = -o.z / d.z;
    for (int k = 0; k < 6; ++k) t = (height({o.x + t * d.x, o.y + t * d.y}) - o.z) / d.z;
    if (t <= 0.5 || t >= hit.t) return;
    hit.t = t;
    hit.cosine = -d.z;
    hit.local = o + d * t;
    const double y = abs_of(hit.local.y - middle(hit.local.x)), edge = road_ ? 10.0 : 5.4;
    hit.material = y < edge ? M::Asphalt : (road_ ? M::Grass : M::Slabs);
    const bool line = road_
                          ? abs_of(y - 9.2) < 0.08 || (abs_of(y - 1.9) < 0.07 && fraction_of(hit.local.x / 12.0) < 0.35)
                          : y < 0.07 && fraction_of(hit.local.x / 9.0) < 0.4;
    if (line) hit.material = M::RoadPaint;
    hit.albedo = -1;
    hit.label = Label::Ground;
    hit.id = 0;
  }

  double ground_height(V2 p) override { return height(p); }

 private:
  double middle(double x) const { return kind_ == Kind::Bend ? kBendWidth * sin_of(x / kBendLength) : 0.0; }
  // Cosine and sine of the road's direction.
  V2 along(double x) const {
    if (kind_ != Kind::Bend) return {1.0, 0.0};
    const double derivative = kBendWidth / kBendLength * cos_of(x / kBendLength);
    const double c = 1.0 / std::sqrt(1.0 + derivative * derivative);
    return {c, derivative * c};
  }
  double ahead(double t) const { return speed_ * t + 0.8 * sin_of(t / 1.7); }
  static double height(V2 p) { return 0.06 * sin_of(p.x / 17.0) + 0.05 * sin_of(p.y / 9.0 + p.x / 41.0); }

  Stretch make(std::int64_t n) const {
    Rng rng(hash_of(seed_, n));
    Stretch s;
    const double x0 = static_cast<double>(n) * kStretch;
    for (const double side : {-1.0, 1.0}) road_ ? add_roadside(rng, s, x0, side) : add_streetside(rng, s, x0, side);
    if (road_ && kind_ != Kind::Bend && n % 3 == 0) {
      const Parts sign{box(M::Retro, 90, 92, 14.0, 14.3, 1.5, 4.0), cylinder(M::Metal, 90.4, 14.15, 0.06, 0, 1.5),
                       cylinder(M::Metal, 91.6, 14.15, 0.06, 0, 1.5)};
      s.add(x0, 0, sign, Label::Pole, rng.next());
    }
    for (std::size_t k = 0; k < s.objects.size(); ++k) {
      Object& o = s.objects[k];
      o.parts = s.parts.data() + s.first[k];
      if (kind_ == Kind::Bend) {
        const V2 way = along(o.at.x);
        o.at.y += middle(o.at.x);
        o.c = way.x;
        o.s = way.y;
        set_bounds(o);
      }
      o.at.z = height({o.at.x, o.at.y});
    }
    return s;
  }

  void add_streetside(Rng& rng, Stretch& s, double x0, double side) const {
    for (double x = x0; x < x0 + kStretch - 4.0;) {  // house after house, now and then a gap
      const double w = min_of(rng.between(8.0, 22.0), x0 + kStretch - x), d = rng.between(8.0, 12.0),
                   back = rng.between(8.0, 11.0);
      const double h = rng.between(6.0, 14.0);
      const double y0 = side > 0 ? back : -back - d;
      s.add(x, 0, {facade_box(M::Plaster, 0, w, y0, y0 + d, -0.6, h, 3.1, 2.9, 3.2, facade::kBlindEnds)},
            Label::Building, rng.next());
      x += w + (rng.chance(0.4) ? rng.between(2.0, 8.0) : 0.0);
    }
    for (double x = x0; x < x0 + kStretch; x += 15.0) {
      if (!rng.chance(0.7)) continue;
      const double r = rng.between(0.12, 0.3), crown = rng.between(1.4, 2.3);
      const double tx = x + 2.0 * rng.normal(), ty = side * rng.between(5.8, 6.6);
      s.add(tx, ty, {cylinder(M::Bark, 0, 0, r, -0.3, 4.0), leaves(0, 0, 4.8, crown, crown, crown, 0.2, 0.16)},
            Label::Vegetation, rng.next());
    }
    for (double x = x0; x < x0 + kStretch - 1.0; x += 30.0)
      s.add(x + rng.normal(), side * 5.6, {cylinder(M::Metal, 0, 0, 0.08, -0.2, 7.0)}, Label::Pole, 7);
    for (double x = x0 + 3.0; x < x0 + kStretch - 2.0; x += 6.5) {
      if (!rng.chance(0.6)) continue;
      const std::uint64_t id = rng.next();
      s.add(x + 0.3 * rng.normal(), side * 4.4, models_.plain_car().parts, Label::Vehicle, id);
      s.objects.back().paint = usual_paint(id);
      s.objects.back().kind = models_.plain_car().kind;
    }
  }

  void add_roadside(Rng& rng, Stretch& s, double x0, double side) const {
    const double x = x0 + 3.0 * rng.normal();
    s.add(x + 10.0, side * rng.between(13.0, 15.0), {cylinder(M::Metal, 0, 0, 0.1, -0.2, 8.0)}, Label::Pole, 7);
    if (rng.chance(0.6)) {
      const double r = rng.between(1.0, 2.5), bx = x0 + 30.0 + 15.0 * rng.normal(), by = side * rng.between(18.0, 35.0);
      s.add(bx, by, {leaves(0, 0, 0.8, r, r, r, 0.25, 0.14)}, Label::Vegetation, rng.next());
    }
    if (kind_ == Kind::Bend && side > 0) return;
    const bool between = kind_ == Kind::Motorway && side > 0;   // the two directions
    for (double rail = x0; rail < x0 + kStretch; rail += 12.0)  // in pieces that follow the ground
      s.add(rail, between ? 5.6 : side * 11.07,
            {box(M::Metal, 0, 12.0, -0.07, 0.07, 0.35, 0.75), cylinder(M::Metal, 1.0, 0, 0.05, -0.1, 0.7),
             cylinder(M::Metal, 5.0, 0, 0.05, -0.1, 0.7), cylinder(M::Metal, 9.0, 0, 0.05, -0.1, 0.7)},
            Label::Other, 8);
  }

  void add_car(double x, double y, double vx, std::uint64_t id) {
    add_vehicle(x + 2.15, y, vx, id, models_.plain_car());
  }

  // The middle of the vehicle at x along the road and y beside its middle.
  void add_vehicle(double x, double y, double vx, std::uint64_t id, const Model& car) {
    Object o;
    const V2 way = along(x);
    const double turn = vx < 0 ? -1.0 : 1.0;
    o.at = {x, y + middle(x), 0};
    o.at.z = height({o.at.x, o.at.y});
    o.c = turn * way.x;
    o.s = turn * way.y;
    o.vx = vx;
    o.vy = vx * way.y / way.x;
    o.parts = car.parts.data();
    o.part_count = static_cast<std::uint32_t>(car.parts.size());
    o.id = static_cast<std::uint32_t>(mix(id));
    o.paint = usual_paint(mix(id));
    o.label = Label::Vehicle;
    o.kind = car.kind;
    set_bounds(o);
    moving_.push_back(o);
  }

  void add_traffic(double t, double x) {
    const double own = speed_ + 0.8 / 1.7 * cos_of(t / 1.7);
    if (kind_ == Kind::Bend) {
      add_mates(kBendMates, t, x, own);
    } else if (kind_ == Kind::Motorway) {
      add_mates(kMotorwayMates, t, x, own);
    } else if (road_) {
      add_car(x + 9.0 + 1.5 * sin_of(t / 2.0), 0.2, own + 0.75 * cos_of(t / 2.0), 1);
      add_car(x + 24.0, -3.4, own, 2);
      add_car(x - 14.0, -3.5, own, 3);
      add_car(x + 33.0, 3.6, own, 4);
    } else {
      add_car(x + 16.0, 0.1, own, 1);
    }
    const double oncoming = -1.1 * speed_, first = 300.0 + oncoming * t;
    const std::int64_t n = floor_of((x - 130.0 - first) / 70.0);
    for (std::int64_t k = n < 0 ? 0 : n; first + 70.0 * static_cast<double>(k) < x + 130.0; ++k)
      add_car(first + 70.0 * static_cast<double>(k), road_ ? 7.4 : 2.6, oncoming, hash_of(9, k));
  }

  template <std::size_t N>
  void add_mates(const Mate (&mates)[N], double t, double x, double own) {
    for (std::size_t k = 0; k < N; ++k) {
      const Mate& m = mates[k];
      const double slow = 2.0 + 0.5 * static_cast<double>(k);  // each has its own period
      const double at = x + m.ahead + m.sway * sin_of(t / slow);
      add_vehicle(at, m.y, own + m.sway / slow * cos_of(t / slow), k + 1, models_.vehicle(m.kind, hash_of(seed_, k)));
    }
  }

  std::uint64_t seed_;
  Kind kind_;
  bool road_;
  double speed_, traffic_;
  Models models_;
  std::map<std::int64_t, std::unique_ptr<Stretch>> stretches_;
  std::vector<Object> moving_;
};

}  // namespace

std::unique_ptr<World> make_road(const WorldOptions& o) { return std::make_unique<Plain>(o, Kind::Road); }
std::unique_ptr<World> make_street(const WorldOptions& o) { return std::make_unique<Plain>(o, Kind::Street); }
std::unique_ptr<World> make_bend(const WorldOptions& o) { return std::make_unique<Plain>(o, Kind::Bend); }
std::unique_ptr<World> make_motorway(const WorldOptions& o) { return std::make_unique<Plain>(o, Kind::Motorway); }

}  // namespace lidarcodec::sim
