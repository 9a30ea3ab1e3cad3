#include "planes/azimuth_coder.hpp"

#include <algorithm>
#include <array>

#include "base/error.hpp"
#include "bits/numbers.hpp"
#include "bits/rangecoder.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint32_t kTurn = 36000;
constexpr std::size_t kSteps = 4;  // most steps that get a number

enum Flag : std::uint8_t { kAllFired = 1, kLowerFirst = 2, kStepsShift = 2, kKnown = 0x1F };

// The most frequent steps by number: 0 is the most frequent one, kSteps stands for any other.
struct StepTable {
  std::array<std::uint16_t, kSteps> steps{};
  std::size_t count = 0;

  std::size_t number(std::uint32_t step) const {
    for (std::size_t i = 0; i < count; ++i) {
      if (steps[i] == step) return i;
    }
    return kSteps;
  }
};

class StepModel {
 public:
  explicit StepModel(const StepTable& table)
      : table_(table), by_two_runs_(kRuns * kRuns * 4), by_three_runs_(kRuns * kRuns * kRuns) {}

  // Codes the step from one azimuth to the next, 0 to 35999.
  template <class Bits>
  std::uint32_t code(Bits& bits, std::uint32_t step) {
    const std::size_t wanted = table_.number(step);
    BitModel& a = by_two_runs_[(run_ * kRuns + runs_[0]) * 4 + last_];
    BitModel& b = by_three_runs_[(run_ * kRuns + runs_[0]) * kRuns + runs_[1]];
    const bool again = bits.bit(wanted == 0, mixer_.mix(a, b));
    mixer_.update(again);
    a.update(again);
    b.update(again);
    if (again) {
      run_ += run_ < kRuns - 1;
    } else {
      runs_[1] = runs_[0];
      runs_[0] = run_;
      run_ = 0;
    }
    std::size_t number = 0;
    while (!again && ++number < kSteps) {
      BitModel& model = numbers_[last_][number - 1];
      const bool found = bits.bit(wanted == number, model.probability());
      model.update(found);
      if (found) break;
    }
    if (!again) last_ = std::min(number, kSteps - 1);
    if (number < kSteps) {
      if (number >= table_.count) throw Error(ErrorCode::Section, "a rotation step that the section does not list");
      return table_.steps[number];
    }
    const std::uint64_t other = others_.code(bits, step);
    if (other >= kTurn) throw Error(ErrorCode::Section, "a rotation step of more than a turn");
    return static_cast<std::uint32_t>(other);
  }

 private:
  static constexpr std::size_t kRuns = 16;  // lengths of runs; the last one stands for all longer ones
  const StepTable& table_;
  std::vector<BitModel> by_two_runs_, by_three_runs_;
  Mixer mixer_;
  std::array<std::array<BitModel, kSteps - 1>, kSteps> numbers_;
  NumberModel others_;
  std::size_t run_ = 0, last_ = 0;
  std::array<std::size_t, 2> runs_{};
};

// Codes which halves of a column fired, upper + 2 * lower, in the context of the three columns before.
class FiredModel {
 public:
  template <class Bits>
  std::size_t code(Bits& bits, std::size_t fired) {
    std::size_t node = 1;
    for (int i = 1; i >= 0; --i) {
      BitModel& model = models_[before_][node];
      const bool bit = bits.bit((fired >> i) & 1u, model.probability());
      model.update(bit);
      node = node << 1 | static_cast<std::size_t>(bit);
    }
    before_ = (before_ << 2 | (node & 3)) & 63;
    return node & 3;
  }

 private:
  std::array<std::array<BitModel, 4>, 64> models_;
  std::size_t before_ = 0;
};

constexpr std::uint32_t step_between(std::uint32_t from, std::uint32_t to) {
  return to >= from ? to - from : to + kTurn - from;
}

template <class Bits, class Azimuth, class Fired>
void code_columns(Bits& bits, const StepTable& table, std::uint8_t flags, std::size_t width, Azimuth* azimuth,
                  Fired* fired) {
  StepModel steps(table);
  FiredModel firing;
  std::array<BitModel, 4> same;
  std::size_t recent = 3;  // whether the last two second blocks had the azimuth of the first
  std::uint32_t at = 0;
  const auto rotate = [&](std::uint32_t to) {
    at += steps.code(bits, step_between(at, to));
    at -= at >= kTurn ? kTurn : 0;
    return static_cast<std::uint16_t>(at);
  };
  for (std::size_t column = 0; column < width; ++column) {
    std::size_t halves = 3;
    if (!(flags & kAllFired))
      halves = firing.code(bits, static_cast<std::size_t>(fired[column] != 0) |
                                     static_cast<std::size_t>(fired[width + column] != 0) << 1);
    const bool lower_first = halves == 2 || (halves == 3 && (flags & kLowerFirst));
    Azimuth* first = azimuth + column + (lower_first ? width : 0);
    Azimuth* second = azimuth + column + (lower_first ? 0 : width);
    const std::uint16_t rotation = rotate(*first);
    std::uint16_t other = rotation;
    if (halves == 3) {
      const bool equal = bits.bit(*first == *second, same[recent].probability());
      same[recent].update(equal);
      recent = (recent << 1 | static_cast<std::size_t>(equal)) & 3;
      if (!equal) other = rotate(*second);
    }
    if constexpr (Bits::kReads) {
      *first = rotation;
      *second = other;
      fired[column] = halves & 1;
      fired[width + column] = halves >> 1 & 1;
    }
  }
  bits.finish();
}

// Steps in the order in which the coder meets them.
template <class Visit>
void for_each_step(const std::uint16_t* azimuth, const std::uint8_t* fired, std::size_t width, bool lower_first,
                   Visit&& visit) {
  std::uint32_t at = 0;
  for (std::size_t column = 0; column < width; ++column) {
    const bool both = fired[column] && fired[width + column];
    const bool lower = !fired[column] || (both && lower_first);
    const std::uint32_t first = azimuth[column + (lower ? width : 0)], second = azimuth[column + (lower ? 0 : width)];
    visit(step_between(at, first));
    if (first != second) visit(step_between(first, second));
    at = second;
  }
}

StepTable frequent_steps(const std::uint16_t* azimuth, const std::uint8_t* fired, std::size_t width, bool lower_first) {
  std::vector<std::uint32_t> counts(kTurn);
  std::vector<std::uint16_t> steps;  // that occur
  for_each_step(azimuth, fired, width, lower_first, [&](std::uint32_t step) {
    if (counts[step]++ == 0) steps.push_back(static_cast<std::uint16_t>(step));
  });
  StepTable table;
  while (table.count < kSteps && !steps.empty()) {
    const auto rarer = [&](std::uint16_t a, std::uint16_t b) {
      return counts[a] != counts[b] ? counts[a] < counts[b] : a > b;
    };
    const std::uint16_t most = *std::max_element(steps.begin(), steps.end(), rarer);
    if (counts[most] < 3) break;  // a number costs two bytes in the table
    table.steps[table.count++] = most;
    counts[most] = 0;
  }
  return table;
}

}  // namespace

std::vector<std::uint8_t> encode_azimuth(const std::uint16_t* azimuth, const std::uint8_t* fired, std::size_t width) {
  std::size_t lower_behind = 0, both = 0, unequal = 0;
  for (std::size_t column = 0; column < width; ++column) {
    const std::uint32_t upper = azimuth[column], lower = azimuth[width + column];
    if (upper >= kTurn || lower >= kTurn) throw Error(ErrorCode::Section, "a rotation of a full turn or more");
    if (fired[column] && fired[width + column]) {
      ++both;
      unequal += upper != lower;
      lower_behind += upper != lower && step_between(lower, upper) < kTurn / 2;
    } else if (upper != lower) {
      throw Error(ErrorCode::Section, "a half that did not fire must repeat the rotation of the other");
    }
  }
  const bool lower_first = 2 * lower_behind > unequal;
  const StepTable table = frequent_steps(azimuth, fired, width, lower_first);
  const auto flags = static_cast<std::uint8_t>((both == width ? kAllFired : 0) | (lower_first ? kLowerFirst : 0) |
                                               table.count << kStepsShift);
  std::vector<std::uint8_t> out = {flags};
  for (std::size_t i = 0; i < table.count; ++i) {
    out.push_back(static_cast<std::uint8_t>(table.steps[i] & 0xFF));
    out.push_back(static_cast<std::uint8_t>(table.steps[i] >> 8));
  }
  BitWriter bits(out);
  code_columns(bits, table, flags, width, azimuth, fired);
  return out;
}

Azimuths decode_azimuth(const std::uint8_t* data, std::size_t size, std::size_t width) {
  if (size == 0) throw Error(ErrorCode::Truncated, "an azimuth section holds no bytes");
  const std::uint8_t flags = data[0];
  StepTable table;
  table.count = flags >> kStepsShift;
  if (flags > kKnown || table.count > kSteps) throw Error(ErrorCode::Section, "an azimuth section with unknown flags");
  const std::size_t header = 1 + 2 * table.count;
  if (size < header) throw Error(ErrorCode::Truncated, "an azimuth section ends within its steps", size);
  for (std::size_t i = 0; i < table.count; ++i) {
    table.steps[i] = static_cast<std::uint16_t>(data[1 + 2 * i] | data[2 + 2 * i] << 8);
    if (table.steps[i] >= kTurn) throw Error(ErrorCode::Section, "a rotation step of more than a turn", 1 + 2 * i);
  }
  Azimuths decoded{std::vector<std::uint16_t>(2 * width), std::vector<std::uint8_t>(2 * width)};
  BitReader bits(data + header, size - header);
  code_columns(bits, table, flags, width, decoded.azimuth.data(), decoded.fired.data());
  return decoded;
}

std::uint32_t columns_in_turn(const std::uint16_t* rotations, std::size_t count) {
  constexpr std::int64_t kWhole = kTurn;
  struct Steps {
    std::int64_t count = 0, sum = 0;
  };
  const auto below = [&](const auto& is_step) {
    Steps steps;
    for (std::size_t i = 1; i < count; ++i) {
      const std::int64_t apart = std::int64_t{rotations[i]} - rotations[i - 1],
                         step = apart < 0 ? apart + kWhole : apart;
      if (step >= kWhole / 2 || !is_step(step)) continue;
      ++steps.count;
      steps.sum += step;
    }
    return steps;
  };
  const Steps all = below([](std::int64_t) { return true; });
  const Steps usual = below([&](std::int64_t step) { return step * all.count <= 4 * all.sum; });
  const std::int64_t whole = kWhole * usual.count;
  if (whole <= 0 || whole > 65535 * usual.sum) return 0;
  return static_cast<std::uint32_t>((whole + usual.sum / 2) / usual.sum);
}

}  // namespace lidarcodec
