#include "images/heads.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <functional>
#include <numeric>

#include "base/error.hpp"
#include "images/proportion.hpp"
#include "images/rows.hpp"

namespace lidarcodec {
namespace {

std::int32_t most_number(const PlaneFrame& frame, std::size_t plane, std::uint32_t unit) {
  const PlaneForm& form = frame.planes[plane];
  return static_cast<std::int32_t>(form.role == PlaneRole::Attribute ? ((1u << form.bits) - 1) / unit
                                                                     : RangeSteps(frame.step, form.bits).most());
}

bool may_be_mates(const PlaneFrame& frame, std::size_t earlier, std::size_t plane) {
  return frame.planes[earlier].role == PlaneRole::Attribute && frame.planes[earlier].of == frame.planes[plane].of;
}

// The earlier attribute that a plane is best in proportion to, or kNoMate: tried on a seventh of the cells, beside the
// cells to the left, by the logarithms of the errors.
std::size_t mate_of(const PlaneFrame& frame, const std::vector<PlaneNumbers>& all, const std::vector<PlaneHead>& before,
                    std::size_t plane) {
  const PlaneNumbers &own = all[plane], &ranges = all[frame.planes[plane].of];
  const auto error_of = [](std::int32_t a, std::int32_t b) {
    return static_cast<std::int64_t>(quarter_log(static_cast<std::uint32_t>(std::abs(a - b))));
  };
  std::size_t best = kNoMate;
  std::int64_t least = 0;
  for (std::size_t other = 0; other < plane; ++other) {
    if (!may_be_mates(frame, other, plane) || before[other].plan.way == PlaneWay::Constant) continue;
    Proportion proportion;
    std::int64_t gain = 0;
    for (std::size_t i = 1; i < own.size(); i += 7) {
      const std::int32_t mate = all[other][i];
      const std::int32_t fitting = proportion.of(mate, ranges[i], 1 << kMostPlaneBits);
      if (mate >= 4) gain += error_of(own[i], own[i - 1]) - error_of(own[i], fitting) - 1;
      proportion.learn(own[i], mate);
    }
    if (gain > least) {
      least = gain;
      best = other;
    }
  }
  return best;
}

// The most frequent value of a plane, if it is that of 15 cells of 16, else -1.
std::int32_t usual_value(const PlaneNumbers& values) {
  // Each of the few other cells makes at most two changes: most planes are known by their first cells to have none.
  const std::size_t most = 2 * (values.size() - values.size() / 16 * 15);
  std::size_t changes = 0;
  for (std::size_t i = 1; i < values.size(); ++i) {
    changes += values[i] != values[i - 1];
    if (changes > most) return -1;
  }
  std::int32_t usual = values[0];
  std::int64_t lead = 0;  // of the majority vote of Boyer and Moore
  for (const std::int32_t value : values) {
    if (lead == 0) usual = value;
    lead += value == usual ? 1 : -1;
  }
  const auto count = static_cast<std::size_t>(std::count(values.begin(), values.end(), usual));
  return count >= values.size() / 16 * 15 ? usual : -1;
}

// Whether at least one of `of` values repeats the last one with, or without, a return.
bool repeats(const PlaneNumbers& values, const PlaneNumbers& ranges, std::size_t of) {
  std::array<std::int32_t, 2> last = {-1, -1};
  std::size_t same = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    std::int32_t& before = last[ranges[i] > 0];
    same += before == values[i];
    if (same >= values.size() / of) return true;
    before = values[i];
  }
  return false;
}

// The greatest number that divides all values of a plane, and of those that are like it. all: divided by it.
std::vector<std::uint32_t> take_units(const PlaneFrame& frame, std::vector<PlaneNumbers>& all) {
  const auto divides = [&](std::size_t plane) { return frame.planes[plane].role == PlaneRole::Attribute; };
  std::vector<std::int32_t> units(all.size(), 1);
  for (std::size_t plane = all.size(); plane-- > 0;) {
    if (!divides(plane)) continue;
    std::int32_t unit = 0;
    for (const std::int32_t n : all[plane]) {
      if (unit == 1) break;
      unit = std::gcd(unit, n);
    }
    units[plane] = unit;
  }
  for (std::size_t plane = all.size(); plane-- > 0;) {
    std::int32_t& of_like = units[frame.planes[plane].like];
    of_like = std::gcd(of_like, units[plane]);
  }
  std::vector<std::uint32_t> result(all.size(), 1);
  for (std::size_t plane = 0; plane < all.size(); ++plane) {
    const std::size_t like = frame.planes[plane].like;
    result[plane] = like != plane ? result[like] : static_cast<std::uint32_t>(std::max(units[plane], 1));
    if (result[plane] == 1) continue;
    for (std::int32_t& n : all[plane]) n /= static_cast<std::int32_t>(result[plane]);
  }
  return result;
}

PlaneHead head_of(const PlaneFrame& frame, const std::vector<PlaneNumbers>& all, const std::vector<PlaneHead>& before,
                  std::uint32_t unit, bool quick) {
  const std::size_t plane = before.size();
  const PlaneNumbers& numbers = all[plane];
  PlaneHead head;
  head.unit = unit;
  head.plan.form = frame.planes[plane];
  head.plan.most = most_number(frame, plane, unit);
  if (std::adjacent_find(numbers.begin(), numbers.end(), std::not_equal_to<>()) == numbers.end()) {
    head.plan.constant = numbers.empty() ? 0 : numbers[0];
    return head;
  }
  head.plan.way = PlaneWay::Numbers;
  if (head.plan.form.role != PlaneRole::Attribute) return head;
  if (head.plan.form.like == plane && usual_value(numbers) >= 0) {
    head.plan.way = PlaneWay::Sparse;
    head.plan.constant = usual_value(numbers);
    return head;
  }
  head.mate = mate_of(frame, all, before, plane);
  if (head.mate == kNoMate && head.plan.most < 256 && repeats(numbers, all[head.plan.form.of], quick ? 4 : 8))
    head.plan.way = PlaneWay::Symbols;
  return head;
}

PlaneHead read_head(ByteReader& reader, const PlaneFrame& frame, const std::vector<PlaneHead>& before) {
  const std::size_t plane = before.size(), at = reader.at();
  const auto refuse = [at](const char* why) { throw Error(ErrorCode::Section, why, at); };
  PlaneHead head;
  head.plan.form = frame.planes[plane];
  const bool attribute = head.plan.form.role == PlaneRole::Attribute;
  const std::uint64_t way = reader.number(1);
  if (way > static_cast<std::uint64_t>(PlaneWay::Sparse)) refuse("a plane that is coded in an unknown way");
  head.plan.way = static_cast<PlaneWay>(way);
  if (attribute) {
    const std::uint64_t unit = head.plan.form.like == plane ? take_number(reader) : before[head.plan.form.like].unit;
    if (unit == 0 || unit >> head.plan.form.bits != 0) refuse("a plane with a unit beyond its values");
    head.unit = static_cast<std::uint32_t>(unit);
  }
  head.plan.most = most_number(frame, plane, head.unit);
  if (head.plan.way == PlaneWay::Constant || head.plan.way == PlaneWay::Sparse) {
    const std::uint64_t value = take_number(reader);
    if (value > static_cast<std::uint64_t>(head.plan.most)) refuse("a plane with a usual value beyond its limits");
    head.plan.constant = static_cast<std::int32_t>(value);
  }
  if (head.plan.way == PlaneWay::Constant) return head;
  if (frame.rows * frame.columns == 0) refuse("numbers of a plane without cells");
  if (head.plan.way == PlaneWay::Symbols && (!attribute || head.plan.most > 255))
    refuse("symbols of a plane that has none");
  if (head.plan.way == PlaneWay::Sparse && (!attribute || head.plan.form.like != plane))
    refuse("a usual value of a plane that has none");
  if (attribute) {
    head.mate = reader.number(1);
    if (head.mate != kNoMate && (head.mate >= plane || !may_be_mates(frame, head.mate, plane)))
      refuse("a plane in proportion to one that does not fit");
  }
  head.bytes = take_number(reader);
  return head;
}

}  // namespace

std::vector<PlaneHead> choose_heads(const PlaneFrame& frame, std::vector<PlaneNumbers>& all, bool quick) {
  const std::vector<std::uint32_t> units = take_units(frame, all);
  std::vector<PlaneHead> heads;
  for (std::size_t plane = 0; plane < all.size(); ++plane)
    heads.push_back(head_of(frame, all, heads, units[plane], quick));
  return heads;
}

void write_head(std::vector<std::uint8_t>& out, const PlaneFrame& frame, const PlaneHead& head, std::size_t plane) {
  out.push_back(static_cast<std::uint8_t>(head.plan.way));
  const bool attribute = head.plan.form.role == PlaneRole::Attribute;
  if (attribute && frame.planes[plane].like == plane) put_number(out, head.unit);
  if (head.plan.way == PlaneWay::Constant || head.plan.way == PlaneWay::Sparse)
    put_number(out, static_cast<std::size_t>(head.plan.constant));
  if (head.plan.way == PlaneWay::Constant) return;
  if (attribute) out.push_back(static_cast<std::uint8_t>(head.mate));
  put_number(out, head.bytes);
}

std::vector<PlaneHead> read_heads(ByteReader& reader, const PlaneFrame& frame) {
  std::vector<PlaneHead> heads;
  while (heads.size() < frame.planes.size()) heads.push_back(read_head(reader, frame, heads));
  return heads;
}

}  // namespace lidarcodec
