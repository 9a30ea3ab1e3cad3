#include "simulator/town/traffic.hpp"

namespace lidarcodec::sim {
namespace {

constexpr double kAccelerate = 1.5, kBrake = 2.2, kHeadway = 1.3, kStandstill = 2.2;
constexpr double kFarAway = 185.0;  // beyond the reach of all lasers: cars appear and disappear here

// The intelligent driver model (Treiber, Hennecke and Helbing 2000): acceleration for a gap to an object with the speed
// `ahead`.
double follow(double v, double wanted, double gap, double ahead) {
  const double r = v / wanted;
  const double free = 1.0 - r * r * r * r;
  const double need = kStandstill + max_of(0.0, v * kHeadway + v * (v - ahead) / (2.0 * 1.8166));
  const double q = need / max_of(gap, 0.3);
  return clamp_to(kAccelerate * (free - q * q), -7.0, kAccelerate);
}

// Distance of a point from the middle line of a vehicle.
double off_body(V2 p, const Driver& d) {
  const V2 to = p - d.now.at;
  const double half = 0.5 * d.model->length - 0.5 * d.model->width;
  const double along = clamp_to(dot(to, d.now.heading), -half, half);
  return length(to - d.now.heading * along);
}

}  // namespace

Traffic::Traffic(const Town& town, const Models& models, std::uint64_t seed, double top_speed, double density)
    : town_(town),
      models_(models),
      rng_(hash_of(seed, 61)),
      top_speed_(top_speed),
      wanted_(static_cast<int>(22 * density + 0.5)) {
  const double t = town.crossing(0, 0).y + 35.0;
  const Model& car = models.vehicle(Vehicle::Estate, 0);
  drivers_.push_back({Route(town, hash_of(seed, 62), true, 0, t, true, 0.4), &car, 0, 0.3F});
  Driver& ego = drivers_.front();
  ego.v = ego.v_old = 4.0;
  ego.s = ego.s_old = 0.1;
  ego.route.extend(120.0);
  ego.now = ego.route.at(ego.s);
  for (int k = 0; k < 6 * wanted_; ++k) spawn(true);
  advance(0);
}

bool Traffic::free_at(V2 p, double radius) const {
  for (const Driver& d : drivers_)
    if (length(d.now.at - p) < radius) return false;
  return true;
}

void Traffic::spawn(bool at_start) {
  // Some towns and quarters are busier than others.
  const V2 here = drivers_.front().now.at;
  const double busy = 0.95 + 0.35 * unit_of(mix(town_.seed())) + 0.45 * noise_at(77, here.x / 350.0, here.y / 350.0);
  if (static_cast<double>(drivers_.size()) > wanted_ * busy) return;
  const double turn = rng_.unit(), far = at_start ? rng_.between(18.0, 170.0) : rng_.between(138.0, 175.0);
  const V2 p{here.x + far * cos_turns(turn), here.y + far * sin_turns(turn)};
  const bool along_y = rng_.chance(0.5), forward = rng_.chance(0.5);
  const std::uint64_t id = rng_.next();
  const double eager = rng_.between(0.85, 1.1);
  std::int64_t i = 0, j = 0;
  town_.block_of(p, i, j);
  const std::int64_t index = along_y ? i : j, segment = along_y ? j : i;
  if (!town_.open(along_y, index, segment)) return;
  const Street street = town_.street(along_y, index);
  if (street.kind == StreetClass::Lane && (id & 7) > 2) return;
  const V2 a = town_.crossing(i, j), b = along_y ? town_.crossing(i, j + 1) : town_.crossing(i + 1, j);
  const double lo = (along_y ? a.y : a.x) + 26.0, hi = (along_y ? b.y : b.x) - 26.0;
  const double t = along_y ? p.y : p.x;
  if (t < lo || t > hi) return;
  const V2 at = street.point(t);
  if (!free_at(at, 14.0) || (!at_start && length(at - here) < 135.0)) return;
  const Vehicle kind = usual_vehicle(mix(id ^ 1), false);
  const Model& model = models_.vehicle(kind, mix(id ^ 2));
  drivers_.push_back({Route(town_, id, along_y, index, t, forward, 0.6), &model, id, usual_paint(id ^ 9)});
  Driver& d = drivers_.back();
  d.eager = eager;
  d.s = d.s_old = 0.1;
  d.v = d.v_old = 5.0 * d.eager;
  d.route.extend(120.0);
  d.now = d.route.at(d.s);
}

bool Traffic::red(const Leg& leg) const {
  // Where two busy streets cross there are lights: 20 s for one, 20 s for the other, and 3 s of red for both in
  // between.
  const auto busy = [&](bool along_y, std::int64_t index) {
    const StreetClass kind = town_.street(along_y, index).kind;
    return kind == StreetClass::Main || kind == StreetClass::Avenue;
  };
  if (!busy(true, leg.ci) || !busy(false, leg.cj)) return false;
  const std::int64_t cycle = 46 * 20;
  const auto shift =
      static_cast<std::int64_t>(hash_of(town_.seed(), 71, leg.ci, leg.cj) % static_cast<std::uint64_t>(cycle));
  const std::int64_t phase = (ticks_ + shift) % cycle;
  return leg.street.along_y ? phase >= 20 * 20 : (phase < 23 * 20 || phase >= 43 * 20);
}

double Traffic::behind(const Driver& d, const Leg& leg) const {
  const double half = 0.5 * d.model->length;
  if (leg.turn == Turn::Straight)
    return leg.s0 + leg.length + town_.street(!leg.street.along_y, leg.street.along_y ? leg.cj : leg.ci).half_width +
           2.0 + half;
  const Leg& curve = d.route.leg(leg.s0 + leg.length + 0.1);
  return curve.s0 + curve.length + 1.5 + half;
}

bool Traffic::may_cross(const Driver& d, std::size_t self, const Leg& leg) const {
  if (red(leg)) return false;
  // One driver holds the crossing. Only followers from the same side and straight oncoming traffic may cross with it.
  for (std::size_t k = 0; k < drivers_.size(); ++k) {
    const Driver& other = drivers_[k];
    if (k == self || !other.granted || other.ci != leg.ci || other.cj != leg.cj) continue;
    const Leg& theirs = other.route.leg(other.s);
    if (theirs.curve) return false;
    if (theirs.street.along_y != leg.street.along_y) return false;
    const bool oncoming = theirs.forward != leg.forward;
    if (oncoming && (leg.turn == Turn::Left || theirs.turn == Turn::Left)) return false;
  }
  // There must be room behind the crossing.
  const double out = behind(d, leg);
  for (std::size_t k = 0; k < drivers_.size(); ++k) {
    const Driver& other = drivers_[k];
    if (k == self || other.v > 2.0) continue;
    const double touch = 0.5 * (d.model->width + other.model->width) + 0.3;
    for (double ahead = -2.0; ahead < 0.5 * d.model->length + 3.0; ahead += 1.5)
      if (off_body(d.route.at(out + ahead).at, other) < touch) return false;
  }
  return true;
}

void Traffic::hold(Driver& d, const Leg& leg) const {
  d.granted = true;
  d.ci = leg.ci, d.cj = leg.cj;
  d.cleared = behind(d, leg);
}

double Traffic::accelerate(Driver& d, std::size_t self) {
  const Leg& leg = d.route.leg(d.s);
  double wanted = min_of(leg.limit * d.eager, top_speed_);
  const double half = 0.5 * d.model->length;
  // Slows down for the next curve.
  for (const Leg& next : d.route.legs()) {
    if (next.s0 <= d.s) continue;
    const double room = next.s0 - d.s;
    if (room > 60.0) break;
    const double limit = min_of(next.limit * d.eager, top_speed_);
    wanted = min_of(wanted, std::sqrt(limit * limit + 2.0 * 1.6 * room));
  }
  double a = follow(d.v, wanted, 1e6, 0);

  if (!leg.curve) {
    const double room = leg.stop - half - d.s;
    if (!d.granted && room <= -2.0 && leg.turn != Turn::Straight) hold(d, leg);  // it passed the line, so others wait
    if (!d.granted && room < 4.0 + d.v * d.v / (2.0 * kBrake) + d.v * 1.0 && room > -2.0) {
      if (may_cross(d, self, leg)) {
        hold(d, leg);
      } else {
        a = min_of(a, follow(d.v, wanted, room + kStandstill - 0.5, 0));
      }
    }
  }

  // Obstacles on the route, up to the braking distance.
  const double look = half + 8.0 + d.v * 2.6;
  for (std::size_t k = 0; k < drivers_.size(); ++k) {
    const Driver& other = drivers_[k];
    if (k == self) continue;
    const V2 to = other.now.at - d.now.at;
    const double far = dot(to, to), reach = look + other.model->length;
    if (far > reach * reach) continue;
    const double touch = 0.5 * (d.model->width + other.model->width) + 0.2;
    for (double ahead = half; ahead < look; ahead += 1.5) {
      const Waypoint w = d.route.at(d.s + ahead);
      if (off_body(w.at, other) > touch) continue;
      const double gap = max_of(ahead - half - 0.5, 0.0);
      a = min_of(a, follow(d.v, wanted, gap, max_of(other.v * dot(other.now.heading, w.heading), 0.0)));
      break;
    }
  }
  return a;
}

void Traffic::tick() {
  ++ticks_;
  for (Driver& d : drivers_) d.route.extend(d.s + 90.0);
  for (std::size_t k = 0; k < drivers_.size(); ++k) drivers_[k].a = accelerate(drivers_[k], k);
  for (Driver& d : drivers_) {
    d.s_old = d.s, d.v_old = d.v, d.tilt_old = d.tilt;
    d.v = max_of(0.0, d.v + d.a * kTick);
    d.s += 0.5 * (d.v + d.v_old) * kTick;
    d.tilt += (d.a - d.tilt) * 0.12;
    d.stuck = d.v < 0.1 ? d.stuck + kTick : 0.0;
    d.now = d.route.at(d.s);
    d.route.forget(d.s_old - 1.0);
    if (d.granted && d.s > d.cleared) d.granted = false;
  }
  const V2 here = drivers_.front().now.at;
  for (std::size_t k = 1; k < drivers_.size();) {
    const double far = length(drivers_[k].now.at - here);
    if (far > kFarAway || drivers_[k].stuck > (far > 40.0 ? 30.0 : 45.0))
      drivers_.erase(drivers_.begin() + static_cast<std::ptrdiff_t>(k));
    else
      ++k;
  }
  for (int k = 0; k < 2; ++k) spawn(false);
}

void Traffic::advance(std::int64_t t_ns) {
  while (ticks_ * kTickNs <= t_ns) tick();
}

double Traffic::way(const Driver& d, std::int64_t t_ns, double& speed) const {
  // Acceleration is constant over a tick.
  const double x = static_cast<double>(t_ns - (ticks_ - 1) * kTickNs) * 1e-9;
  const double a = (d.v - d.v_old) * (1.0 / kTick);
  speed = d.v_old + a * x;
  return d.s_old + (d.v_old + 0.5 * a * x) * x;
}

double Traffic::tilt(const Driver& d, std::int64_t t_ns) const {
  const double x = static_cast<double>(t_ns - (ticks_ - 1) * kTickNs) * (1.0 / static_cast<double>(kTickNs));
  return d.tilt_old + (d.tilt - d.tilt_old) * x;
}

}  // namespace lidarcodec::sim
