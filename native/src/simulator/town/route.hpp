// The route of a vehicle through the town: legs along streets and turns at crossings, by distance driven.
#pragma once
#include <array>
#include <deque>

#include "simulator/town/town.hpp"

namespace lidarcodec::sim {

enum class Turn : std::uint8_t { Straight, Left, Right };

// A leg of the route: along a street from `t_begin` to `t_end`, or a curve from one street into another.
struct Leg {
  bool curve = false;
  double s0 = 0, length = 0;  // distance driven at its start, and its length
  // Along a street.
  Street street;
  bool forward = true;
  double t_begin = 0, lane = 0;  // `lane`: how far right of the middle of the street
  bool outer = false;            // on the outer of two lanes
  std::int64_t segment = 0;      // between crossings `segment` and `segment + 1`
  Turn turn = Turn::Straight;    // at its end
  double stop = 0;               // distance driven at the stop line at its end
  std::int64_t ci = 0, cj = 0;   // the crossing at its end
  // A curve: a polynomial of degree five, and the share of its length at each 32nd of its parameter.
  std::array<V2, 6> poly{};
  std::array<double, 33> share{};
  double limit = 100;  // speed to take it at
};

struct Waypoint {
  V2 at, heading;
};

class Route {
 public:
  // Starts at `t` on a street.
  Route(const Town& town, std::uint64_t seed, bool along_y, std::int64_t index, double t, bool forward,
        double straight);

  Waypoint at(double s) const;
  // The leg at a distance driven; `s` must not lie before what `forget` dropped.
  const Leg& leg(double s) const;
  // Extends the route to `s`, and drops legs that end before `from`.
  void extend(double s);
  void forget(double from);
  const std::deque<Leg>& legs() const { return legs_; }

 private:
  Leg street_leg(const Street& street, bool forward, std::int64_t segment, double t, double s0, bool outer);
  void append();
  Turn choose(const Street& street, bool forward, std::int64_t segment, bool outer, std::uint64_t h) const;
  static V2 lane_point(const Leg& leg, double ahead, V2& heading);

  const Town* town_;
  std::uint64_t seed_;
  double straight_;  // preference for going straight on
  std::uint64_t count_ = 0;
  std::deque<Leg> legs_;
};

}  // namespace lidarcodec::sim
