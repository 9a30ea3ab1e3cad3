// Intersections of beams with the surface, four directions at a time, from the highest ring down. Compiled for each
// kind of processor (motion/warp.cpp).
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "motion/warp_surface.hpp"

namespace lidarcodec {

// The places of a ring in four directions.
struct Surface::Places {
  Fours away, height;
};

// Whether places lie above a beam.
[[gnu::always_inline]] inline FourMasks Surface::is_above(const CrossingBeam& beam, const Places& at) {
  return (at.away + beam.back) * beam.tan_elevation < at.height - beam.origin_z;
}

// By how much. Exact: a number below 2^53 in steps of 2^-24.
template <class Form>
[[gnu::always_inline]] inline Fours Surface::above(const CrossingBeam& beam, const Places& at) {
  return at.height - beam.origin_z - rounded_down<Form>((at.away + beam.back) * beam.tan_elevation);
}

// Whether nothing lies between two places: they are more than 0.35 of the nearer distance apart, or they are more than
// 0.3 m and a quarter of it apart at almost one height.
[[gnu::always_inline]] inline FourMasks Surface::jump(const Places& a, const Places& b) {
  const Fours apart = absolute(b.away - a.away), near = select(a.away < b.away, a.away, b.away);
  return (apart * 20.0 > near * 7.0) |
         ((apart > 150.0 * kLengthsPerStep) & (apart * 4.0 > near) & (absolute(b.height - a.height) * 50.0 < apart));
}

// The intersection of a beam with the line between two places, where `passes`; kept in `hit` if it is the nearest so
// far.
template <class Form>
[[gnu::always_inline]] inline void Surface::intersect(const CrossingBeam& beam, const Places& a, const Places& b,
                                                      FourMasks passes, Fours& hit) {
  const Fours from = above<Form>(beam, a), all = select(passes, from - above<Form>(beam, b), broadcast(1));
  // Exact: a double divides whole numbers below 2^50 and drops the fraction as an integer division does.
  const Fours part = fours_of<Form>(truncated(select(passes, (b.away - a.away) * from, Fours{}) / all));
  const Fours closer = select(2.0 * absolute(from) < absolute(all), a.away, b.away);
  const Fours away = select(jump(a, b), closer, a.away + part);
  hit = select(passes & (away + beam.back > 0.0) & (away < hit), away, hit);
}

template <class Form>
[[gnu::always_inline]] inline void Surface::cross(std::size_t direction) {
  constexpr std::size_t kNextLine =
      8;  // the ring's places in later directions, which the processor does not prefetch by itself
  const std::size_t beams = rows_.size();
  std::array<Fours, kRows> hit;  // of each beam, its distance from the axis
  for (std::size_t beam = 0; beam < beams; ++beam) hit[beam] = broadcast(kUnknown);
  std::array<std::array<std::uint64_t, 4>, kRows + 1> below{};  // bits of the rings that lie below so many beams

  const Place* at = points_ + direction;
  Places before{};
  Fours now{}, ring_before = broadcast(-double{kRows});  // number of beams that pass above the last place, and its ring
  std::size_t least = 0, most = 0;                       // of `now`
  for (std::size_t ring = 0; ring < kRows; ++ring, at += kStride) {
    __builtin_prefetch(at + kNextLine);
    const FourInts aways{at[0].away, at[1].away, at[2].away, at[3].away},
        heights{at[0].height, at[1].height, at[2].height, at[3].height};
    const FourMasks known = fours_of<Form>(aways) != double{kUnknown};
    const std::uint32_t known_ones = Form::bits_of(known);
    if (known_ones == 0) continue;
    const Places here = {select(known, fours_of<Form>(aways), before.away),
                         select(known, fours_of<Form>(heights), before.height)};
    const Fours number = broadcast(static_cast<double>(ring));
    const FourMasks joined = known & (number - ring_before <= double{kMostRingsApart});
    FourMasks rose{};
    for (std::size_t beam = least;; ++beam) {
      const CrossingBeam& crossing = crossing_[beam + 1];
      const FourMasks rises = known & (now == static_cast<double>(beam)) & ~is_above(crossing, here);
      if (Form::bits_of(rises) != 0) {
        rose |= rises;
        now += select(rises, broadcast(1), Fours{});
        most = std::max(most, beam + 1);
        const FourMasks passes = rises & joined & is_above(crossing, before);
        if (Form::bits_of(passes) != 0) intersect<Form>(crossing, before, here, passes, hit[beam]);
      } else if (beam >= most) {
        break;
      }
    }
    for (std::size_t beam = most;; --beam) {  // the beam above is crossing_[beam]
      const CrossingBeam& crossing = crossing_[beam];
      const FourMasks falls = known & ~rose & (now == static_cast<double>(beam)) & is_above(crossing, here);
      if (Form::bits_of(falls) != 0) {
        now -= select(falls, broadcast(1), Fours{});
        least = std::min(least, beam - 1);
        const FourMasks passes = falls & joined & ~is_above(crossing, before);
        if (Form::bits_of(passes) != 0) intersect<Form>(crossing, before, here, passes, hit[beam - 1]);
      } else if (beam <= least) {
        break;
      }
    }
    if (least != most) {
      while (Form::bits_of(now == static_cast<double>(least)) == 0) ++least;
      while (Form::bits_of(now == static_cast<double>(most)) == 0) --most;
    }
    const FourInts passed = truncated(now);
    for (std::size_t i = 0; i < 4; ++i)
      below[static_cast<std::size_t>(passed[i])][i] |= std::uint64_t{known_ones >> i & 1u} << ring;
    before = here;
    ring_before = select(known, number, ring_before);
  }
  for (std::size_t beam = 0; beam < beams; ++beam) {
    const CrossingBeam& crossing = crossing_[beam + 1];
    const std::uint32_t open = Form::bits_of(hit[beam] == double{kUnknown});
    for (std::uint32_t left = open; left != 0; left &= left - 1) {
      const auto i = static_cast<std::size_t>(std::countr_zero(left));
      hit[beam][i] = nearest_passed(crossing, direction + i, below[beam][i] | below[beam + 1][i]);
    }
    const Fours away = hit[beam] + crossing.back;
    const FourMasks meets = (hit[beam] != double{kUnknown}) & (away > 0.0);
    store(truncated(select(meets, away * crossing.sec_elevation, Fours{})),
          hits_ + crossing.at + direction);  // above 0: rounded down
  }
}

}  // namespace lidarcodec
