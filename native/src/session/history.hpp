// What a stream has shown since its last message that needs no other: the rules are docs/wire-format.md ("Mask and
// keep"), docs/wire-format-motion.md and docs/wire-format-predictive.md ("Slabs"), of
// encoders lidarcodec/motion/history.py.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "motion/beams.hpp"
#include "motion/range_history.hpp"

namespace lidarcodec {

// Which cells were returns in each of 2000 directions.
class MaskMemory {
 public:
  void forget();
  // Forgets all but this mask, (64, W), which waits until another refers to it: most streams never ask.
  void begin(const std::vector<std::uint8_t>& mask, const Columns& columns, const Halves& half);
  // (64, W), what was last sent in the direction of each cell.
  std::vector<std::uint8_t> before(const Columns& columns, const Halves& half);
  void remember(const std::vector<std::uint8_t>& mask, const Columns& columns, const Halves& half);

 private:
  static constexpr std::size_t kDirections = 2000, kStep = 18;
  struct Waiting {
    std::vector<std::uint8_t> mask;
    std::vector<std::uint16_t> azimuth;
    Halves half;
    std::size_t width;
  };

  void take_waiting();
  void put(const std::vector<std::uint8_t>& mask, std::size_t width, const std::uint16_t* azimuth, const Halves& half);

  std::vector<std::uint8_t> sent_ = std::vector<std::uint8_t>(kRows * kDirections);
  std::optional<Waiting> waiting_;
};

// Columns to the left of a slab, that both ends know.
struct Edge {
  std::size_t width = 0;
  std::vector<std::uint16_t> ranges, expected;  // (64, K); 0: no return, nothing expected
  std::vector<std::uint8_t> fired;              // (2, K)

  // The last of them, at most so many.
  Edge last(std::size_t columns) const;
  // These, and others to their right.
  Edge and_then(const Edge& other) const;
};

// What ranges refer to.
class StreamMemory {
 public:
  void forget();

  // The motion of a MOTION section, or the last one if it is empty. Raises Section.
  const Motion& motion(const std::uint8_t* data, std::size_t size);
  // (64, W), what a frame is expected to look like.
  std::vector<std::uint16_t> expected(const Motion& motion, const Columns& columns, const BeamTable& table) const;

  // The last so many columns. Raises Section if there are fewer.
  Edge edge(std::size_t columns) const;
  void keep_edge(const Edge& slab) { edge_ = edge_.and_then(slab).last(kEdgeColumns); }
  void forget_edge() { edge_ = {}; }

  // Takes a frame as it was decoded, (64, W). A slab waits until enough was sent after it.
  void remember(const std::vector<std::uint16_t>& ranges, const Columns& columns, const Halves& half, bool slab);

 private:
  static constexpr std::size_t kEdgeColumns = 128, kWaitingSweep = 3600, kWaitingColumns = 1024;
  struct Sent {
    std::vector<std::uint16_t> ranges, azimuth;
    std::vector<std::uint8_t> fired;
    Halves half;
    std::size_t width, swept;
  };

  RangeHistory seen_;
  std::deque<Sent> waiting_;
  Edge edge_;
  std::optional<Motion> motion_;
};

}  // namespace lidarcodec
