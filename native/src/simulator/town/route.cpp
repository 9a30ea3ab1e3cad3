#include "simulator/town/route.hpp"

namespace lidarcodec::sim {
namespace {

constexpr double kLaneWidth = 3.35;

// Distance from the middle of a crossing at which a turn begins, on a street that meets `other`.
double reach_of(const Street& other, Turn turn) {
  return other.half_width + (turn == Turn::Right ? 4.5 : (turn == Turn::Left ? 1.5 : 0.0));
}

// The crossing at the far end of a segment.
std::int64_t end_of(bool forward, std::int64_t segment) { return forward ? segment + 1 : segment; }

}  // namespace

Route::Route(const Town& town, std::uint64_t seed, bool along_y, std::int64_t index, double t, bool forward,
             double straight)
    : town_(&town), seed_(seed), straight_(straight) {
  const Street street = town.street(along_y, index);
  std::int64_t segment = 0, other = 0;
  if (along_y)
    town.block_of(street.point(t) + V2{0.01, 0}, other, segment);
  else
    town.block_of(street.point(t) + V2{0, 0.01}, segment, other);
  legs_.push_back(street_leg(street, forward, segment, t, 0, (seed & 1) == 1));
}

Turn Route::choose(const Street& street, bool forward, std::int64_t segment, bool outer, std::uint64_t h) const {
  const std::int64_t cross = end_of(forward, segment);  // index of the crossing street
  const bool ahead = town_->open(street.along_y, street.index, forward ? segment + 1 : segment - 1);
  // Growing t is to the right of a street along x seen along y, and to the left the other way round.
  const bool up = town_->open(!street.along_y, cross, street.index),
             down = town_->open(!street.along_y, cross, street.index - 1);
  const bool right_is_up = street.along_y == forward;
  bool right = right_is_up ? up : down, left = right_is_up ? down : up;
  const double u = unit_of(h);
  if (ahead && u < straight_) return Turn::Straight;
  // Of two lanes the outer one turns right and the inner one left, if there is a choice.
  if (street.two_lanes && left && (ahead || right)) left = !outer;
  if (street.two_lanes && right && (ahead || left)) right = outer;
  if (ahead && !left && !right) return Turn::Straight;
  if (right && (u < 0.5 + 0.5 * straight_ || !left)) return Turn::Right;
  return left ? Turn::Left : Turn::Straight;
}

Leg Route::street_leg(const Street& street, bool forward, std::int64_t segment, double t, double s0, bool outer) {
  const std::uint64_t h = hash_of(seed_, static_cast<std::int64_t>(count_++));
  Leg leg;
  leg.street = street;
  leg.forward = forward;
  leg.segment = segment;
  leg.t_begin = t;
  leg.s0 = s0;
  leg.turn = choose(street, forward, segment, outer, h);
  leg.outer = outer;
  leg.lane = street.two_lanes && outer ? street.lane + kLaneWidth : street.lane;
  const std::int64_t cross = end_of(forward, segment);
  leg.ci = street.along_y ? street.index : cross;
  leg.cj = street.along_y ? cross : street.index;
  const V2 middle = town_->crossing(leg.ci, leg.cj);
  const Street other = town_->street(!street.along_y, cross);
  const double t_end = (street.along_y ? middle.y : middle.x) + (forward ? -1.0 : 1.0) * reach_of(other, leg.turn);
  leg.length = max_of(forward ? t_end - t : t - t_end, 0.5);
  const double to_middle = leg.length + reach_of(other, leg.turn);
  leg.stop = s0 + min_of(to_middle - other.half_width - 1.6, leg.length + 0.3);  // before the curve begins
  leg.limit = street.speed;
  return leg;
}

V2 Route::lane_point(const Leg& leg, double ahead, V2& heading) {
  const double t = leg.forward ? leg.t_begin + ahead : leg.t_begin - ahead;
  const V2 tangent = leg.street.tangent(t);
  const double sign = leg.forward ? 1.0 : -1.0;
  heading = {sign * tangent.x, sign * tangent.y};
  const V2 p = leg.street.point(t);
  return {p.x + leg.lane * heading.y, p.y - leg.lane * heading.x};
}

void Route::append() {
  const Leg last = legs_.back();
  const double s0 = last.s0 + last.length;
  const std::int64_t cross = end_of(last.forward, last.segment);
  if (last.turn == Turn::Straight) {
    const double t = last.forward ? last.t_begin + last.length : last.t_begin - last.length;
    const std::int64_t next = last.forward ? last.segment + 1 : last.segment - 1;
    legs_.push_back(street_leg(last.street, last.forward, next, t, s0, last.outer));
    return;
  }
  const Street other = town_->street(!last.street.along_y, cross);
  const bool right = last.turn == Turn::Right;
  const bool forward = (last.street.along_y == last.forward) == right;
  const std::int64_t segment = forward ? last.street.index : last.street.index - 1;
  const V2 middle = town_->crossing(last.ci, last.cj);
  const double t = (other.along_y ? middle.y : middle.x) + (forward ? 1.0 : -1.0) * reach_of(last.street, last.turn);

  Leg curve;
  curve.curve = true;
  curve.s0 = s0;
  curve.street = other;
  curve.limit = right ? 4.6 : 5.8;
  Leg next = street_leg(other, forward, segment, t, 0, right || (hash_of(seed_, -1, other.index) & 1) == 1);
  V2 h0, h1;
  const V2 p0 = lane_point(last, last.length, h0), p1 = lane_point(next, 0, h1);
  // Quintic with the headings of both lanes and no curvature at its ends.
  const double size = 1.12 * length(p1 - p0);
  const V2 v0 = h0 * size, v1 = h1 * size, gap = p1 - p0;
  curve.poly = {
      p0, v0, V2{}, gap * 10.0 - v0 * 6.0 - v1 * 4.0, gap * -15.0 + v0 * 8.0 + v1 * 7.0, gap * 6.0 - (v0 + v1) * 3.0};
  V2 before = p0;
  for (int k = 1; k <= 32; ++k) {
    const double u = k / 32.0;
    V2 p = curve.poly[5];
    for (int n = 4; n >= 0; --n) p = p * u + curve.poly[static_cast<std::size_t>(n)];
    curve.share[static_cast<std::size_t>(k)] = curve.share[static_cast<std::size_t>(k - 1)] + length(p - before);
    before = p;
  }
  curve.length = curve.share[32];
  for (double& share : curve.share) share /= curve.length;
  const double shift = s0 + curve.length - next.s0;
  next.s0 += shift;
  next.stop += shift;
  legs_.push_back(curve);
  legs_.push_back(next);
}

void Route::extend(double s) {
  while (legs_.back().s0 + legs_.back().length < s) append();
}

void Route::forget(double from) {
  while (legs_.size() > 1 && legs_.front().s0 + legs_.front().length < from) legs_.pop_front();
}

const Leg& Route::leg(double s) const {
  for (const Leg& leg : legs_)
    if (s < leg.s0 + leg.length) return leg;
  return legs_.back();
}

Waypoint Route::at(double s) const {
  const Leg& l = leg(s);
  Waypoint w;
  if (!l.curve) {
    w.at = lane_point(l, s - l.s0, w.heading);
    return w;
  }
  const double x = clamp_to((s - l.s0) / l.length, 0.0, 1.0);
  std::size_t k = 0;
  while (k < 31 && l.share[k + 1] < x) ++k;
  const double u = (static_cast<double>(k) + (x - l.share[k]) / (l.share[k + 1] - l.share[k])) / 32.0;
  w.at = l.poly[5];
  V2 tangent{};
  for (int n = 4; n >= 0; --n) {
    tangent = tangent * u + w.at;
    w.at = w.at * u + l.poly[static_cast<std::size_t>(n)];
  }
  w.heading = tangent * (1.0 / length(tangent));
  return w;
}

}  // namespace lidarcodec::sim
