#include "simulator/simulator.hpp"

#include <algorithm>

#include "base/error.hpp"
#include "simulator/own_car.hpp"

namespace lidarcodec::sim {
namespace {

constexpr std::uint64_t kIndexPackets = 29;  // a twelfth of a turn: 8.4 ms
constexpr double kSlack = 0.5;               // metres the sensor moves in that time, and the offsets of the lasers

}  // namespace

std::unique_ptr<World> make_world(const SimulatorOptions& options) {
  if (!(options.world.speed >= 0 && options.world.speed <= 40))
    throw Error(ErrorCode::Settings, "speed is 0.5 to 40 m/s, or 0 for what the scene has");
  if (options.world.speed > 0 && options.world.speed < 0.5)
    throw Error(ErrorCode::Settings, "speed is at least 0.5 m/s");
  if (!(options.world.traffic >= 0 && options.world.traffic <= 3))
    throw Error(ErrorCode::Settings, "traffic is 0 to 3");
  if (options.scene == "city") return make_city(options.world);
  if (options.scene == "road") return make_road(options.world);
  if (options.scene == "street") return make_street(options.world);
  if (options.scene == "bend") return make_bend(options.world);
  if (options.scene == "motorway") return make_motorway(options.world);
  if (options.scene == "garage") return make_garage(options.world);
  if (options.scene == "room") return make_room(options.world);
  throw Error(ErrorCode::Settings, "no such scene");
}

Simulator::Simulator(const SimulatorOptions& options)
    : world_(make_world(options)),
      sensor_(hash_of(0x64E52, 1)),
      receiver_(sensor_, hash_of(options.world.seed, 101)),
      rotor_(hash_of(options.world.seed, 102)),
      status_(options.start_ns, hash_of(options.world.seed, 103)),
      luck_(hash_of(options.world.seed, 104)) {}

void Simulator::look_around(std::int64_t t_ns, V3 at) {
  objects_.clear();
  world_->gather(t_ns, kReach, objects_);
  index_.build(objects_, at, kReach, kSlack, 0.01);
  index_ns_ = t_ns;
  looked_ = true;
}

void Simulator::packets(std::size_t count, std::uint8_t* out, Truth* truth) {
  const std::lock_guard lock(busy_);
  if (truth) {
    truth->distance_m.reserve(count * kFiringsPerPacket * kLasers);
    truth->label.reserve(count * kFiringsPerPacket * kLasers);
  }
  std::array<Echo, kLasers> echoes;
  for (std::size_t n = 0; n < count; ++n, ++packet_, out += kPacketBytes) {
    const std::int64_t start = static_cast<std::int64_t>(packet_) * kPacketNs;
    if (packet_ % kIndexPackets == 0 || !looked_) look_around(start, world_->pose(start).at);
    for (int f = 0; f < kFiringsPerPacket; ++f) {
      const std::int64_t now = start + f * kFiringNs;
      const std::uint64_t firing = packet_ * kFiringsPerPacket + static_cast<std::uint64_t>(f);
      const Pose pose = world_->pose(now);
      const double dt = static_cast<double>(now - index_ns_) * 1e-9;
      const int azimuth = rotor_.next();
      for (int laser = 0; laser < kLasers; ++laser) {
        const Beam beam = sensor_.beam(laser, azimuth);
        Ray ray{pose.at + pose.turn(beam.origin), pose.turn(beam.direction),
                hash_of(luck_, static_cast<std::int64_t>(firing), laser)};
        Hit hit;
        hit.t = kReach;
        if (world_->on_a_car() && own_car_at(beam, ray.luck) > 0) {  // nearer than the sensor can measure
          hit.label = Label::Vehicle;
        } else
          // Steep beams soon hit the ground, and few objects are nearer. For level beams objects come first.
          if (ray.direction.z < -0.06) {
            world_->trace_ground(ray, hit);
            index_.trace(ray, dt, hit);
          } else {
            index_.trace(ray, dt, hit);
            world_->trace_ground(ray, hit);
          }
        echoes[static_cast<std::size_t>(laser)] = receiver_.receive(laser, firing, hit);
        if (truth) {
          truth->distance_m.push_back(hit.material == Material::Nothing ? 0.0F : static_cast<float>(hit.t));
          truth->label.push_back(static_cast<std::uint8_t>(hit.label));
        }
      }
      write_firing(out, f, azimuth, echoes);
    }
    status_.write(packet_, out + 1200);
  }
}

void Simulator::ground_height(const double* places, std::size_t count, double* out) {
  const std::lock_guard lock(busy_);
  for (std::size_t n = 0; n < count; ++n) out[n] = world_->ground_height({places[2 * n], places[2 * n + 1]});
}

void Simulator::skip(std::uint64_t count) {
  const std::lock_guard lock(busy_);
  for (std::uint64_t n = 0; n < count * kFiringsPerPacket; ++n) rotor_.next();
  packet_ += count;
  looked_ = false;
}

PoseFinder::PoseFinder(const SimulatorOptions& options) : options_(options), world_(make_world(options)) {}

void PoseFinder::drive_to(std::int64_t t_ns) {
  if (t_ns < last_ns_) world_ = make_world(options_);
  last_ns_ = t_ns;
}

std::vector<RoadUser> PoseFinder::road_users(std::int64_t t_ns, double reach) {
  const std::lock_guard lock(busy_);
  drive_to(t_ns);
  std::vector<const Object*> objects;
  world_->gather(t_ns, reach, objects);
  const V3 here = world_->pose(t_ns).at;
  std::vector<RoadUser> found;
  for (const Object* o : objects) {
    if (o->kind == ObjectKind::None || length(V2{o->at.x - here.x, o->at.y - here.y}) > reach) continue;
    RoadUser user{o->kind, o->id, o->at, o->c, o->s, o->vx, o->vy, {}, {}};
    std::copy(o->lo, o->lo + 3, user.lo);
    std::copy(o->hi, o->hi + 3, user.hi);
    found.push_back(user);
  }
  return found;
}

void PoseFinder::at(const std::int64_t* t_ns, std::size_t count, double* out) {
  const std::lock_guard lock(busy_);
  for (std::size_t n = 0; n < count; ++n) {
    drive_to(t_ns[n]);
    const Pose p = world_->pose(t_ns[n]);
    const double at[3] = {p.at.x, p.at.y, p.at.z};
    for (std::size_t row = 0; row < 3; ++row) {
      for (std::size_t k = 0; k < 3; ++k) *out++ = p.m[3 * row + k];
      *out++ = at[row];
    }
    *out++ = 0, *out++ = 0, *out++ = 0, *out++ = 1;
  }
}

}  // namespace lidarcodec::sim
