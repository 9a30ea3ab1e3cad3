// Any bytes as the planes of a frame, any planes there and back, and frames that follow each other. The input's first
// bytes say sizes, forms and step.
#include <algorithm>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "images/coder.hpp"
#include "images/following.hpp"
#include "parts/fuzz_input.hpp"

using lidarcodec::ColumnRun;
using lidarcodec::PlaneFrame;
using lidarcodec::PlaneImage;
using lidarcodec::PlaneMemory;
using lidarcodec::PlaneRole;
using lidarcodec::RangeSteps;

namespace {

// Images as they come back.
std::vector<PlaneImage> rounded(std::vector<PlaneImage> images, const PlaneFrame& frame) {
  for (std::size_t i = 0; i < images.size(); ++i) {
    const RangeSteps steps(frame.step, frame.planes[i].bits);
    if (frame.planes[i].role == PlaneRole::Attribute) continue;
    for (std::uint32_t& value : images[i]) value = steps.range(steps.number(value));
  }
  return images;
}

void check_round_trip(const std::vector<PlaneImage>& images, const PlaneFrame& frame, bool fast) {
  const std::vector<std::uint8_t> data = lidarcodec::encode_planes(frame, images, fast);
  if (lidarcodec::decode_planes(data.data(), data.size(), frame) != rounded(images, frame)) std::abort();
}

// A range plane, and up to seven others of any kind.
PlaneFrame frame_of(FuzzInput& input) {
  PlaneFrame frame;
  frame.rows = input.below(9);
  frame.columns = input.below(25);
  frame.step = 2 * input.below(64) + 1;
  const std::uint8_t turned = input.byte(), planes = input.byte() % 8;
  for (std::size_t row = 0; row < frame.rows; ++row)
    frame.shift.push_back(static_cast<std::int32_t>(turned * static_cast<std::uint32_t>(row) * 40503001u));
  for (std::size_t i = 0; i <= planes; ++i) {
    const std::uint8_t kind = input.byte(), bits = input.byte();
    const auto role = i == 0 ? PlaneRole::Range : static_cast<PlaneRole>(kind % 3);
    frame.planes.push_back({role, 1u + bits % 20u, i, i});
    if (role == PlaneRole::Attribute) frame.planes[i].of = kind / 8 % i;
    if (role != PlaneRole::Range && (kind & 4u) != 0) frame.planes[i].like = kind / 16 % i;
    const std::size_t like = frame.planes[i].like;
    if (like != i) frame.planes[i].bits = frame.planes[like].bits;
  }
  return frame;
}

// One image for each plane. kind: how wide the numbers are, and whether planes repeat others.
std::vector<PlaneImage> images_of(const PlaneFrame& frame, Numbers& numbers, std::uint8_t kind) {
  std::vector<PlaneImage> images;
  for (const lidarcodec::PlaneForm& form : frame.planes) {
    PlaneImage image(frame.rows * frame.columns);
    for (std::uint32_t& value : image) value = numbers.next(1u + kind / 2 % 3) & ((1u << form.bits) - 1);
    if ((kind & 8u) != 0 && !images.empty())
      for (std::size_t i = 0; i < image.size(); i += 3)
        image[i] = images[form.like % images.size()][i] & ((1u << form.bits) - 1);
    images.push_back(std::move(image));
  }
  return images;
}

// Runs of all columns of a frame, or none.
std::vector<ColumnRun> runs_of(Numbers& numbers, std::size_t columns, std::size_t before) {
  std::vector<ColumnRun> runs;
  if (before == 0 || numbers.next(1) % 4 == 0) return runs;
  for (std::size_t left = columns; left > 0;) {
    const std::size_t count = 1 + numbers.next(1) % left;
    runs.push_back({count, numbers.next(2) % before});
    left -= count;
  }
  return runs;
}

// A sensor that looks a turn around.
lidarcodec::SensorView view_of(const PlaneFrame& frame) {
  lidarcodec::SensorView view;
  for (std::size_t row = 0; row < frame.rows; ++row) {
    view.beams.up.push_back(40'000 - 9'000 * static_cast<std::int32_t>(row));
    view.beams.aside.push_back(3'000 * static_cast<std::int32_t>(row % 3));
  }
  for (std::size_t x = 0; x < frame.columns; ++x)
    view.azimuth.push_back(static_cast<std::uint16_t>(x * 36'000 / frame.columns));
  view.metre = 100;
  return view;
}

void decode_any(PlaneMemory& memory, const std::vector<std::uint8_t>& data, const PlaneFrame& frame) {
  try {
    for (const PlaneImage& image : lidarcodec::decode_next_planes(memory, data.data(), data.size(), frame))
      if (image.size() != frame.rows * frame.columns) std::abort();
  } catch (const lidarcodec::Error&) {
    if (!memory.empty()) std::abort();
  }
}

// Frames that follow each other. rest: what their numbers are made of.
void check_stream(PlaneFrame frame, const std::vector<std::uint8_t>& rest, std::uint8_t kind) {
  Numbers numbers(rest);
  PlaneMemory there, back;
  for (int number = 0; number < 4; ++number) {
    if ((kind & 16u) != 0 && number > 0) {  // any bytes after a frame
      decode_any(back, rest, frame);
      return;
    }
    const std::vector<PlaneImage> images = images_of(frame, numbers, kind);
    const std::vector<ColumnRun> runs = runs_of(numbers, frame.columns, there.columns());
    std::vector<std::uint8_t> coded = lidarcodec::encode_next_planes(there, frame, images, runs, view_of(frame));
    if ((kind & 32u) != 0 && number > 0) {  // a frame with a byte changed
      coded[numbers.next(2) % coded.size()] ^= static_cast<std::uint8_t>(1u + numbers.next(1));
      if ((kind & 128u) != 0) coded.resize(numbers.next(2) % (coded.size() + 1));
      decode_any(back, coded, frame);
      return;
    }
    if (lidarcodec::decode_next_planes(back, coded.data(), coded.size(), frame) != rounded(images, frame)) std::abort();
    if ((kind & 4u) != 0) frame.columns = numbers.next(1) % 25;
    if (numbers.next(1) % 16 == 0) frame.step = 2 * (numbers.next(1) % 64) + 1;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::uint8_t kind = input.byte();
  const PlaneFrame frame = frame_of(input);
  const std::vector<std::uint8_t> rest = input.rest();
  try {
    check_round_trip(lidarcodec::decode_planes(rest.data(), rest.size(), frame), frame, (kind & 1u) != 0);
  } catch (const lidarcodec::Error&) {
  }
  try {
    lidarcodec::check_frame(frame);
  } catch (const lidarcodec::Error&) {
    return 0;
  }
  if ((kind & 64u) != 0) {
    check_stream(frame, rest, kind);
    return 0;
  }
  Numbers numbers(rest);
  const std::vector<PlaneImage> images = images_of(frame, numbers, kind);
  // Planes as they are, or an encoded frame with a byte changed.
  if ((kind & 16u) == 0) {
    check_round_trip(images, frame, (kind & 1u) != 0);
    return 0;
  }
  std::vector<std::uint8_t> damaged = lidarcodec::encode_planes(frame, images, (kind & 1u) != 0);
  damaged[numbers.next(2) % damaged.size()] ^= static_cast<std::uint8_t>(1u + numbers.next(1));
  if ((kind & 32u) != 0) damaged.resize(numbers.next(2) % (damaged.size() + 1));
  try {
    for (const PlaneImage& image : lidarcodec::decode_planes(damaged.data(), damaged.size(), frame))
      if (image.size() != frame.rows * frame.columns) std::abort();
  } catch (const lidarcodec::Error&) {
  }
  return 0;
}
