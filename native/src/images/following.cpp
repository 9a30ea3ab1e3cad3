#include "images/following.hpp"

#include <algorithm>

#include "base/bytes.hpp"
#include "base/error.hpp"
#include "images/coder.hpp"
#include "images/frame_coder.hpp"
#include "images/traces.hpp"

namespace lidarcodec {
namespace {

constexpr auto kFollows = PlaneEffort::Follows;
constexpr std::uint8_t kFollowing = 3;  // the first byte

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

std::vector<std::uint8_t> encode(PlaneMemory& memory, const PlaneFrame& frame, const std::vector<PlaneImage>& images,
                                 const std::vector<ColumnRun>& given) {
  std::vector<PlaneNumbers> all = numbers_of_all(frame, images);
  std::vector<PlaneHead> heads = choose_heads(frame, all, false);
  std::vector<ColumnRun> runs;
  if (memory.begin(frame)) runs = given;
  if (!runs.empty() && !runs_fit(runs, frame.columns, memory.columns()))
    throw Error(ErrorCode::Settings, "runs of columns that do not fit the frame, or the one before");

  FrameCoder<WideEncoder, kFollows> coder(frame.columns);
  for (std::size_t plane = 0; plane < heads.size(); ++plane)
    coder.add(heads[plane], memory.models(plane), WideEncoder());
  FrameTraces traces(frame, heads, memory, runs);
  code_rows(
      coder, traces, frame,
      [&](std::size_t row) {
        std::vector<std::int32_t*> values;
        for (PlaneNumbers& numbers : all) values.push_back(numbers.data() + row * frame.columns);
        return values;
      },
      [](std::size_t, const std::vector<std::int32_t*>&) {});
  memory.keep(traces.give(), frame.columns);

  std::vector<std::uint8_t> out = {kFollowing};
  put_number(out, runs.size());
  for (const ColumnRun& run : runs) {
    put_number(out, run.count);
    put_number(out, run.first);
  }
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
  const std::vector<PlaneHead> heads = read_heads(reader, frame);
  FrameCoder<WideDecoder, kFollows> coder(frame.columns);
  for (std::size_t plane = 0; plane < heads.size(); ++plane) {
    const Bytes stream = reader.take(heads[plane].bytes);
    coder.add(heads[plane], memory.models(plane), WideDecoder(stream.data(), stream.size()));
  }
  if (reader.left() != 0) throw Error(ErrorCode::Section, "bytes after the end of planes", reader.at());

  const Alignment alignment(frame);
  FrameTraces traces(frame, heads, memory, runs);
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
                                             const std::vector<PlaneImage>& images,
                                             const std::vector<ColumnRun>& runs) {
  return whole_or_nothing(memory, [&] {
    check_frame(frame);
    return encode(memory, frame, images, runs);
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
