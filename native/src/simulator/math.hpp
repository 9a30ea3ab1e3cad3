// Arithmetic of the simulator, with the same bits on every machine. Doubles use only + - * / and square roots, which
// IEEE 754 rounds exactly; sine and logarithm are polynomials; random numbers are hashes of place, time and purpose.
//
// A rule for all of simulator/: an expression draws at most once from a generator, because C++ does not define the
// order of evaluation. Draw into named values, or inside braces, which are evaluated from left to right.
#pragma once
#include <bit>
#include <cmath>
#include <cstdint>

namespace lidarcodec::sim {

struct V2 {
  double x = 0, y = 0;
};
struct V3 {
  double x = 0, y = 0, z = 0;
};
inline V2 operator+(V2 a, V2 b) { return {a.x + b.x, a.y + b.y}; }
inline V2 operator-(V2 a, V2 b) { return {a.x - b.x, a.y - b.y}; }
inline V2 operator*(V2 a, double k) { return {a.x * k, a.y * k}; }
inline double dot(V2 a, V2 b) { return a.x * b.x + a.y * b.y; }
inline double length(V2 a) { return std::sqrt(dot(a, a)); }
inline V3 operator+(V3 a, V3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline V3 operator-(V3 a, V3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline V3 operator*(V3 a, double k) { return {a.x * k, a.y * k, a.z * k}; }
inline double dot(V3 a, V3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

inline double min_of(double a, double b) { return b < a ? b : a; }
inline double max_of(double a, double b) { return a < b ? b : a; }
inline double clamp_to(double x, double lo, double hi) { return x < lo ? lo : (hi < x ? hi : x); }
inline double abs_of(double x) { return x < 0 ? -x : x; }

// Largest integer not above x; |x| < 2^62.
inline std::int64_t floor_of(double x) {
  const auto i = static_cast<std::int64_t>(x);
  return x < static_cast<double>(i) ? i - 1 : i;
}
// x - floor(x).
inline double fraction_of(double x) { return x - static_cast<double>(floor_of(x)); }

// sin(2 pi x), error below 1e-11: reduced to a quarter turn, then the Taylor series up to the power 17.
constexpr double kRadiansPerTurn = 6.283185307179586477;  // 2 pi
inline double sin_turns(double x) {
  double r = x - static_cast<double>(floor_of(x + 0.5));
  if (r > 0.25) r = 0.5 - r;
  if (r < -0.25) r = -0.5 - r;
  const double y = r * kRadiansPerTurn;
  const double q = y * y;
  double p = 1.0 / 355687428096000.0;
  p = p * q - 1.0 / 1307674368000.0;
  p = p * q + 1.0 / 6227020800.0;
  p = p * q - 1.0 / 39916800.0;
  p = p * q + 1.0 / 362880.0;
  p = p * q - 1.0 / 5040.0;
  p = p * q + 1.0 / 120.0;
  p = p * q - 1.0 / 6.0;
  return y + y * q * p;
}
inline double cos_turns(double x) { return sin_turns(x + 0.25); }

constexpr double kTurnsPerRadian = 0.15915494309189533577;  // 1 / (2 pi)
inline double sin_of(double radians) { return sin_turns(radians * kTurnsPerRadian); }
inline double cos_of(double radians) { return cos_turns(radians * kTurnsPerRadian); }

// Natural logarithm of a positive normal number, error below 1e-12: of the mantissa m by the series of 2 artanh((m - 1)
// / (m + 1)).
constexpr double kRootOfTwo = 1.4142135623730951, kLogOfTwo = 0.69314718055994530942;
inline double log_of(double x) {
  const auto bits = std::bit_cast<std::uint64_t>(x);
  auto exponent = static_cast<int>((bits >> 52) & 0x7FF) - 1023;
  double m = std::bit_cast<double>((bits & 0xFFFFFFFFFFFFFull) | 0x3FF0000000000000ull);
  if (m > kRootOfTwo) {
    m *= 0.5;
    exponent += 1;
  }
  const double s = (m - 1.0) / (m + 1.0);
  const double q = s * s;
  double p = 1.0 / 15.0;
  p = p * q + 1.0 / 13.0;
  p = p * q + 1.0 / 11.0;
  p = p * q + 1.0 / 9.0;
  p = p * q + 1.0 / 7.0;
  p = p * q + 1.0 / 5.0;
  p = p * q + 1.0 / 3.0;
  return exponent * kLogOfTwo + 2.0 * (s + s * q * p);
}

// The diamond angle of (x, y): it rises with the angle, from 0 at +x and 1 at +y to 4, and sorts directions without an
// arc tangent. Its derivative by the angle in radians is between 0.5 and 1.
inline double diamond_angle(double x, double y) {
  const double ax = abs_of(x);
  const double ay = abs_of(y);
  const double sum = ax + ay;
  if (sum == 0) return 0;
  const double p = ay / sum;
  if (x >= 0) return y >= 0 ? p : (p == 0 ? 0 : 4.0 - p);
  return y >= 0 ? 2.0 - p : 2.0 + p;
}

// Smoothstep: 0 at a, 1 at b, cubic between them, with the derivative 0 at both.
inline double smooth_step(double a, double b, double x) {
  const double t = clamp_to((x - a) / (b - a), 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

// ---- Random numbers: hashes of place, time and purpose -----------------------------------------------------------

// SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
inline std::uint64_t mix(std::uint64_t z) {
  z += 0x9E3779B97F4A7C15ull;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}
inline std::uint64_t hash_of(std::uint64_t a, std::int64_t b) {
  return mix(a ^ (static_cast<std::uint64_t>(b) * 0xD1342543DE82EF95ull));
}
inline std::uint64_t hash_of(std::uint64_t a, std::int64_t b, std::int64_t c) { return hash_of(hash_of(a, b), c); }
inline std::uint64_t hash_of(std::uint64_t a, std::int64_t b, std::int64_t c, std::int64_t d) {
  return hash_of(hash_of(hash_of(a, b), c), d);
}
// 0 <= result < 1.
inline double unit_of(std::uint64_t h) { return static_cast<double>(h >> 11) * 0x1p-53; }

// A faster hash of a cell of space, for leaves and textures. The three factors are from Ericson, "Real-time collision
// detection" (2005), section 7.1.3.
inline std::uint32_t cell_hash(std::uint32_t seed, std::int64_t x, std::int64_t y, std::int64_t z) {
  std::uint32_t h = seed ^ (static_cast<std::uint32_t>(x) * 0x8DA6B343u) ^
                    (static_cast<std::uint32_t>(y) * 0xD8163841u) ^ (static_cast<std::uint32_t>(z) * 0xCB1AB31Fu);
  h ^= h >> 15;
  h *= 0x2C1B3C6Du;
  h ^= h >> 12;
  h *= 0x297A2D39u;
  h ^= h >> 15;
  return h;
}
inline double unit32(std::uint32_t h) { return h * 0x1p-32; }

// About standard normal: the sum of four uniform numbers, with one of two widths. Kurtosis 3.4, as measured on real
// returns.
inline double normal_of(std::uint64_t h, double pick) {
  const auto sum = static_cast<std::int64_t>((h & 0xFFFF) + ((h >> 16) & 0xFFFF) + ((h >> 32) & 0xFFFF) + (h >> 48));
  // Four uniform numbers of 0 to 65535: mean 2 * 65535, standard deviation 65536 / sqrt(3).
  const double g = static_cast<double>(sum - 131070) * (1.0 / 37837.2);
  return g * (pick < 0.71 ? 0.82 : 1.355);
}

// A generator that begins with a hash.
class Rng {
 public:
  explicit Rng(std::uint64_t h) : state_(h) {}
  std::uint64_t next() { return mix(state_++ * 0x9E3779B97F4A7C15ull); }
  double unit() { return unit_of(next()); }
  double between(double lo, double hi) { return lo + (hi - lo) * unit(); }
  bool chance(double p) { return unit() < p; }
  int below(int n) { return static_cast<int>(unit() * n); }
  double normal() {
    const std::uint64_t h = next();
    return normal_of(h, unit());
  }

 private:
  std::uint64_t state_;
};

// Value noise in a plane, -1 to 1: hashes at whole points, interpolated by smoothstep.
inline double noise_at(std::uint32_t seed, double x, double y) {
  const std::int64_t ix = floor_of(x);
  const std::int64_t iy = floor_of(y);
  double fx = x - static_cast<double>(ix);
  double fy = y - static_cast<double>(iy);
  fx = fx * fx * (3.0 - 2.0 * fx);
  fy = fy * fy * (3.0 - 2.0 * fy);
  const double a = unit32(cell_hash(seed, ix, iy, 0));
  const double b = unit32(cell_hash(seed, ix + 1, iy, 0));
  const double c = unit32(cell_hash(seed, ix, iy + 1, 0));
  const double d = unit32(cell_hash(seed, ix + 1, iy + 1, 0));
  const double top = a + (b - a) * fx;
  const double low = c + (d - c) * fx;
  return 2.0 * (top + (low - top) * fy) - 1.0;
}

}  // namespace lidarcodec::sim
