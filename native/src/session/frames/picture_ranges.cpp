#include "session/frames/picture_ranges.hpp"

#include <algorithm>

#include "base/varint.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint32_t kMostStep = 40'001;
constexpr unsigned kSampleBits = 16;

// The samples of a picture, at their cells: of jxl its rows are moved.
PlaneImage samples_of_cells(const Message& message, const Outside& outside, Bytes picture, std::size_t columns,
                            const PlaneSection& section) {
  const std::vector<std::uint16_t> samples = samples_of(outside, {message.codec, picture, section.rows, columns});
  PlaneImage cells(samples.begin(), samples.end());
  if (message.codec == Codec::Png) return cells;
  const auto round = static_cast<std::int64_t>(columns);
  for (std::size_t row = 0; row < section.rows; ++row) {
    const auto from = samples.begin() + static_cast<std::ptrdiff_t>(row * columns);
    const std::int64_t moved = (section.shift[row] % round + round) % round;
    std::rotate_copy(from, from + moved, from + round, cells.begin() + static_cast<std::ptrdiff_t>(row * columns));
  }
  return cells;
}

// Ranges of numbers, none of which may be beyond the last of the step.
void to_ranges(PlaneImage& numbers, std::uint32_t step, std::uint32_t bits) {
  const RangeSteps steps(step, bits);
  const std::uint32_t most = (std::uint32_t{1} << bits) - 1;
  for (std::uint32_t& number : numbers) {
    if (number > steps.most())
      throw Error(ErrorCode::Section, "a picture with a range number beyond 1 to " + std::to_string(steps.most()));
    number = std::min(steps.range(number), most);  // a step may be too large for the plane
  }
}

}  // namespace

void check_second(const std::vector<NamedPlane>& planes) {
  for (const NamedPlane& plane : planes)
    if ((plane.role == PlaneRole::SecondRange) != (plane.name == "range2"))
      throw Error(ErrorCode::Section, "a picture beside a plane '" + plane.name + "' in another role than its name");
}

void take_picture(const Message& message, const Outside& outside, std::size_t columns, PlaneSection& section) {
  VarintReader reader(message.section(SectionType::Range), "ranges");
  const std::uint32_t bits = reader.byte();
  const auto step = static_cast<std::uint32_t>(reader.number(kMostStep, 1));
  if (bits < 1 || bits > kMostPlaneBits || step % 2 == 0)
    throw Error(ErrorCode::Section,
                "a picture of ranges of " + std::to_string(bits) + " bits with step " + std::to_string(step));
  check_second(section.planes);
  const Bytes picture = reader.rest();
  NamedPlane& first = section.planes[0];
  const PlaneImage small = first.values;
  if (std::any_of(small.begin(), small.end(), [](std::uint32_t number) { return number != 0; })) {
    first.values = samples_of_cells(message, outside, picture, columns, section);
  } else if (!picture.empty()) {
    throw Error(ErrorCode::Section, std::to_string(picture.size()) + " bytes of ranges for no return");
  }
  for (std::size_t i = 0; i < small.size(); ++i) {
    if (small[i] == 0)
      first.values[i] = 0;
    else if ((first.values[i] |= (small[i] - 1) << kSampleBits) == 0)
      throw Error(ErrorCode::Section, "a picture with a return of range 0");
  }
  first.bits = bits;
  for (NamedPlane& plane : section.planes) {
    if (plane.role != PlaneRole::SecondRange) continue;
    plane.bits = std::max(plane.bits, bits);
    for (std::size_t i = 0; i < small.size(); ++i) {
      std::uint32_t& second = plane.values[i];  // the first one's number and its small one have changed places
      second = second == first.values[i] ? small[i] : second == small[i] ? first.values[i] : second;
    }
    to_ranges(plane.values, step, bits);
  }
  to_ranges(first.values, step, bits);
}

}  // namespace lidarcodec
