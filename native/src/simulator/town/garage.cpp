// The scene `garage`: a parking garage without end. A lane between two rows of parked cars, pillars, walls, a ceiling
// with beams and pipes, people, and a car ahead. All is near, as in the rooms in which many sensors work.
#include <map>

#include "simulator/town/models.hpp"
#include "simulator/world.hpp"

namespace lidarcodec::sim {
namespace {

using M = Material;

constexpr double kBay = 7.5;  // from pillar to pillar: three parked cars
constexpr double kWall = 8.2, kCeiling = 2.9, kDoor = 0.12;
constexpr double kLane = 3.0;  // half its width

struct Bay {
  std::vector<Object> objects;
  std::vector<Parts> own;
};

class Garage final : public World {
 public:
  explicit Garage(const WorldOptions& options)
      : seed_(hash_of(options.seed, 301)), speed_(options.speed > 0 ? options.speed : 3.0), traffic_(options.traffic) {}

  Pose pose(std::int64_t t_ns) override {
    const double t = static_cast<double>(t_ns) * 1e-9;
    const double yaw = 0.05 * sin_of(t / 3.0);
    const double pitch = 0.002 * sin_of(t * 4.0), roll = 0.002 * sin_of(t * 2.7);
    return pose_of({ahead(t), 0.4 * sin_of(t / 4.0), kSensorHeight + 0.004 * sin_of(t * 6.0)}, cos_of(yaw), sin_of(yaw),
                   pitch, roll);
  }

  void gather(std::int64_t t_ns, double reach, std::vector<const Object*>& out) override {
    const double t = static_cast<double>(t_ns) * 1e-9, x = ahead(t);
    const std::int64_t a = floor_of((x - reach) / kBay), b = floor_of((x + reach) / kBay);
    while (!bays_.empty() && bays_.begin()->first < a) bays_.erase(bays_.begin());
    for (std::int64_t n = a; n <= b; ++n) {
      auto found = bays_.find(n);
      if (found == bays_.end()) found = bays_.emplace(n, make(n)).first;
      for (const Object& o : found->second->objects) out.push_back(&o);
    }
    moving_.clear();
    if (traffic_ > 0) add_moving(t, x);
    for (const Object& o : moving_) out.push_back(&o);
  }

  void trace_ground(const Ray& ray, Hit& hit) override {
    if (ray.direction.z > -1e-6) return;
    const double t = -ray.origin.z / ray.direction.z;
    if (t <= 0 || t >= hit.t) return;
    hit.t = t;
    hit.cosine = -ray.direction.z;
    hit.local = ray.origin + ray.direction * t;
    const double y = abs_of(hit.local.y);
    const bool between = y > kLane + 0.2 && fraction_of(hit.local.x / (kBay / 3.0)) < 0.04;
    hit.material = between || abs_of(y - kLane - 0.2) < 0.05 ? M::RoadPaint : M::Concrete;
    hit.albedo = -1;
    hit.rough_m = 0;
    hit.label = Label::Ground;
    hit.id = 0;
  }

  double ground_height(V2) override { return 0; }

 private:
  double ahead(double t) const { return speed_ * t + 0.3 * sin_of(t / 1.9); }

  std::unique_ptr<Bay> make(std::int64_t n) const {
    Rng rng(hash_of(seed_, n));
    auto bay = std::make_unique<Bay>();
    const double x0 = static_cast<double>(n) * kBay;
    const auto add = [&](double x, double y, Parts parts, Label label, std::uint64_t id) {
      bay->own.push_back(std::move(parts));
      Object o;
      o.at = {x, y, 0};
      o.part_count = static_cast<std::uint32_t>(bay->own.back().size());
      o.id = static_cast<std::uint32_t>(mix(id));
      o.label = label;
      o.parts = bay->own.back().data();
      set_bounds(o);
      bay->objects.push_back(o);
    };
    bay->own.reserve(16);
    add(x0, 0, {box(M::Concrete, 0, kBay, -kWall - 0.3, kWall + 0.3, kCeiling, kCeiling + 0.3)}, Label::Building, 11);
    add(x0, 0, {box(M::Concrete, -0.2, 0.2, -kWall, kWall, kCeiling - 0.35, kCeiling)}, Label::Building, 12);
    add(x0, 0,
        {box(M::Metal, 0, kBay, 1.9, 2.02, 2.6, 2.72), box(M::Metal, 0, kBay, 2.2, 2.26, 2.62, 2.68),
         box(M::Plastic, 1.5, 2.8, -0.1, 0.1, 2.75, 2.83)},
        Label::Other, 13);
    for (const double side : {-1.0, 1.0}) {
      const double y = side * (kWall + 0.15);
      Parts wall{box(M::Plaster, 0, kBay, y - 0.15, y + 0.15, 0, kCeiling)};
      if (rng.chance(0.25)) {
        const double at = rng.between(1.0, 6.0), face = side * (kWall - kDoor / 2);
        wall.push_back(box(M::Metal, at, at + 0.95, face - kDoor / 2, face + kDoor / 2, 0, 2.1));
      }
      add(x0, 0, std::move(wall), Label::Building, rng.next());
      add(x0, side * (kLane + 0.5), {box(M::Concrete, -0.22, 0.22, -0.22, 0.22, 0, kCeiling)}, Label::Building, 14);
      for (int place = 0; place < 3; ++place) {
        const std::uint64_t id = rng.next();
        const bool there = rng.chance(0.62), forward = rng.chance(0.6);
        if (!there) continue;
        const Model& car = models_.vehicle(usual_car(id), id);
        Object o;
        o.at = {x0 + (place + 0.5) * (kBay / 3.0) + 0.1, side * (kWall - 0.5 - car.length / 2), 0};
        o.s = forward == (side > 0) ? 1.0 : -1.0;
        o.c = 0;
        o.parts = car.parts.data();
        o.part_count = static_cast<std::uint32_t>(car.parts.size());
        o.id = static_cast<std::uint32_t>(mix(id));
        o.paint = usual_paint(id);
        o.label = Label::Vehicle;
        o.kind = car.kind;
        set_bounds(o);
        bay->objects.push_back(o);
      }
    }
    return bay;
  }

  static Vehicle usual_car(std::uint64_t id) {
    constexpr Vehicle kCars[] = {Vehicle::Hatchback, Vehicle::Saloon, Vehicle::Estate, Vehicle::Offroad};
    return kCars[mix(id) % 4];
  }

  void add_moving(double t, double x) {
    Object car;
    const Model& model = models_.vehicle(Vehicle::Hatchback, seed_);
    car.at = {x + 11.0 + 1.5 * sin_of(t / 2.5), 0.2, 0};
    car.vx = speed_ + 0.3 / 1.9 * cos_of(t / 1.9) + 1.5 / 2.5 * cos_of(t / 2.5);
    car.parts = model.parts.data();
    car.part_count = static_cast<std::uint32_t>(model.parts.size());
    car.id = static_cast<std::uint32_t>(mix(seed_));
    car.paint = usual_paint(seed_);
    car.label = Label::Vehicle;
    car.kind = model.kind;
    set_bounds(car);
    moving_.push_back(car);
    for (std::int64_t n = floor_of(x / 23.0) - 2; n <= floor_of(x / 23.0) + 2; ++n) {
      const std::uint64_t id = hash_of(seed_, 7, n);
      Rng rng(id);
      const double from = rng.between(0.0, 15.0), pace = rng.between(-1.4, 1.4);
      const double side = rng.chance(0.5) ? 1.0 : -1.0, beside = rng.between(2.0, 2.7);
      const double walked = fraction_of((from + pace * t) / 18.0) * 18.0;
      const Model& walker = models_.walker(mix(id), abs_of(pace) * t / 1.45);
      Object o;
      o.at = {static_cast<double>(n) * 23.0 + walked, side * beside, 0};
      o.c = pace < 0 ? -1.0 : 1.0;
      o.vx = pace;
      o.parts = walker.parts.data();
      o.part_count = static_cast<std::uint32_t>(walker.parts.size());
      o.id = static_cast<std::uint32_t>(id);
      o.paint = static_cast<float>(0.08 + 0.5 * unit_of(mix(id ^ 5)));
      o.label = Label::Person;
      o.kind = walker.kind;
      set_bounds(o);
      moving_.push_back(o);
    }
  }

  std::uint64_t seed_;
  double speed_, traffic_;
  Models models_;
  std::map<std::int64_t, std::unique_ptr<Bay>> bays_;
  std::vector<Object> moving_;
};

}  // namespace

std::unique_ptr<World> make_garage(const WorldOptions& options) { return std::make_unique<Garage>(options); }

}  // namespace lidarcodec::sim
