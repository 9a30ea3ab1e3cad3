#include "simulator/spinning.hpp"

#include <algorithm>
#include <numeric>

#include "simulator/own_car.hpp"

namespace lidarcodec::sim {
namespace {

constexpr std::int64_t kIndexNs = 8'350'000;  // how long an index is used
constexpr double kSlack = 0.5;                // metres the sensor moves in that time, and the offsets of the beams
constexpr double kMostReach = 150;            // metres around the car that are filled with objects
constexpr double kThroughLeaves = 0.15;       // firings into leaves that also meet what is behind
constexpr double kBehind = 0.3;               // metres
constexpr std::uint64_t kSteady = 8;          // firings for which another ray of the beam is the same

Pose between(const Pose& from, const Pose& to, double share) {
  Pose pose;
  pose.at = from.at + (to.at - from.at) * share;
  for (std::size_t k = 0; k < 9; ++k) pose.m[k] = from.m[k] + (to.m[k] - from.m[k]) * share;
  return pose;
}

}  // namespace

SpinningSimulator::SpinningSimulator(const SimulatorOptions& options, const DetectorTraits& traits, std::size_t rows)
    : world_(make_world(options)),
      detector_(traits, rows, hash_of(options.world.seed, 201)),
      reach_(min_of(traits.farthest_m, kMostReach)),
      luck_(hash_of(options.world.seed, 202)) {}

void SpinningSimulator::look_around(std::int64_t t_ns, V3 at) {
  objects_.clear();
  world_->gather(t_ns, reach_, objects_);
  index_.build(objects_, at, reach_, kSlack, 0.01);
  index_ns_ = t_ns;
  looked_ = true;
}

Hit SpinningSimulator::trace(const Ray& ray, double reach, double dt) {
  Hit hit;
  hit.t = reach;
  // Steep beams soon hit the ground, and few objects are nearer. For level beams objects come first.
  if (ray.direction.z < -0.06) {
    world_->trace_ground(ray, hit);
    index_.trace(ray, dt, hit);
  } else {
    index_.trace(ray, dt, hit);
    world_->trace_ground(ray, hit);
  }
  return hit;
}

bool SpinningSimulator::meet_another(const Ray& ray, const Hit& hit, std::uint64_t luck, double dt, Hit& other) {
  if (hit.material == Material::Leaf && unit_of(mix(ray.luck ^ 3)) < kThroughLeaves) {
    const double from = hit.t + kBehind;
    other = trace({ray.origin + ray.direction * from, ray.direction, luck}, max_of(reach_ - from, 0.0), dt);
    other.t += from;
    return other.material != Material::Nothing;
  }
  // Another ray of the beam, and nearly the same one of the next firings: a beam comes to an edge little by little.
  // Near the sensor the beam is as wide as the aperture.
  const double half = detector_.traits().spread + detector_.traits().aperture_m / max_of(hit.t, 0.5);
  const double aside = half * (2.0 * unit_of(luck) - 1.0), up = half * (2.0 * unit_of(mix(luck)) - 1.0);
  const V3 d = ray.direction;
  other = trace({ray.origin, {d.x - aside * d.y, d.y + aside * d.x, d.z + up}, luck}, reach_, dt);
  return other.material != Material::Nothing;
}

void SpinningSimulator::fire(const Firings& f, Planes& out) {
  const std::lock_guard lock(busy_);
  const std::size_t cells = f.rows * f.columns;
  for (auto* plane : {&out.range, &out.range2}) plane->assign(cells, 0);
  for (auto* plane : {&out.reflectivity, &out.reflectivity2, &out.signal, &out.signal2, &out.near_ir})
    plane->assign(cells, 0);
  out.distance_m.assign(cells, 0);
  out.label.assign(cells, 0);
  const bool two = detector_.traits().returns != Returns::Strongest;
  const bool lit = detector_.traits().sky > 0;
  std::vector<std::size_t> order(f.rows);
  for (std::size_t column = 0; column < f.columns; ++column, ++column_) {
    const auto time_of = [&](std::size_t row) { return f.t_ns[(f.shared ? 0 : row * f.columns) + column]; };
    std::iota(order.begin(), order.end(), std::size_t{0});
    if (!f.shared)
      std::stable_sort(order.begin(), order.end(),
                       [&](std::size_t a, std::size_t b) { return time_of(a) < time_of(b); });
    // A column takes 0.15 ms at most: the way of the car is straight, and its turning even, to a nanometre.
    const std::int64_t begin = std::max(time_of(order.front()), now_ns_), end = std::max(time_of(order.back()), begin);
    const Pose from = world_->pose(begin);
    if (!looked_ || begin - index_ns_ >= kIndexNs) look_around(begin, from.at);
    const Pose to = end > begin ? world_->pose(end) : from;
    now_ns_ = end;
    const auto steady = static_cast<std::int64_t>(column_ / kSteady);
    for (const std::size_t row : order) {
      const std::int64_t now = std::max(time_of(row), begin);
      const Pose pose =
          end > begin ? between(from, to, static_cast<double>(now - begin) / static_cast<double>(end - begin)) : from;
      const std::size_t cell = row * f.columns + column;
      Beam beam;
      beam.origin = {f.near[0][cell], f.near[1][cell], f.near[2][cell]};
      beam.direction = V3{f.far[0][cell], f.far[1][cell], f.far[2][cell]} - beam.origin;
      beam.direction = beam.direction * (1.0 / f.far_m);
      const Ray ray{pose.at + pose.turn(beam.origin), pose.turn(beam.direction),
                    hash_of(luck_, static_cast<std::int64_t>(column_), static_cast<std::int64_t>(row))};
      const double dt = static_cast<double>(now - index_ns_) * 1e-9;
      Hit hit, behind;
      const double roof = world_->on_a_car() ? own_car_at(beam, ray.luck) : 0.0;
      bool through = false;
      if (roof > 0) {
        hit.t = roof;
        hit.cosine = -beam.direction.z;
        hit.material = Material::CarPaint;
        hit.label = Label::Vehicle;
        hit.local = beam.origin + beam.direction * roof;
      } else {
        hit = trace(ray, reach_, dt);
        if (two)
          through = meet_another(ray, hit, hash_of(luck_ ^ 9, steady, static_cast<std::int64_t>(row)), dt, behind);
      }
      Measured first, second;
      detector_.receive(row, ray.luck, hit, through ? &behind : nullptr, first, second);
      out.range[cell] = first.range, out.range2[cell] = second.range;
      out.reflectivity[cell] = first.reflectivity, out.reflectivity2[cell] = second.reflectivity;
      out.signal[cell] = first.signal, out.signal2[cell] = second.signal;
      if (lit) out.near_ir[cell] = detector_.light(hit, ray.direction.z, ray.luck);
      out.distance_m[cell] = hit.material == Material::Nothing ? 0.0F : static_cast<float>(hit.t);
      out.label[cell] = static_cast<std::uint8_t>(hit.label);
    }
  }
}

}  // namespace lidarcodec::sim
