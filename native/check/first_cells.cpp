// Learns what the cells of two neighbours begin with (native/src/images/first_cells.hpp). tools/plane_cells.py builds
// and runs this. Usage: first_cells FRAMES < planes > cells
//
// In: for each frame rows, columns, planes, as u32; role, bits, of, like of each plane, as u8; a shift for each row, as
// i32; all images, as u32. Out: an i8 for each node of each context, 16 nodes a context, in steps of 256.
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "images/frame_coder.hpp"

using namespace lidarcodec;

namespace {

constexpr PlaneEffort kEffort = PlaneEffort::Best;
constexpr std::size_t kBeside = 1;  // the context of numbers that is learned
constexpr int kTurns = 2, kShare = 8;
constexpr std::int16_t kStep = 256;
using Learned = std::array<std::int16_t, kBesideContexts * 16>;

template <class T>
void read(std::vector<T>& into) {
  if (std::fread(into.data(), sizeof(T), into.size(), stdin) != into.size()) std::exit(1);
}

struct Given {
  PlaneFrame frame;
  std::vector<PlaneImage> images;
};

Given read_frame() {
  std::vector<std::uint32_t> sizes(3);
  read(sizes);
  Given given;
  given.frame.rows = sizes[0];
  given.frame.columns = sizes[1];
  given.frame.shift.resize(sizes[0]);
  std::vector<std::uint8_t> forms(4 * sizes[2]);
  read(forms);
  for (std::size_t i = 0; i < sizes[2]; ++i)
    given.frame.planes.push_back(
        {static_cast<PlaneRole>(forms[4 * i]), forms[4 * i + 1], forms[4 * i + 2], forms[4 * i + 3]});
  read(given.frame.shift);
  for (std::size_t i = 0; i < sizes[2]; ++i) read(given.images.emplace_back(std::size_t{sizes[0]} * sizes[1]));
  return given;
}

// Moves what is learned towards the cells as a frame leaves them that began with it.
void learn(Learned& learned, const Given& given) {
  std::vector<PlaneNumbers> all = numbers_of_all(given.frame, given.images);
  const std::vector<PlaneHead> heads = choose_heads(given.frame, all, false);
  std::vector<PlaneModels<kEffort>> models(heads.size());
  FrameCoder<WideEncoder, kEffort> coder(given.frame.columns);
  const auto cells_of = [&](std::size_t plane) { return models[plane].cells.data() + models[plane].begin[kBeside]; };
  const auto is_numbers = [&](std::size_t plane) { return heads[plane].plan.way == PlaneWay::Numbers; };
  for (std::size_t plane = 0; plane < heads.size(); ++plane) {
    coder.add(heads[plane], models[plane], WideEncoder());
    for (std::size_t i = 0; is_numbers(plane) && i < learned.size(); i += 8)
      cells_of(plane)[i / 8] = Cells::load(learned.data() + i);
  }
  std::vector<std::int32_t*> values(heads.size());
  for (std::size_t row = 0; row < given.frame.rows; ++row) {
    for (std::size_t plane = 0; plane < heads.size(); ++plane)
      values[plane] = all[plane].data() + row * given.frame.columns;
    coder.code_row(row, values);
  }
  for (std::size_t plane = 0; plane < heads.size(); ++plane) {
    if (!is_numbers(plane) || given.frame.planes[plane].like != plane) continue;
    for (std::size_t i = 0; i < learned.size(); i += 8) {
      std::array<std::int16_t, 8> now;
      cells_of(plane)[i / 8].store(now.data());
      for (std::size_t lane = 0; lane < 8; ++lane)
        learned[i + lane] = static_cast<std::int16_t>(learned[i + lane] + (now[lane] - learned[i + lane]) / kShare);
    }
  }
}

}  // namespace

int main(int count, char** arguments) {
  std::vector<Given> frames;
  for (int i = count > 1 ? std::atoi(arguments[1]) : 0; i > 0; --i) frames.push_back(read_frame());
  Learned learned{};
  for (int turn = 0; turn < kTurns; ++turn)
    for (const Given& given : frames) learn(learned, given);
  for (const std::int16_t cell : learned) {
    const auto rounded = static_cast<std::int8_t>(std::clamp((cell + kStep / 2) >> 8, -127, 127));
    std::fwrite(&rounded, 1, 1, stdout);
  }
}
