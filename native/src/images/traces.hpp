// The frames before, as the rows of a frame see them, and what they become with it.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <utility>
#include <vector>

#include "images/frame_coder.hpp"
#include "images/memory.hpp"
#include "plane_motion/moved.hpp"

namespace lidarcodec {

// Most values in a mean beside the last.
inline constexpr std::uint8_t kMostAlike = 6;

class FrameTraces {
 public:
  // runs: of all columns of the frame, or none: then the frame before is not looked at. moved: of each plane of ranges
  // where a moved sensor looks instead; none: it did not move.
  FrameTraces(const PlaneFrame& frame, const std::vector<PlaneHead>& heads, const PlaneMemory& memory,
              const std::vector<ColumnRun>& runs, const std::vector<MovedPlane>& moved)
      : memory_(memory), alignment_(frame), columns_(frame.columns), fresh_(heads.size()) {
    for (const ColumnRun& run : runs)
      for (std::size_t i = 0; i < run.count; ++i) place_.push_back((run.first + i) % memory.columns());
    for (const PlaneHead& head : heads) {
      values_.emplace_back(frame, head);
      ranges_.push_back(head.plan.form.role != PlaneRole::Attribute);
      moved_.push_back(moved.empty() ? nullptr : &moved[ranges_.back() ? values_.size() - 1 : head.plan.form.of]);
    }
    for (PlaneTrace& trace : fresh_) {
      trace.mean.resize(frame.rows * columns_);
      trace.count.resize(frame.rows * columns_);
      trace.had.resize(frame.rows * columns_);
      trace.equal.resize(frame.rows * columns_);
    }
  }

  // What a plane's row is expected to be.
  void show(std::size_t plane, std::size_t row, PlaneRows& rows) const {
    if (place_.empty()) return;
    const PlaneTrace& trace = memory_.trace(plane);
    const PlaneValues& values = values_[plane];
    alignment_.for_row(row, [&](std::size_t x, std::size_t cell) {
      const std::size_t at = at_of(plane, row, cell);
      const auto mean = static_cast<std::uint32_t>(mean_of(plane, cell, trace, at));
      rows.was[0][x] = mean == 0 && ranges_[plane] ? kNothing : values.number((mean + 4) / 8);
      rows.had[0][x] = trace.had[at];
      rows.equalled[0][x] = trace.equal[at];
    });
    const auto last = static_cast<std::ptrdiff_t>(columns_) - 1;
    rows.was[0][-1] = rows.was[0][0];
    rows.was[0][last + 1] = rows.was[0][last];
    rows.had[0][-1] = rows.had[0][0];
    rows.had[0][last + 1] = rows.had[0][last];
    rows.equalled[0][-1] = rows.equalled[0][0];
    rows.equalled[0][last + 1] = rows.equalled[0][last];
  }

  // Takes a plane's row. numbers: as coded.
  void take(std::size_t plane, std::size_t row, const PlaneRows& rows, const std::int32_t* numbers) {
    const PlaneTrace* const trace = place_.empty() ? nullptr : &memory_.trace(plane);
    PlaneTrace& fresh = fresh_[plane];
    alignment_.for_row(row, [&](std::size_t x, std::size_t cell) {
      const std::uint8_t has = ranges_[plane] ? numbers[x] > 0 : 1;
      std::int32_t mean = 0;
      std::uint8_t count = 0;
      if (trace != nullptr) {
        const std::size_t at = at_of(plane, row, cell);
        mean = mean_of(plane, cell, *trace, at);
        count = trace->count[at];
      }
      if (has != 0) {
        const auto value = static_cast<std::int32_t>(8 * values_[plane].value(numbers[x]));
        const std::int32_t was = rows.was[0][x];
        if (was != kNothing && std::abs(numbers[x] - was) <= 3 << rows.scale[0][x]) {
          count = std::min(static_cast<std::uint8_t>(count + 1), kMostAlike);
          mean += (value - mean) / (count + 1);
        } else {
          count = 0;
          mean = value;
        }
      }
      fresh.mean[cell] = mean;
      fresh.count[cell] = count;
      fresh.had[cell] = static_cast<std::uint8_t>(rows.had[0][x] << 1 | has);
      fresh.equal[cell] = static_cast<std::uint8_t>(rows.equalled[0][x] << 1 | rows.equal[0][x]);
    });
  }

  std::vector<PlaneTrace> give() { return std::move(fresh_); }

 private:
  bool moves(std::size_t plane, std::size_t cell) const {
    return moved_[plane] != nullptr && moved_[plane]->source[cell] >= 0;
  }
  // The cell of the frame before that a cell sees.
  std::size_t at_of(std::size_t plane, std::size_t row, std::size_t cell) const {
    return moves(plane, cell) ? static_cast<std::size_t>(moved_[plane]->source[cell])
                              : row * memory_.columns() + place_[cell - row * columns_];
  }
  std::int32_t mean_of(std::size_t plane, std::size_t cell, const PlaneTrace& trace, std::size_t at) const {
    return ranges_[plane] && moves(plane, cell) ? moved_[plane]->mean[cell] : trace.mean[at];
  }

  const PlaneMemory& memory_;
  Alignment alignment_;
  std::size_t columns_;
  std::vector<std::size_t> place_;  // column of the frame before, of each column
  std::vector<PlaneValues> values_;
  std::vector<bool> ranges_;
  std::vector<const MovedPlane*> moved_;
  std::vector<PlaneTrace> fresh_;
};

}  // namespace lidarcodec
