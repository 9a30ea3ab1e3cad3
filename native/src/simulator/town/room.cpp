// The scene `room`: a laboratory. The sensor stands still on a table among boxes, screens and people, as most sensors
// do when they are tried out; half of what it sees is nearer than a metre. Every seed is another room.
// Each random number is drawn in a statement of its own: compilers differ in the order of arguments.
#include <array>

#include "simulator/town/models.hpp"
#include "simulator/world.hpp"

namespace lidarcodec::sim {
namespace {

using M = Material;

constexpr double kTable = 0.75;   // height of the table
constexpr double kSensor = 0.87;  // height of the sensor
constexpr double kCeiling = 2.7;
constexpr int kPeople = 4;

class Room final : public World {
 public:
  explicit Room(const WorldOptions& options) : seed_(hash_of(options.seed, 401)), traffic_(options.traffic) {
    Rng rng(seed_);
    things_.reserve(4096);
    parts_.reserve(4096);
    for (double& wall : walls_) wall = rng.between(2.6, 7.0);
    add_shell(rng);
    for (int side = 0; side < 4; ++side) add_wall(rng, side);
    add_table(rng);
    for (int n = 0; n < 30; ++n) add_furniture(rng);
    for (Person& person : people_) {
      const double turn = rng.unit(), near = rng.between(0.75, 1.1), u = rng.unit(), v = rng.unit();
      const double sway = rng.between(0.1, 0.3);
      person = {turn, near + 1.6 * u * v, sway, rng.next()};
    }
  }

  Pose pose(std::int64_t) override { return pose_of({0, 0, kSensor}, 1, 0, 0, 0); }
  bool on_a_car() const override { return false; }
  double ground_height(V2) override { return 0; }

  void gather(std::int64_t t_ns, double, std::vector<const Object*>& out) override {
    for (const Object& o : things_) out.push_back(&o);
    people_now_.clear();
    if (traffic_ > 0) add_people(static_cast<double>(t_ns) * 1e-9);
    for (const Object& o : people_now_) out.push_back(&o);
  }

  void trace_ground(const Ray& ray, Hit& hit) override {
    if (ray.direction.z > -1e-6) return;
    const double t = -ray.origin.z / ray.direction.z;
    if (t <= 0 || t >= hit.t) return;
    hit = Hit{};
    hit.t = t;
    hit.cosine = -ray.direction.z;
    hit.local = ray.origin + ray.direction * t;
    hit.material = M::Plastic;
    hit.label = Label::Ground;
  }

 private:
  struct Person {
    double turn = 0, distance = 1, sway = 0;
    std::uint64_t id = 0;
  };

  void add(V3 at, double turns, float paint, Label label, std::uint64_t id, Parts parts) {
    parts_.push_back(std::move(parts));
    Object o;
    o.at = at;
    o.c = cos_of(turns * kTurn), o.s = sin_of(turns * kTurn);
    o.part_count = static_cast<std::uint32_t>(parts_.back().size());
    o.parts = parts_.back().data();
    o.id = static_cast<std::uint32_t>(mix(id));
    o.paint = paint;
    o.label = label;
    set_bounds(o);
    things_.push_back(o);
  }

  // Paper, board and light paint, colours, and black things, of which many beams do not come back.
  static float paint(Rng& rng) {
    const double u = rng.unit();
    if (u < 0.25) return static_cast<float>(rng.between(0.03, 0.10));
    if (u < 0.60) return static_cast<float>(rng.between(0.15, 0.50));
    return static_cast<float>(rng.between(0.55, 0.95));
  }

  void add_shell(Rng& rng) {
    const double a = -walls_[2] - 0.2, b = walls_[0] + 0.2, c = -walls_[3] - 0.2, d = walls_[1] + 0.2;
    add({0, 0, 0}, 0, 0.8F, Label::Building, rng.next(), {box(M::Painted, a, b, c, d, kCeiling, kCeiling + 0.2)});
    for (double x = a + 0.9; x < b; x += 1.8)
      add({x, 0, 0}, 0, 0.9F, Label::Building, rng.next(),
          {box(M::Painted, -0.1, 0.1, c + 0.5, d - 0.5, kCeiling - 0.07, kCeiling - 0.01)});
  }

  // A wall with a door, boards, sockets and a shelf full of things. Along it: `u`; into the room: `v`.
  void add_wall(Rng& rng, int side) {
    const double far = walls_[static_cast<std::size_t>(side)];
    const double most =
        max_of(walls_[static_cast<std::size_t>((side + 1) % 4)], walls_[static_cast<std::size_t>((side + 3) % 4)]);
    const double turns = 0.25 * side;
    const auto on = [&](double front, double u0, double u1, double z0, double z1, M m, float albedo) {
      add({0, 0, 0}, turns, albedo, Label::Building, rng.next(), {box(m, far - front, far + 0.05, u0, u1, z0, z1)});
    };
    on(0, -most - 0.2, most + 0.2, 0, kCeiling, M::Painted, static_cast<float>(rng.between(0.6, 0.9)));
    const double door = rng.between(-most, most - 1.0);
    on(0.05, door, door + 0.9, 0, 2.0, M::Painted, paint(rng));
    for (int n = 0; n < 30; ++n) {
      const double u = rng.between(-most, most - 0.5), z = rng.between(0.4, 1.9);
      const float colour = paint(rng);
      const double high = rng.between(0.1, 0.6), wide = rng.between(0.2, 1.2), front = rng.between(0.01, 0.04);
      on(front, u, u + wide, z, z + high, M::Painted, colour);
    }
    if (rng.chance(0.6)) {  // a window, through which beams are lost
      const double u = rng.between(-most, most - 2.0);
      on(0.07, u, u + rng.between(1.5, 3.5), 0.9, 2.2, M::Cabin, 0.1F);
    }
    const double from = rng.between(-most, most - 2.0), width = rng.between(2.0, 4.0);
    for (double z = 0.1; z < 2.0; z += 0.4) {
      on(0.4, from, from + width, z - 0.03, z, M::Metal, 0);
      for (double u = from; u < from + width; u += rng.between(0.04, 0.22)) {
        if (!rng.chance(0.75)) continue;
        const float colour = paint(rng);
        const double high = rng.between(0.08, 0.33), wide = rng.between(0.03, 0.2), front = rng.between(0.1, 0.4);
        on(front, u, u + wide, z, z + high, M::Painted, colour);
      }
    }
  }

  void add_table(Rng& rng) {
    const double half = rng.between(0.5, 0.75);
    const std::uint64_t table = rng.next();
    add({0, 0, 0}, rng.unit(), 0.5F, Label::Other, table,
        {box(M::Painted, -half, half, -half, half, kTable - 0.03, kTable)});
    for (int n = 0; n < 24; ++n) {
      const double turns = rng.unit(), near = rng.between(0.34, 0.8), u = rng.unit(), v = rng.unit();
      const double wide = 0.012 + 0.10 * u * v, a = rng.unit(), b = rng.unit();
      const double high = kTable + 0.05 + 0.32 * a * b, far = near + rng.between(0.03, 0.2);
      const std::uint64_t id = rng.next();
      add({0, 0, 0}, turns, paint(rng), Label::Other, id, {box(M::Painted, near, far, -wide, wide, kTable, high)});
      add_papers(rng, {0, 0, 0}, turns, near, wide, kTable, high, 5);
    }
    for (int n = 0; n < 12; ++n) {  // cables, stands and tools
      const double turns = rng.unit(), near = rng.between(0.34, 0.9), lean = rng.between(-0.15, 0.15);
      const double thick = rng.between(0.003, 0.015);
      const double top = kTable + rng.between(0.1, 0.6);
      const std::uint64_t id = rng.next();
      add({0, 0, 0}, turns, paint(rng), Label::Other, id,
          {taper(M::Painted, near - thick, near + thick, -thick, thick, kTable, near - thick, near + thick,
                 lean - thick, lean + thick, top)});
    }
    // Screens and partitions around the table.
    const int panels = 1 + rng.below(2);
    for (int n = 0; n < panels; ++n) {
      const double near = rng.between(0.45, 0.95), wide = rng.between(0.3, 0.8);
      const double turns = rng.unit(), high = rng.between(1.05, 1.6);
      const bool screen = rng.chance(0.4);
      const std::uint64_t id = rng.next();
      add({0, 0, 0}, turns, paint(rng), Label::Other, id,
          {box(screen ? M::Cabin : M::Painted, near, near + 0.04, -wide, wide, kTable - 0.4, high)});
      if (!screen) add_papers(rng, {0, 0, 0}, turns, near, wide, kTable, high, 36);
    }
  }

  // Notes, labels, switches and prints on a front that looks towards the sensor: they differ in colour, hardly in
  // range.
  void add_papers(Rng& rng, V3 at, double turns, double front, double wide, double low, double high, int count) {
    for (int n = 0; n < count; ++n) {
      const double u = rng.between(-wide, 0.8 * wide), z = rng.between(low, high - 0.04);
      const double right = min_of(u + rng.between(0.01, 0.12), wide), top = min_of(z + rng.between(0.01, 0.2), high);
      const double thick = rng.between(0.001, 0.012);
      const std::uint64_t id = rng.next();
      add(at, turns, paint(rng), Label::Other, id, {box(M::Painted, front - thick, front + 0.01, u, right, z, top)});
    }
  }

  void add_furniture(Rng& rng) {
    const double turns = rng.unit(), far = rng.between(1.7, 5.0), twist = rng.between(-0.1, 0.1);
    const V3 at{far * cos_of(turns * kTurn), far * sin_of(turns * kTurn), 0};
    if (at.x > walls_[0] - 0.6 || at.x < 0.6 - walls_[2] || at.y > walls_[1] - 0.6 || at.y < 0.6 - walls_[3]) return;
    const float colour = paint(rng);
    const double wide = rng.between(0.2, 0.6), deep = rng.between(0.2, 0.4);
    if (rng.chance(0.35)) {  // a chair
      add(at, turns + twist, colour, Label::Other, rng.next(),
          {box(M::Cloth, -0.25, 0.25, -0.25, 0.25, 0.42, 0.5), box(M::Cloth, 0.2, 0.27, -0.22, 0.22, 0.5, 1.0),
           box(M::Metal, -0.03, 0.03, -0.03, 0.03, 0.05, 0.42), box(M::Metal, -0.3, 0.3, -0.03, 0.03, 0.03, 0.07)});
      return;
    }
    const double high = rng.between(0.7, 1.9);  // a cabinet, or a stack of boxes
    add(at, turns + twist, colour, Label::Other, rng.next(), {box(M::Painted, -deep, deep, -wide, wide, 0, high)});
    add_papers(rng, at, turns + twist, -deep, wide, 0.1, high, 24);
    const double top = high + rng.between(0.1, 0.5);
    const std::uint64_t id = rng.next();
    add(at, turns + 2 * twist, paint(rng), Label::Other, id,
        {box(M::Painted, -0.6 * deep, 0.6 * deep, -0.6 * wide, 0.5 * wide, high, top)});
  }

  void add_people(double t) {
    for (const Person& person : people_) {
      const Model& model = models_.walker(mix(person.id), 0);
      const double turns = person.turn + 0.01 * person.sway * sin_of(t * 0.9 + person.turn * 9);
      const double distance = person.distance + 0.1 * person.sway * sin_of(t * 0.6 + person.turn * 5);
      Object o;
      o.at = {distance * cos_of(turns * kTurn), distance * sin_of(turns * kTurn), 0};
      o.c = -cos_of(turns * kTurn), o.s = -sin_of(turns * kTurn);
      o.parts = model.parts.data();
      o.part_count = static_cast<std::uint32_t>(model.parts.size());
      o.id = static_cast<std::uint32_t>(person.id);
      o.paint = static_cast<float>(0.08 + 0.6 * unit_of(mix(person.id ^ 5)));
      o.label = Label::Person;
      o.kind = model.kind;
      set_bounds(o);
      people_now_.push_back(o);
    }
  }

  static constexpr double kTurn = 6.283185307179586;  // radians

  std::uint64_t seed_;
  double traffic_;
  std::array<double, 4> walls_{};  // from the sensor: ahead, left, behind, right
  std::array<Person, kPeople> people_;
  Models models_;
  std::vector<Parts> parts_;
  std::vector<Object> things_, people_now_;
};

}  // namespace

std::unique_ptr<World> make_room(const WorldOptions& options) { return std::make_unique<Room>(options); }

}  // namespace lidarcodec::sim
