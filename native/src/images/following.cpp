#include "images/following.hpp"

#include <algorithm>

#include "base/bytes.hpp"
#include "base/error.hpp"
#include "images/coder.hpp"
#include "images/frame_coder.hpp"
#include "images/motion_choice.hpp"
#include "images/traces.hpp"

namespace lidarcodec {
namespace {

constexpr auto kFollows = PlaneEffort::Follows;
constexpr std::uint8_t kFollowing = 3;                         // the first byte
constexpr std::uint8_t kBeams = 1, kColumns = 2, kMotion = 4;  // what is there of a moving sensor

bool runs_fit(const std::vector<ColumnRun>& runs, std::size_t columns, std::size_t before) {
  std::size_t all = 0;
  for (const ColumnRun& run : runs) {
    if (run.count == 0 || run.count > columns - all || run.first >= before) return false;
    all += run.count;
  }
  return all == columns;
}

std::vector<ColumnRun> read_runs(ByteReader& reader, std::size_t columns, std::size_t before) {
  const std::uint64_t count = take_number(reader);
  if (count > columns) throw Error(ErrorCode::Section, "more runs of columns than columns", reader.at());
  std::vector<ColumnRun> runs;
  while (runs.size() < count) {
    const std::size_t size = take_number(reader);
    runs.push_back({size, take_number(reader)});
  }
  if (!runs.empty() && !runs_fit(runs, columns, before))
    throw Error(ErrorCode::Section, "runs of columns that do not fit the frame, or the one before", reader.at());
  return runs;
}

// All rows of a frame. row_of: numbers of the planes of a row; done: called after each row.
template <class Coder, class RowOf, class Done>
void code_rows(FrameCoder<Coder, kFollows>& coder, FrameTraces& traces, const PlaneFrame& frame, const RowOf& row_of,
               const Done& done) {
  for (std::size_t row = 0; row < frame.rows; ++row) {
    const std::vector<std::int32_t*> values = row_of(row);
    for (std::size_t plane = 0; plane < values.size(); ++plane) traces.show(plane, row, coder[plane].rows());
    coder.code_row(row, values);
    for (std::size_t plane = 0; plane < values.size(); ++plane)
      traces.take(plane, row, coder[plane].rows(), values[plane]);
    done(row, values);
  }
}

// Each plane of ranges as a sensor that moved sees it; nothing of attributes.
std::vector<MovedPlane> move_all(const PlaneMemory& memory, const PlaneFrame& frame, const PlaneColumns& now,
                                 const PlaneMotion& motion) {
  PlaneMover mover(memory.beams, memory.directions, now);
  std::vector<MovedPlane> moved(frame.planes.size());
  for (std::size_t plane = 0; plane < moved.size(); ++plane)
    if (frame.planes[plane].role != PlaneRole::Attribute)
      moved[plane] = mover.move(memory.trace(plane).mean, motion, (8 << frame.planes[plane].bits) - 8);
  return moved;
}

// Writes where the sensor looks and how it moved. Returns the planes of ranges as it sees them now, if that helps.
std::vector<MovedPlane> put_view(std::vector<std::uint8_t>& out, PlaneMemory& memory, const PlaneFrame& frame,
                                 const std::vector<PlaneImage>& images, const std::vector<ColumnRun>& runs,
                                 const SensorView& view) {
  std::vector<std::uint8_t> beams, columns, motion;
  std::vector<MovedPlane> moved;
  PlaneColumns now;
  if (beams_fit(view.beams, frame.rows) && view.azimuth.size() == frame.columns) {
    if (memory.beams != view.beams) {
      put_beams(beams, view.beams);
      memory.beams = view.beams;
      memory.motion.reset();
    }
    now = put_columns(columns, view.azimuth);
  }
  if (!runs.empty() && now.known() && memory.directions.known()) {
    const Seen before{memory.trace(0).mean, memory.directions, runs};
    memory.motion = motion_between(memory.beams, before, images[0], now, 8 * view.metre, memory.motion);
    if (memory.motion && is_moved(*memory.motion, 8 * view.metre)) {
      moved = move_all(memory, frame, now, *memory.motion);
      if (pays(before, moved[0], images[0])) {
        put_motion(motion, *memory.motion);
      } else {
        moved.clear();
      }
    }
  }
  out.push_back(static_cast<std::uint8_t>((beams.empty() ? 0 : kBeams) | (columns.empty() ? 0 : kColumns) |
                                          (motion.empty() ? 0 : kMotion)));
  for (const auto* part : {&beams, &columns, &motion}) out.insert(out.end(), part->begin(), part->end());
  memory.directions = std::move(now);
  return moved;
}

// Reads what put_view writes.
std::vector<MovedPlane> take_view(ByteReader& reader, PlaneMemory& memory, const PlaneFrame& frame,
                                  const std::vector<ColumnRun>& runs) {
  const auto marks = static_cast<std::uint8_t>(reader.number(1));
  if (marks >= 2 * kMotion) throw Error(ErrorCode::Section, "planes of a sensor that moves in an unknown way");
  if ((marks & kBeams) != 0) memory.beams = take_beams(reader, frame.rows);
  PlaneColumns now;
  if ((marks & kColumns) != 0) now = take_columns(reader, frame.columns);
  std::vector<MovedPlane> moved;
  if ((marks & kMotion) != 0) {
    const PlaneMotion motion = take_motion(reader);
    if (runs.empty() || !memory.beams.known() || !now.known() || !memory.directions.known())
      throw Error(ErrorCode::Section, "a motion between planes whose directions are not known", reader.at());
    moved = move_all(memory, frame, now, motion);
  }
  memory.directions = std::move(now);
  return moved;
}

std::vector<std::uint8_t> encode(PlaneMemory& memory, const PlaneFrame& frame, const std::vector<PlaneImage>& images,
                                 const std::vector<ColumnRun>& given, const SensorView& view) {
  std::vector<PlaneNumbers> all = numbers_of_all(frame, images);
  std::vector<PlaneHead> heads = choose_heads(frame, all, false);
  std::vector<ColumnRun> runs;
  if (memory.begin(frame)) runs = given;
  if (!runs.empty() && !runs_fit(runs, frame.columns, memory.columns()))
    throw Error(ErrorCode::Settings, "runs of columns that do not fit the frame, or the one before");
  std::vector<std::uint8_t> out = {kFollowing};
  put_number(out, runs.size());
  for (const ColumnRun& run : runs) {
    put_number(out, run.count);
    put_number(out, run.first);
  }
  const std::vector<MovedPlane> moved = put_view(out, memory, frame, images, runs, view);

  FrameCoder<WideEncoder, kFollows> coder(frame.columns);
  for (std::size_t plane = 0; plane < heads.size(); ++plane)
    coder.add(heads[plane], memory.models(plane), WideEncoder());
  FrameTraces traces(frame, heads, memory, runs, moved);
  code_rows(
      coder, traces, frame,
      [&](std::size_t row) {
        std::vector<std::int32_t*> values;
        for (PlaneNumbers& numbers : all) values.push_back(numbers.data() + row * frame.columns);
        return values;
      },
      [](std::size_t, const std::vector<std::int32_t*>&) {});
  memory.keep(traces.give(), frame.columns);

  std::vector<const std::vector<std::uint8_t>*> streams;
  for (std::size_t plane = 0; plane < heads.size(); ++plane) {
    streams.push_back(&coder[plane].finish());
    heads[plane].bytes = streams.back()->size();
    write_head(out, frame, heads[plane], plane);
  }
  for (const auto* stream : streams) out.insert(out.end(), stream->begin(), stream->end());
  return out;
}

std::vector<PlaneImage> decode(PlaneMemory& memory, ByteReader& reader, const PlaneFrame& frame) {
  if (reader.number(1) != kFollowing) throw Error(ErrorCode::Section, "planes that do not follow others");
  const bool after = memory.begin(frame);
  const std::vector<ColumnRun> runs = read_runs(reader, frame.columns, after ? memory.columns() : 0);
  const std::vector<MovedPlane> moved = take_view(reader, memory, frame, runs);
  const std::vector<PlaneHead> heads = read_heads(reader, frame);
  FrameCoder<WideDecoder, kFollows> coder(frame.columns);
  for (std::size_t plane = 0; plane < heads.size(); ++plane) {
    const Bytes stream = reader.take(heads[plane].bytes);
    coder.add(heads[plane], memory.models(plane), WideDecoder(stream.data(), stream.size()));
  }
  if (reader.left() != 0) throw Error(ErrorCode::Section, "bytes after the end of planes", reader.at());

  const Alignment alignment(frame);
  FrameTraces traces(frame, heads, memory, runs, moved);
  std::vector<PlaneImage> images(heads.size(), PlaneImage(frame.rows * frame.columns));
  PlaneNumbers numbers(frame.columns * heads.size());
  std::vector<std::int32_t*> row_of;
  for (std::size_t plane = 0; plane < heads.size(); ++plane) row_of.push_back(numbers.data() + plane * frame.columns);
  code_rows(
      coder, traces, frame, [&](std::size_t) { return row_of; },
      [&](std::size_t row, const std::vector<std::int32_t*>& values) {
        for (std::size_t plane = 0; plane < heads.size(); ++plane) {
          const PlaneValues of(frame, heads[plane]);
          alignment.for_row(row,
                            [&](std::size_t x, std::size_t cell) { images[plane][cell] = of.value(values[plane][x]); });
        }
      });
  for (std::size_t plane = 0; plane < heads.size(); ++plane)
    if (heads[plane].plan.way != PlaneWay::Constant) coder[plane].finish();
  memory.keep(traces.give(), frame.columns);
  return images;
}

// Forgets everything unless the frame was coded as a whole.
template <class Act>
auto whole_or_nothing(PlaneMemory& memory, const Act& act) {
  try {
    return act();
  } catch (...) {
    memory.forget();
    throw;
  }
}

bool same(const PlaneForm& a, const PlaneForm& b) {
  return a.role == b.role && a.bits == b.bits && a.of == b.of && a.like == b.like;
}

}  // namespace

bool PlaneMemory::begin(const PlaneFrame& frame) {
  const bool goes_on = !models_.empty() && rows_ == frame.rows &&
                       std::equal(forms_.begin(), forms_.end(), frame.planes.begin(), frame.planes.end(), same);
  if (!goes_on) {
    forget();
    rows_ = frame.rows;
    forms_ = frame.planes;
    for (std::size_t plane = 0; plane < forms_.size(); ++plane) models_.push_back(std::make_unique<Models>());
  }
  return goes_on && columns_ > 0;
}

std::vector<std::uint8_t> encode_next_planes(PlaneMemory& memory, const PlaneFrame& frame,
                                             const std::vector<PlaneImage>& images, const std::vector<ColumnRun>& runs,
                                             const SensorView& view) {
  return whole_or_nothing(memory, [&] {
    check_frame(frame);
    return encode(memory, frame, images, runs, view);
  });
}

std::vector<PlaneImage> decode_next_planes(PlaneMemory& memory, const std::uint8_t* data, std::size_t size,
                                           const PlaneFrame& frame) {
  return whole_or_nothing(memory, [&] {
    check_frame(frame);
    ByteReader reader({data, size}, "planes");
    return decode(memory, reader, frame);
  });
}

}  // namespace lidarcodec
