// What a stream remembers of the planes that it sent, from one frame to the next.
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "images/forms.hpp"
#include "images/models.hpp"
#include "plane_motion/directions.hpp"
#include "plane_motion/motion.hpp"

namespace lidarcodec {

// A plane of the frames before, (rows, columns) each.
struct PlaneTrace {
  std::vector<std::int32_t> mean;        // of its values as long as they were alike, in eighths
  std::vector<std::uint8_t> count;       // values in that mean beside the last, up to kMostAlike
  std::vector<std::uint8_t> had, equal;  // of the last eight frames, the last one in bit 0
};

// Columns from `first` on, so many as `count` says: where the next columns of a frame look in the frame before.
struct ColumnRun {
  std::size_t count = 0, first = 0;
};

// The state of a stream: give it to each frame in turn. An encoder's and a decoder's are the same after each frame. A
// call that raises leaves it empty.
class PlaneMemory {
 public:
  using Models = PlaneModels<PlaneEffort::Follows>;

  PlaneMemory() = default;
  PlaneMemory(PlaneMemory&&) = default;
  PlaneMemory& operator=(PlaneMemory&&) = default;
  PlaneMemory(const PlaneMemory&) = delete;  // models are large
  PlaneMemory& operator=(const PlaneMemory&) = delete;
  ~PlaneMemory() = default;

  void forget() { *this = PlaneMemory(); }
  bool empty() const { return models_.empty(); }
  std::size_t columns() const { return columns_; }

  // Forgets everything if rows or planes are others than before; whether there is a frame before then.
  bool begin(const PlaneFrame& frame);
  Models& models(std::size_t plane) { return *models_[plane]; }
  const PlaneTrace& trace(std::size_t plane) const { return traces_[plane]; }
  void keep(std::vector<PlaneTrace> traces, std::size_t columns) {
    traces_ = std::move(traces);
    columns_ = columns;
  }

  // Where the beams look, where the columns of the frame before look, and how the sensor moved up to it, as far as they
  // are known.
  PlaneBeams beams;
  PlaneColumns directions;
  std::optional<PlaneMotion> motion;

 private:
  std::size_t rows_ = 0, columns_ = 0;
  std::vector<PlaneForm> forms_;
  std::vector<std::unique_ptr<Models>> models_;
  std::vector<PlaneTrace> traces_;
};

}  // namespace lidarcodec
