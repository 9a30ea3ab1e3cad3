#include "images/coder.hpp"

#include "base/bytes.hpp"
#include "base/error.hpp"
#include "images/frame_coder.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint8_t kBest = 1, kQuick = 2;  // the first byte

// The bytes of numbers in rows that are aligned; heads get the sizes of streams.
template <PlaneEffort Effort>
std::vector<std::uint8_t> encode(const PlaneFrame& frame, std::vector<PlaneNumbers>& all,
                                 std::vector<PlaneHead>& heads) {
  std::vector<PlaneModels<Effort>> models(heads.size());
  FrameCoder<WideEncoder, Effort> coder(frame.columns);
  for (std::size_t plane = 0; plane < heads.size(); ++plane) coder.add(heads[plane], models[plane], WideEncoder());
  std::vector<std::int32_t*> values(all.size());
  for (std::size_t row = 0; row < frame.rows; ++row) {
    for (std::size_t plane = 0; plane < all.size(); ++plane) values[plane] = all[plane].data() + row * frame.columns;
    coder.code_row(row, values);
  }

  std::vector<const std::vector<std::uint8_t>*> streams;
  std::vector<std::uint8_t> out = {Effort == PlaneEffort::Quick ? kQuick : kBest};
  for (std::size_t plane = 0; plane < all.size(); ++plane) {
    streams.push_back(&coder[plane].finish());
    heads[plane].bytes = streams.back()->size();
    write_head(out, frame, heads[plane], plane);
  }
  for (const auto* stream : streams) out.insert(out.end(), stream->begin(), stream->end());
  return out;
}

// The images of heads that were read; their streams follow. Raises Section or Truncated.
template <PlaneEffort Effort>
std::vector<PlaneImage> decode(ByteReader& reader, const PlaneFrame& frame, const std::vector<PlaneHead>& heads) {
  std::vector<PlaneModels<Effort>> models(heads.size());
  FrameCoder<WideDecoder, Effort> coder(frame.columns);
  for (std::size_t plane = 0; plane < heads.size(); ++plane) {
    const Bytes stream = reader.take(heads[plane].bytes);
    coder.add(heads[plane], models[plane], WideDecoder(stream.data(), stream.size()));
  }
  if (reader.left() != 0) throw Error(ErrorCode::Section, "bytes after the end of planes", reader.at());

  const Alignment alignment(frame);
  std::vector<PlaneImage> images(heads.size(), PlaneImage(frame.rows * frame.columns));
  PlaneNumbers row_of(frame.columns * heads.size());
  std::vector<std::int32_t*> values;
  for (std::size_t plane = 0; plane < heads.size(); ++plane) values.push_back(row_of.data() + plane * frame.columns);
  for (std::size_t row = 0; row < frame.rows; ++row) {
    coder.code_row(row, values);
    for (std::size_t plane = 0; plane < heads.size(); ++plane) {
      const PlaneValues of(frame, heads[plane]);
      alignment.for_row(row,
                        [&](std::size_t x, std::size_t cell) { images[plane][cell] = of.value(values[plane][x]); });
    }
  }
  for (std::size_t plane = 0; plane < heads.size(); ++plane)
    if (heads[plane].plan.way != PlaneWay::Constant) coder[plane].finish();
  return images;
}

}  // namespace

void check_frame(const PlaneFrame& frame) {
  const auto refuse = [](const char* why) { throw Error(ErrorCode::Settings, why); };
  if (frame.rows > kMostPlaneRows || frame.columns > kMostPlaneColumns || frame.rows * frame.columns > kMostPlaneCells)
    refuse("planes have at most 1024 rows, 65536 columns and 2^24 cells");
  if (frame.shift.size() != frame.rows) refuse("planes have one shift for each row");
  if (frame.planes.empty() || frame.planes.size() > kMostPlanes) refuse("a frame has 1 to 32 planes");
  if (frame.step % 2 == 0 || frame.step > kMostRangeStep) refuse("a step of ranges is odd, 1 to 65535");
  for (std::size_t i = 0; i < frame.planes.size(); ++i) {
    const PlaneForm& form = frame.planes[i];
    if (form.bits < 1 || form.bits > kMostPlaneBits) refuse("planes have 1 to 20 bits");
    if (form.of > i || form.like > i) refuse("a plane describes, or is like, an earlier one");
    const bool attribute = form.role == PlaneRole::Attribute;
    if (attribute ? frame.planes[form.of].role == PlaneRole::Attribute : form.of != i)
      refuse("an attribute describes a range plane, and a range plane itself");
    if (form.role == PlaneRole::Range && form.like != i) refuse("only second ranges and attributes are like others");
    const PlaneForm& like = frame.planes[form.like];
    if ((like.role == PlaneRole::Attribute) != attribute || like.bits != form.bits)
      refuse("planes that are like each other are of one kind and have as many bits");
  }
}

std::vector<std::uint8_t> encode_planes(const PlaneFrame& frame, const std::vector<PlaneImage>& images, bool quick) {
  check_frame(frame);
  std::vector<PlaneNumbers> all = numbers_of_all(frame, images);
  std::vector<PlaneHead> heads = choose_heads(frame, all, quick);
  return quick ? encode<PlaneEffort::Quick>(frame, all, heads) : encode<PlaneEffort::Best>(frame, all, heads);
}

std::vector<PlaneImage> decode_planes(const std::uint8_t* data, std::size_t size, const PlaneFrame& frame) {
  check_frame(frame);
  ByteReader reader({data, size}, "planes");
  const std::uint64_t kind = reader.number(1);
  if (kind != kBest && kind != kQuick) throw Error(ErrorCode::Section, "planes of an unknown kind");
  const std::vector<PlaneHead> heads = read_heads(reader, frame);
  return kind == kQuick ? decode<PlaneEffort::Quick>(reader, frame, heads)
                        : decode<PlaneEffort::Best>(reader, frame, heads);
}

}  // namespace lidarcodec
