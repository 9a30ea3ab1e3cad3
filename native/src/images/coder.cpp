#include "images/coder.hpp"

#include <algorithm>
#include <functional>
#include <memory>
#include <numeric>
#include <utility>

#include "base/bytes.hpp"
#include "base/error.hpp"
#include "images/plane_coder.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kNone = 255;  // the mate of a plane that has none

using Numbers = std::vector<std::int32_t>;

constexpr std::uint8_t kBest = 1, kQuick = 2;  // the first byte

// How one plane is coded, as its head says.
struct PlaneHead {
  PlanePlan plan;
  std::uint32_t unit = 1;  // of an attribute: all values are multiples of it
  std::size_t mate = kNone;
  std::size_t bytes = 0;  // of its stream
};

std::int32_t most_number(const PlaneFrame& frame, std::size_t plane, std::uint32_t unit) {
  const PlaneForm& form = frame.planes[plane];
  return static_cast<std::int32_t>(form.role == PlaneRole::Attribute ? ((1u << form.bits) - 1) / unit
                                                                     : RangeSteps(frame.step, form.bits).most());
}

// Numbers of heads, seven bits a byte, the lowest first; the upper bit says that more follow.
void put_number(std::vector<std::uint8_t>& out, std::size_t value) {
  for (; value >= 128; value >>= 7) out.push_back(static_cast<std::uint8_t>(value | 128u));
  out.push_back(static_cast<std::uint8_t>(value));
}

std::uint32_t take_number(ByteReader& reader) {
  std::uint64_t value = 0;
  for (unsigned shift = 0; shift < 35; shift += 7) {
    const std::uint64_t byte = reader.number(1);
    value |= (byte & 127u) << shift;
    if (byte < 128 && value >> 32 == 0 && (byte != 0 || shift == 0)) return static_cast<std::uint32_t>(value);
    if (byte < 128) break;
  }
  throw Error(ErrorCode::Section, "a number in the head of planes is too large, or longer than it needs to be",
              reader.at());
}

bool may_be_mates(const PlaneFrame& frame, std::size_t earlier, std::size_t plane) {
  return frame.planes[earlier].role == PlaneRole::Attribute && frame.planes[earlier].of == frame.planes[plane].of;
}

// Column of the image of each column of the aligned row: neighbouring rows look in one direction then.
class Alignment {
 public:
  explicit Alignment(const PlaneFrame& frame) : columns_(frame.columns), first_(frame.rows) {
    if (columns_ == 0) return;
    const auto columns = static_cast<std::int64_t>(columns_);
    for (std::size_t row = 0; row < frame.rows; ++row)
      first_[row] = static_cast<std::size_t>((-std::int64_t{frame.shift[row]} % columns + columns) % columns);
  }
  // Calls act(column of the aligned row, cell of the image).
  template <class Act>
  void for_row(std::size_t row, const Act& act) const {
    const std::size_t first = first_[row], rest = columns_ - first;
    for (std::size_t x = 0; x < rest; ++x) act(x, row * columns_ + first + x);
    for (std::size_t x = rest; x < columns_; ++x) act(x, row * columns_ + x - rest);
  }

 private:
  std::size_t columns_;
  std::vector<std::size_t> first_;
};

// The planes of a frame, row by row, each by its coder.
template <class Coder, bool Quick>
class FrameCoder {
 public:
  explicit FrameCoder(std::size_t columns) : columns_(columns) {}

  void add(const PlaneHead& head, Coder coder) {
    heads_.push_back(head);
    coders_.push_back(std::make_unique<PlaneCoder<Coder, Quick>>(head.plan, columns_, std::move(coder)));
  }
  // values: of each plane, the row's.
  void code_row(std::size_t row, const std::vector<std::int32_t*>& values) {
    for (std::size_t plane = 0; plane < heads_.size(); ++plane) {
      const PlaneForm& form = heads_[plane].plan.form;
      OtherPlanes others;
      others.range = &coders_[form.of]->rows();
      if (form.like != plane) others.like = &coders_[form.like]->rows();
      if (heads_[plane].mate != kNone) others.mate = &coders_[heads_[plane].mate]->rows();
      coders_[plane]->begin_row(row, values[plane], others);
    }
    // Each plane is one cell behind the one before: their streams wait for each other as little as can be.
    for (std::size_t step = 0; step < columns_ + heads_.size(); ++step)
      for (std::size_t plane = 0; plane < heads_.size(); ++plane)
        if (step - plane < columns_) coders_[plane]->code(static_cast<std::ptrdiff_t>(step - plane));
  }
  PlaneCoder<Coder, Quick>& operator[](std::size_t plane) { return *coders_[plane]; }

 private:
  std::size_t columns_;
  std::vector<PlaneHead> heads_;
  std::vector<std::unique_ptr<PlaneCoder<Coder, Quick>>> coders_;
};

// The numbers of a plane in rows that are aligned.
Numbers numbers_of(const PlaneImage& image, const PlaneFrame& frame, std::size_t plane, const Alignment& alignment) {
  const PlaneForm& form = frame.planes[plane];
  const std::uint32_t most = (1u << form.bits) - 1;
  if (std::any_of(image.begin(), image.end(), [&](std::uint32_t value) { return value > most; }))
    throw Error(ErrorCode::Settings, "a plane has a value of more bits than it says");
  const RangeSteps steps(frame.step, form.bits);
  Numbers numbers(image.size());
  for (std::size_t row = 0; row < frame.rows; ++row) {
    std::int32_t* const to = numbers.data() + row * frame.columns;
    alignment.for_row(row, [&](std::size_t x, std::size_t cell) {
      const std::uint32_t value = image[cell];
      to[x] = static_cast<std::int32_t>(form.role == PlaneRole::Attribute ? value : steps.number(value));
    });
  }
  return numbers;
}

// The earlier attribute that a plane is best in proportion to, or kNone.
std::size_t mate_of(const PlaneFrame& frame, const std::vector<Numbers>& all, const std::vector<PlaneHead>& before,
                    std::size_t plane) {
  const Numbers& own = all[plane];
  std::size_t best = kNone;
  std::int64_t least = 0;
  for (std::size_t other = 0; other < plane; ++other) {
    if (!may_be_mates(frame, other, plane) || before[other].plan.way == PlaneWay::Constant) continue;
    std::int64_t alone = 0, together = 0;
    for (std::size_t i = 1; i < own.size(); i += 7) {
      const std::int64_t value = own[i], last = own[i - 1], mate = all[other][i], mate_before = all[other][i - 1];
      if (mate_before < 4 || mate < 4) continue;
      alone += std::abs(value - last);
      together += std::abs(value - last * mate / mate_before);
    }
    const std::int64_t gain = alone * 3 / 4 - together;
    if (gain > least) {
      least = gain;
      best = other;
    }
  }
  return best;
}

// The most frequent value of a plane, if it is that of 15 cells of 16, else -1.
std::int32_t usual_value(const Numbers& values) {
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
bool repeats(const Numbers& values, const Numbers& ranges, std::size_t of) {
  std::array<std::int32_t, 2> last = {-1, -1};
  std::size_t same = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    std::int32_t& before = last[ranges[i] > 0];
    same += before == values[i];
    before = values[i];
  }
  return same >= values.size() / of;
}

// The greatest number that divides all values of a plane, and of those that are like it. all: divided by it.
std::vector<std::uint32_t> take_units(const PlaneFrame& frame, std::vector<Numbers>& all) {
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

PlaneHead head_of(const PlaneFrame& frame, const std::vector<Numbers>& all, const std::vector<PlaneHead>& before,
                  std::uint32_t unit, bool quick) {
  const std::size_t plane = before.size();
  const Numbers& numbers = all[plane];
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
  if (head.mate == kNone && head.plan.most < 256 && repeats(numbers, all[head.plan.form.of], quick ? 4 : 8))
    head.plan.way = PlaneWay::Symbols;
  return head;
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
    if (head.mate != kNone && (head.mate >= plane || !may_be_mates(frame, head.mate, plane)))
      refuse("a plane in proportion to one that does not fit");
  }
  head.bytes = take_number(reader);
  return head;
}

// The bytes of numbers in rows that are aligned; heads get the sizes of streams.
template <bool Quick>
std::vector<std::uint8_t> encode(const PlaneFrame& frame, std::vector<Numbers>& all, std::vector<PlaneHead>& heads) {
  FrameCoder<WideEncoder, Quick> coder(frame.columns);
  for (const PlaneHead& head : heads) coder.add(head, WideEncoder());
  std::vector<std::int32_t*> values(all.size());
  for (std::size_t row = 0; row < frame.rows; ++row) {
    for (std::size_t plane = 0; plane < all.size(); ++plane) values[plane] = all[plane].data() + row * frame.columns;
    coder.code_row(row, values);
  }

  std::vector<const std::vector<std::uint8_t>*> streams;
  std::vector<std::uint8_t> out = {Quick ? kQuick : kBest};
  for (std::size_t plane = 0; plane < all.size(); ++plane) {
    streams.push_back(&coder[plane].finish());
    heads[plane].bytes = streams.back()->size();
    write_head(out, frame, heads[plane], plane);
  }
  for (const auto* stream : streams) out.insert(out.end(), stream->begin(), stream->end());
  return out;
}

// The images of heads that were read; their streams follow. Raises Section or Truncated.
template <bool Quick>
std::vector<PlaneImage> decode(ByteReader& reader, const PlaneFrame& frame, const std::vector<PlaneHead>& heads) {
  FrameCoder<WideDecoder, Quick> coder(frame.columns);
  for (const PlaneHead& head : heads) {
    const Bytes stream = reader.take(head.bytes);
    coder.add(head, WideDecoder(stream.data(), stream.size()));
  }
  if (reader.left() != 0) throw Error(ErrorCode::Section, "bytes after the end of planes", reader.at());

  const Alignment alignment(frame);
  std::vector<PlaneImage> images(heads.size(), PlaneImage(frame.rows * frame.columns));
  Numbers row_of(frame.columns * heads.size());
  std::vector<std::int32_t*> values;
  for (std::size_t plane = 0; plane < heads.size(); ++plane) values.push_back(row_of.data() + plane * frame.columns);
  for (std::size_t row = 0; row < frame.rows; ++row) {
    coder.code_row(row, values);
    for (std::size_t plane = 0; plane < heads.size(); ++plane) {
      const PlaneForm& form = frame.planes[plane];
      const RangeSteps steps(frame.step, form.bits);
      alignment.for_row(row, [&](std::size_t x, std::size_t cell) {
        const auto number = static_cast<std::uint32_t>(values[plane][x]);
        images[plane][cell] = form.role == PlaneRole::Attribute ? number * heads[plane].unit : steps.range(number);
      });
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
  const std::size_t cells = frame.rows * frame.columns;
  if (images.size() != frame.planes.size()) throw Error(ErrorCode::Settings, "a frame has one image for each plane");
  const Alignment alignment(frame);
  std::vector<Numbers> all;
  for (std::size_t plane = 0; plane < images.size(); ++plane) {
    if (images[plane].size() != cells) throw Error(ErrorCode::Settings, "the images of planes have H times W cells");
    all.push_back(numbers_of(images[plane], frame, plane, alignment));
  }
  const std::vector<std::uint32_t> units = take_units(frame, all);
  std::vector<PlaneHead> heads;
  for (std::size_t plane = 0; plane < all.size(); ++plane)
    heads.push_back(head_of(frame, all, heads, units[plane], quick));
  return quick ? encode<true>(frame, all, heads) : encode<false>(frame, all, heads);
}

std::vector<PlaneImage> decode_planes(const std::uint8_t* data, std::size_t size, const PlaneFrame& frame) {
  check_frame(frame);
  ByteReader reader({data, size}, "planes");
  const std::uint64_t kind = reader.number(1);
  if (kind != kBest && kind != kQuick) throw Error(ErrorCode::Section, "planes of an unknown kind");
  std::vector<PlaneHead> heads;
  while (heads.size() < frame.planes.size()) heads.push_back(read_head(reader, frame, heads));
  return kind == kQuick ? decode<true>(reader, frame, heads) : decode<false>(reader, frame, heads);
}

}  // namespace lidarcodec
