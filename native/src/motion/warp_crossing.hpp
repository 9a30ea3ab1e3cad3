// Where beams meet the surface: down the rings of four directions at a time. Compiled for each kind of processor (motion/warp.cpp).
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
[[gnu::always_inline]] inline FourMasks Surface::is_above(const Asking& beam, const Places& at) {
  return (at.away + beam.back) * beam.slope < at.height - beam.up_0;
}

// How far. Exact: below 2^53, in steps of 2^-24.
template <class Form>
[[gnu::always_inline]] inline Fours Surface::above(const Asking& beam, const Places& at) {
  return at.height - beam.up_0 - rounded_down<Form>((at.away + beam.back) * beam.slope);
}

// A depth edge, or two surfaces at one height: nothing is between them.
[[gnu::always_inline]] inline FourMasks Surface::jump(const Places& a, const Places& b) {
  const Fours apart = size_of(b.away - a.away), near = chosen(a.away < b.away, a.away, b.away);
  return (apart * 20.0 > near * 7.0) |
         ((apart > 150.0 * kLengthsPerStep) & (apart * 4.0 > near) & (size_of(b.height - a.height) * 50.0 < apart));
}

// Where a beam that passes between two places meets what lies between them, if that is nearer than what it met before.
template <class Form>
[[gnu::always_inline]] inline void Surface::meet(const Asking& beam, const Places& a, const Places& b, FourMasks passes, Fours& met) {
  const Fours from = above<Form>(beam, a), all = chosen(passes, from - above<Form>(beam, b), four_times(1));
  // Exact: what is divided is below 2^50, and doubles of whole numbers below 2^53 divide and cut off as these do.
  const Fours part = fours_of<Form>(cut_off(chosen(passes, (b.away - a.away) * from, Fours{}) / all));
  const Fours closer = chosen(2.0 * size_of(from) < size_of(all), a.away, b.away);
  const Fours away = chosen(jump(a, b), closer, a.away + part);
  met = chosen(passes & (away + beam.back > 0.0) & (away < met), away, met);
}

template <class Form>
[[gnu::always_inline]] inline void Surface::cross(std::size_t direction) {
  constexpr std::size_t kNextLine = 8;  // the same ring's places in directions to come; rings are too far apart for the processor to see it
  const std::size_t beams = rows_.size();
  std::array<Fours, kRows> met;  // distance of each beam's meeting from the axis
  for (std::size_t beam = 0; beam < beams; ++beam) met[beam] = four_times(kUnknown);
  std::array<std::array<std::uint64_t, 4>, kRows + 1> below{};  // the rings that so many beams pass above or through

  const Place* at = points_ + direction;
  Places before{};
  Fours now{}, ring_before = four_times(-double{kRows});  // beams that pass above the last place, and its ring
  std::size_t least = 0, most = 0;                        // of `now`
  for (std::size_t ring = 0; ring < kRows; ++ring, at += kStride) {
    __builtin_prefetch(at + kNextLine);
    const FourInts aways{at[0].away, at[1].away, at[2].away, at[3].away}, heights{at[0].height, at[1].height, at[2].height, at[3].height};
    const FourMasks known = fours_of<Form>(aways) != double{kUnknown};
    const std::uint32_t known_ones = Form::set(known);
    if (known_ones == 0) continue;
    const Places here = {chosen(known, fours_of<Form>(aways), before.away), chosen(known, fours_of<Form>(heights), before.height)};
    const Fours number = four_times(static_cast<double>(ring));
    const FourMasks joined = known & (number - ring_before <= double{kRingsApart});
    FourMasks rose{};
    for (std::size_t beam = least;; ++beam) {
      const Asking& asks = asking_[beam + 1];
      const FourMasks rises = known & (now == static_cast<double>(beam)) & ~is_above(asks, here);
      if (Form::set(rises) != 0) {
        rose |= rises;
        now += chosen(rises, four_times(1), Fours{});
        most = std::max(most, beam + 1);
        const FourMasks passes = rises & joined & is_above(asks, before);
        if (Form::set(passes) != 0) meet<Form>(asks, before, here, passes, met[beam]);
      } else if (beam >= most) {
        break;
      }
    }
    for (std::size_t beam = most;; --beam) {  // the one above, asking_[beam]
      const Asking& asks = asking_[beam];
      const FourMasks falls = known & ~rose & (now == static_cast<double>(beam)) & is_above(asks, here);
      if (Form::set(falls) != 0) {
        now -= chosen(falls, four_times(1), Fours{});
        least = std::min(least, beam - 1);
        const FourMasks passes = falls & joined & ~is_above(asks, before);
        if (Form::set(passes) != 0) meet<Form>(asks, before, here, passes, met[beam - 1]);
      } else if (beam <= least) {
        break;
      }
    }
    if (least != most) {
      while (Form::set(now == static_cast<double>(least)) == 0) ++least;
      while (Form::set(now == static_cast<double>(most)) == 0) --most;
    }
    const FourInts passed = cut_off(now);
    for (std::size_t i = 0; i < 4; ++i)
      below[static_cast<std::size_t>(passed[i])][i] |= std::uint64_t{known_ones >> i & 1u} << ring;
    before = here;
    ring_before = chosen(known, number, ring_before);
  }
  for (std::size_t beam = 0; beam < beams; ++beam) {
    const Asking& asks = asking_[beam + 1];
    const std::uint32_t open = Form::set(met[beam] == double{kUnknown});
    for (std::uint32_t left = open; left != 0; left &= left - 1) {
      const auto i = static_cast<std::size_t>(std::countr_zero(left));
      met[beam][i] = graze(asks, direction + i, below[beam][i] | below[beam + 1][i]);
    }
    const Fours away = met[beam] + asks.back;
    const FourMasks meets = (met[beam] != double{kUnknown}) & (away > 0.0);
    put(cut_off(chosen(meets, away * asks.lengthen, Fours{})), met_ + asks.at + direction);  // above 0: rounded down
  }
}

}  // namespace lidarcodec
