#include "simulator/detector.hpp"

#include <utility>

namespace lidarcodec::sim {
namespace {

constexpr double kFootprint = 0.0012;  // half the width of the beam, radians
constexpr double kReflector = 1.5;     // reflectivity of what throws the light back, and does not scatter it
constexpr double kEdge = 0.15;         // surfaces of a row nearer to each other than this, in metres, are one
constexpr double kEdgeShare = 0.24;    // firings next to an edge whose beams meet both surfaces

std::uint16_t whole(double value, double most) { return static_cast<std::uint16_t>(clamp_to(value + 0.5, 0.0, most)); }

// Where a hit is on its surface, in metres.
void place_on(const Hit& hit, double& u, double& v) {
  u = hit.label == Label::Ground ? hit.local.x : hit.local.x + 0.7 * hit.local.y;
  v = hit.label == Label::Ground ? hit.local.y : hit.local.z;
}

// Albedo at the hit: the material's, with variations of a metre and of a decimetre.
double albedo_of(const Hit& hit, const Surface& surface) {
  const double base = hit.albedo >= 0 ? hit.albedo : surface.albedo;
  double u = 0, v = 0;
  place_on(hit, u, v);
  const double patches = noise_at(hit.id ^ 0xA11u, u * 0.9, v * 0.9);
  const double grain = noise_at(hit.id ^ 0xA12u, u * 7.0, v * 7.0);
  return max_of(base * (1.0 + surface.variation * (1.1 * patches + 0.8 * grain)), 0.004);
}

}  // namespace

Detector::Detector(const DetectorTraits& traits, std::size_t rows, std::uint64_t seed)
    : traits_(traits), need_(0.1 / (traits.sees_10_m * traits.sees_10_m)), before_(rows) {
  for (std::size_t row = 0; row < rows; ++row) {
    Rng rng(hash_of(seed, static_cast<std::int64_t>(row)));
    gain_.push_back(rng.between(0.96, 1.04));
    wide_.push_back(rng.between(0.85, 1.15));
  }
}

Detector::Echo Detector::echo_of(const Hit& hit) const {
  Echo echo;
  if (hit.material == Material::Nothing) return echo;
  const Surface& surface = surface_of(hit.material);
  const double albedo = albedo_of(hit, surface);
  const double cosine = clamp_to(hit.cosine, 0.01, 1.0);
  const double mirrored = surface.gloss * (1.0 - cosine) * (1.0 - cosine);
  echo.t = hit.t;
  echo.lit = albedo * (traits_.grazing + (1.0 - traits_.grazing) * cosine) * (1.0 - mirrored);
  echo.power = albedo * (0.12 + 0.88 * cosine) * (1.0 - mirrored) / (hit.t * hit.t);
  echo.slant = min_of(hit.t * kFootprint * std::sqrt(1.0 - cosine * cosine) / cosine, 1.5);
  echo.rough = surface.rough_m + hit.rough_m;
  return echo;
}

bool Detector::seen(const Echo& echo, std::uint64_t luck) const {
  if (echo.t < traits_.nearest_m || echo.t > traits_.farthest_m) return false;
  return echo.power * (1.0 + 0.06 * normal_of(luck, unit_of(mix(luck)))) > need_;
}

Measured Detector::measure(const Echo& echo, std::size_t row, std::uint64_t luck) const {
  const std::uint64_t h1 = mix(luck), h2 = mix(h1), h3 = mix(h2);
  const double sigma = traits_.sigma_m * wide_[row] * (1.0 + traits_.weak * min_of(need_ / echo.power, 1.0));
  const double spread = std::sqrt(sigma * sigma + echo.rough * echo.rough + 0.0049 * echo.slant * echo.slant);
  Measured out;
  const double steps = (echo.t + spread * normal_of(h1, unit_of(h2))) / traits_.step_m + 0.5;
  if (steps < 1.0) return out;
  out.range = static_cast<std::uint32_t>(steps);
  double shot = 0;  // noise of the count of photons, as a share
  if (traits_.photons > 0) {
    const double near = smooth_step(0.0, 4.0, echo.t);  // the receiver sees only a part of a near spot
    const double count = traits_.photons * echo.lit * (0.25 + 0.75 * near) / (echo.t * echo.t) + traits_.dark;
    shot = normal_of(h3, unit_of(h1)) / std::sqrt(count);
    out.signal = whole(count * (1.0 + shot), 65535.0);
  }
  const double share = shot + traits_.reflectivity_noise * normal_of(h2, unit_of(h3));
  const double told = echo.lit * (1.0 - traits_.contrast * (1.0 - min_of(echo.lit, 1.0)));
  double level = traits_.reflectivity * told * gain_[row] * (1.0 + share);
  level += traits_.reflectivity_floor * normal_of(mix(h3), unit_of(h2));
  if (echo.lit < kReflector) level = min_of(level, traits_.diffuse_most);
  // Reflectors: the upper part of the scale, which ends with the best of them.
  if (traits_.reflectivity_most == 255 && level > 100.0) level = 100.0 + 155.0 * (1.0 - 100.0 / level);
  if (echo.t >= traits_.reflectivity_from_m) out.reflectivity = whole(level, traits_.reflectivity_most);
  return out;
}

void Detector::receive(std::size_t row, std::uint64_t luck, const Hit& hit, const Hit* behind, Measured& first,
                       Measured& second) {
  const std::uint64_t h0 = mix(luck), h1 = mix(h0);
  Echo one = echo_of(hit), other = behind ? echo_of(*behind) : Echo{};
  const Echo before = before_[row];
  before_[row] = one;
  if (abs_of(other.t - one.t) < traits_.pulse_m) other = Echo{};
  if (other.t > 0) {  // each gets a part of the beam
    const double share = 0.2 + 0.6 * unit_of(mix(h1));
    one.power *= share;
    other.power *= 1.0 - share;
  }
  const double step = before.t - one.t;
  if (one.t > 0 && before.t > 0 && abs_of(step) > kEdge && unit_of(h0) < kEdgeShare) {
    const double share = 0.8 * unit_of(h1);
    if (abs_of(step) < traits_.pulse_m) {
      one.t += step * share;
    } else if (other.t == 0) {
      other = before;
      other.power *= share;
      one.power *= 1.0 - share;
    }
  }
  if (!seen(other, mix(h0 ^ 5))) other = Echo{};
  if (!seen(one, mix(h0 ^ 7))) {
    one = other;
    other = Echo{};
  }
  if (one.t == 0) {
    if (traits_.quiet > 0) {
      const double level = 1.0 - (traits_.quiet - 1.0) * log_of(max_of(unit_of(h1), 1e-9));
      first.reflectivity = second.reflectivity = whole(level - 0.5, traits_.reflectivity_most);
    }
    if (traits_.photons > 0) {
      const double root = traits_.dark_noise * std::sqrt(traits_.dark);
      first.signal = whole(traits_.dark + root * normal_of(h0, unit_of(h1)), 65535.0);
      second.signal = whole(traits_.dark + root * normal_of(h1, unit_of(h0)), 65535.0);
    }
    return;
  }
  if (other.power > one.power) std::swap(one, other);
  const Measured strongest = measure(one, row, h0);
  first = second = strongest;
  if (other.t == 0) {
    if (traits_.returns != Returns::StrongestAndSecond) return;
    second = Measured{};
    if (traits_.photons > 0)
      second.signal =
          whole(traits_.dark + traits_.dark_noise * std::sqrt(traits_.dark) * normal_of(h1, unit_of(h0)), 65535.0);
    return;
  }
  const Measured weaker = measure(other, row, mix(h1));
  if (traits_.returns == Returns::StrongestAndSecond) second = weaker;
  if (traits_.returns == Returns::LastAndStrongest && other.t > one.t) first = weaker;
}

std::uint16_t Detector::light(const Hit& hit, double rise, std::uint64_t luck) const {
  const std::uint64_t h = mix(luck ^ 0x5157);
  double counts = traits_.sky / (1.0 + 3.0 * max_of(rise, 0.0));
  if (hit.material != Material::Nothing) {
    double u = 0, v = 0;
    place_on(hit, u, v);
    const double shade = 0.6 + 0.4 * noise_at(hit.id ^ 0xA13u, u * 0.25, v * 0.25);
    counts = traits_.daylight * albedo_of(hit, surface_of(hit.material)) * shade;
  }
  counts += traits_.light_noise * std::sqrt(max_of(counts, 1.0)) * normal_of(h, unit_of(mix(h)));
  return whole(counts / traits_.light_step, traits_.light_most);
}

}  // namespace lidarcodec::sim
