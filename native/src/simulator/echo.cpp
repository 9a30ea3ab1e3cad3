#include "simulator/echo.hpp"

namespace lidarcodec::sim {
namespace {

// By the manual, pavement (10 %) is seen at 50 m and cars (80 %) at 120 m.
constexpr double kThreshold = 1.0e-5;
constexpr double kFootprint = 0.0012;  // half the width of the beam, radians

// Albedo at the hit: the material's, with variations of a metre and of a decimetre.
double albedo_of(const Hit& hit, const Surface& surface) {
  const double base = hit.albedo >= 0 ? hit.albedo : surface.albedo;
  const double u = hit.label == Label::Ground ? hit.local.x : hit.local.x + 0.7 * hit.local.y;
  const double v = hit.label == Label::Ground ? hit.local.y : hit.local.z;
  const double patches = noise_at(hit.id ^ 0xA11u, u * 0.9, v * 0.9);
  const double grain = noise_at(hit.id ^ 0xA12u, u * 7.0, v * 7.0);
  return max_of(base * (1.0 + surface.variation * (1.1 * patches + 0.8 * grain)), 0.004);
}

}  // namespace

Echo Receiver::receive(int laser, std::uint64_t firing, const Hit& hit) {
  const auto k = static_cast<std::size_t>(laser);
  const double last = before_[k];
  before_[k] = 0;
  if (hit.material == Material::Nothing || hit.t > kReach || hit.t < kNearest) return {};
  const std::uint64_t h0 = hash_of(seed_, static_cast<std::int64_t>(firing), laser);
  const std::uint64_t h1 = mix(h0), h2 = mix(h1);
  const double u = unit_of(h2);

  const Surface& surface = surface_of(hit.material);
  const double albedo = albedo_of(hit, surface);
  const double cosine = clamp_to(hit.cosine, 0.01, 1.0);
  const double mirrored = surface.gloss * (1.0 - cosine) * (1.0 - cosine);
  const double shine = albedo * (0.12 + 0.88 * cosine) * (1.0 - mirrored);
  const double power = shine / (hit.t * hit.t);
  const double speckle = normal_of(h0, u);
  const double need = kThreshold / sensor_.reach(laser);
  before_[k] = hit.t;
  if (power * (1.0 + 0.06 * speckle) < need || u < 0.001) return {};

  // An inclined surface lengthens the pulse over the footprint of the beam.
  const double slant = min_of(hit.t * kFootprint * std::sqrt(1.0 - cosine * cosine) / cosine, 1.5);
  const double sigma = sensor_.sigma_m(laser) * (1.0 + 0.35 * need / power);
  const double spread = std::sqrt(sigma * sigma + surface.rough_m * surface.rough_m + 0.0049 * slant * slant);
  double distance = hit.t + spread * normal_of(h1, unit_of(h0)) + sensor_.ripple_m(laser, firing);
  // At an edge a beam hits two surfaces. If they are close to each other, their echoes merge.
  const double step = last - hit.t;
  if (last > 0 && abs_of(step) > 0.15 && abs_of(step) < 1.6 && (h2 & 0xFF) < 60)
    distance += step * static_cast<double>((h2 >> 8) & 0xFF) * (1.0 / 256.0) * 0.8;

  const double steps = (distance - sensor_.dist_m(laser)) * 500.0 + 0.5;
  if (steps < 1.0 || steps >= 65536.0) return {};
  Echo echo;
  echo.range = static_cast<std::uint16_t>(steps);
  const double lit = albedo * (0.30 + 0.70 * cosine) * (1.0 - mirrored);
  const double near = 0.45 + 0.55 * smooth_step(1.0, 9.0, hit.t), far = 1.0 / (1.0 + hit.t * hit.t * (1.0 / 8100.0));
  const double level = sensor_.offset(laser) + sensor_.gain(laser) * 225.0 * std::sqrt(lit * near * far);
  const double wobble = (firing & 1) ? 1.2 : -1.2;
  echo.intensity = static_cast<std::uint8_t>(
      clamp_to(level * (1.0 + 0.025 * speckle) + 1.6 * normal_of(mix(h2), u) + wobble, 0.0, 255.0));
  return echo;
}

}  // namespace lidarcodec::sim
