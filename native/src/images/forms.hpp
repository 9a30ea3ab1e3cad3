// What the planes of a frame are. docs/wire-format-planes.md has the format of their bytes.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

enum class PlaneRole : std::uint8_t { Range, SecondRange, Attribute };

// A plane. of: number of the range plane whose returns it describes, its own for a range plane. like: number of an
// earlier plane that it mostly repeats, its own if there is none.
struct PlaneForm {
  PlaneRole role = PlaneRole::Range;
  std::uint32_t bits = 16;
  std::size_t of = 0;
  std::size_t like = 0;
};

inline constexpr std::size_t kMostPlaneRows = 1024;
inline constexpr std::size_t kMostPlaneColumns = 65536;
inline constexpr std::size_t kMostPlaneCells = std::size_t{1} << 24;
inline constexpr std::size_t kMostPlanes = 32;
inline constexpr std::uint32_t kMostPlaneBits = 20;
inline constexpr std::uint32_t kMostRangeStep = 65535;

// A frame of planes. shift: cell (row, x) looks in the direction of column x + shift[row]. step: of ranges, odd.
struct PlaneFrame {
  std::size_t rows = 0, columns = 0;
  std::vector<std::int32_t> shift;
  std::uint32_t step = 1;
  std::vector<PlaneForm> planes;
};

// Raises Settings unless sizes, planes and step are within the limits above and fit together.
void check_frame(const PlaneFrame& frame);

// (rows, columns) of one plane.
using PlaneImage = std::vector<std::uint32_t>;

// Numbers of ranges in steps: 0 stays 0; with step 1 a range is its own number, else 1 + (range + (step - 1) / 2) /
// step.
class RangeSteps {
 public:
  RangeSteps(std::uint32_t step, std::uint32_t bits) : step_(step), largest_((1u << bits) - 1) {}

  std::uint32_t most() const { return number(largest_); }
  std::uint32_t number(std::uint32_t range) const {
    if (step_ == 1 || range == 0) return range;
    return 1 + (range + (step_ - 1) / 2) / step_;
  }
  // The inverse, at most (step - 1) / 2 off. number: up to most().
  std::uint32_t range(std::uint32_t number) const {
    if (step_ == 1 || number == 0) return number;
    if (number == 1) return ((step_ - 1) / 2 + 1) / 2;
    const std::uint64_t middle = std::uint64_t{number - 1} * step_;
    return middle < largest_ ? static_cast<std::uint32_t>(middle) : largest_;
  }

 private:
  std::uint32_t step_, largest_;
};

}  // namespace lidarcodec
