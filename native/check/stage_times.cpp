// What each stage of coding the ranges of a frame takes: a program for benchmarks/predictive_stages.py, apart from the
// module so that its loops are not slowed down by being watched. Reads frames from standard input, prints a line a stage:
// way, stage, ticks of the processor's counter a return. First line: ticks a nanosecond.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <vector>

#if defined(__x86_64__)
#include <x86intrin.h>
#endif

#include "mask_align.hpp"
#include "predictive_avx2.hpp"
#include "predictive_stage.hpp"

using namespace lidarcodec;

namespace {

inline std::uint64_t ticks() {
#if defined(__x86_64__)
  return __rdtsc();
#else
  return static_cast<std::uint64_t>(std::chrono::steady_clock::now().time_since_epoch().count());
#endif
}

struct Spent {
  std::uint64_t contexts = 0, sums = 0, learning = 0, calls = 0;
};
Spent spent;

// The functions of a form, with a clock around each.
template <class Forms>
struct Watched {
  template <class Work>
  static void run(const Work& work) {
    Forms::run(work);
  }
  template <bool kExpects>
  static void find(const Known& known, Slots& found) {
    const std::uint64_t begun = ticks();
    Forms::template find<kExpects>(known, found);
    spent.contexts += ticks() - begun;
    ++spent.calls;
  }
  template <bool kExpects, bool kLearned>
  static void add_up(const std::int16_t* cells, const Slots& slots, const std::int16_t* start, Chances& chances) {
    const std::uint64_t begun = ticks();
    Forms::template add_up<kExpects, kLearned>(cells, slots, start, chances);
    spent.sums += ticks() - begun;
  }
  template <bool kExpects, bool kLearned>
  static void learn(std::int16_t* cells, const Slots& slots, const Chances& chances, const Walk& walked) {
    const std::uint64_t begun = ticks();
    Forms::template learn<kExpects, kLearned>(cells, slots, chances, walked);
    spent.learning += ticks() - begun;
  }
};

// What a pair of readings of the clock takes by itself.
std::uint64_t clock_takes() {
  std::uint64_t least = ~std::uint64_t{0};
  for (int i = 0; i < 1000; ++i) {
    const std::uint64_t begun = ticks();
    least = std::min(least, ticks() - begun);
  }
  return least;
}

struct Frame {
  std::uint32_t width = 0;
  std::vector<std::uint16_t> ranges, expected;
  std::vector<std::uint8_t> returns, fired;
};

template <class T>
bool read(std::vector<T>& into, std::size_t count) {
  into.resize(count);
  return std::fread(into.data(), sizeof(T), count, stdin) == count;
}

struct Stages {
  std::vector<double> canvas, contexts, sums, learning, coder, whole;
};

template <class Forms, bool kExpects, class Coder, class Image>
void code(PredictiveModel& model, const RowSource& source, std::array<PredictiveHalf<Coder>, 2>& halves, Image* image,
          Stages& stages) {
  using Rows = PredictiveRows<Coder, Forms, kExpects, false>;
  const auto step = static_cast<std::int32_t>(source.cells.step);
  spent = {};
  std::uint64_t canvas = 0, rows = 0, last = ticks();
  const std::uint64_t begun = last;
  const auto lap = [&](std::uint64_t& of) {
    const std::uint64_t now = ticks();
    of += now - last;
    last = now;
  };
  static const Teaching nobody;
  Rows coder(model, nobody, source.cells.step, 66535 / step + 1, halves);
  RowStage<Rows::kReads, kExpects, false> stage(source, 0, coder.start(), coder.first());
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const RowWork work = stage.begin(row, image);
    lap(canvas);
    coder.code(work);
    lap(rows);
    stage.end(image);
    lap(canvas);
  }
  if (spent.calls == 0) {  // not watched: the sum of all
    stages.whole.push_back(static_cast<double>(ticks() - begun) / static_cast<double>(source.returned.returns));
    return;
  }
  static const std::uint64_t own = clock_takes();
  const auto n = static_cast<double>(spent.calls);
  const auto each = [&](std::uint64_t sum) { return std::max(0.0, static_cast<double>(sum) / n - static_cast<double>(own)); };
  stages.canvas.push_back(static_cast<double>(canvas) / n);
  stages.contexts.push_back(each(spent.contexts));
  stages.sums.push_back(each(spent.sums));
  stages.learning.push_back(each(spent.learning));
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0 : values[values.size() / 2];
}

template <class Forms, bool kExpects>
void measure(const std::vector<Frame>& frames, MaskGeometry geometry, const RangeCells& cells, int rounds) {
  Stages writing, reading;
  std::array<PredictiveModel, 4> models;
  for (int round = 0; round < rounds; ++round) {
    for (PredictiveModel& model : models) model.reset();
    for (const Frame& frame : frames) {
      geometry.width = frame.width;
      geometry.fired = frame.fired.data();
      const MaskLayout layout(geometry);
      const ClosedRows returned(frame.returns.data(), layout, frame.width);
      const std::uint16_t* const expected = kExpects ? frame.expected.data() : nullptr;
      const RowSource source{layout, returned, cells, expected, frame.width, 0, kNominalTurn};
      std::array<PredictiveHalf<WideEncoder>, 2> written, again;
      code<Forms, kExpects>(models[0], source, written, frame.ranges.data(), writing);
      code<Watched<Forms>, kExpects>(models[1], source, again, frame.ranges.data(), writing);
      std::array<std::vector<std::uint8_t>, 2> streams;
      for (std::size_t h = 0; h < 2; ++h) streams[h] = written[h].coder.finish(written[h].interval);
      const auto decode = [&]<class F>(const F&, PredictiveModel& model) {
        std::array<PredictiveHalf<WideDecoder>, 2> halves = {
            PredictiveHalf<WideDecoder>{WideDecoder(streams[0].data(), streams[0].size())},
            PredictiveHalf<WideDecoder>{WideDecoder(streams[1].data(), streams[1].size())}};
        for (auto& half : halves) half.interval = half.coder.start();
        std::vector<std::uint16_t> image(frame.ranges.size());
        code<F, kExpects>(model, source, halves, image.data(), reading);
        for (const auto& half : halves) half.coder.finish(half.interval);
      };
      decode(Forms{}, models[2]);
      decode(Watched<Forms>{}, models[3]);
    }
  }
  for (const auto& [way, stages] : {std::pair<const char*, Stages&>{"encode", writing}, {"decode", reading}}) {
    const std::string name = std::string(way) + (kExpects ? " with motion" : "");
    const double canvas = median(stages.canvas), contexts = median(stages.contexts), sums = median(stages.sums);
    const double learning = median(stages.learning), whole = median(stages.whole);
    const double rest = std::max(0.0, whole - canvas - contexts - sums - learning);
    for (const auto& [stage, value] : {std::pair{"canvas", canvas}, {"contexts", contexts}, {"sums", sums},
                                       {"learning", learning}, {"coder and offsets", rest}, {"whole", whole}})
      std::printf("%s,%s,%.2f\n", name.c_str(), stage, value);
  }
}

}  // namespace

// Input: frames u32, halves (64,) u8, rotations (64,) i64, levels (64,) i32; a frame: width u32, ranges, returns u8, fired
// u8, expected ranges. Words: path, rounds.
int main(int count, char** words) {
  std::uint32_t frames = 0;
  MaskGeometry geometry;
  RangeCells cells;
  if (count != 3 || std::fread(&frames, 4, 1, stdin) != 1 || frames > 1000) return 2;
  if (std::fread(geometry.half.data(), 1, 64, stdin) != 64 || std::fread(geometry.rotation.data(), 8, 64, stdin) != 64 ||
      std::fread(cells.level.data(), 4, 64, stdin) != 64)
    return 2;
  std::vector<Frame> all(frames);
  for (Frame& frame : all) {
    if (std::fread(&frame.width, 4, 1, stdin) != 1 || frame.width > 24576) return 2;
    const std::size_t size = 64 * frame.width;
    if (!read(frame.ranges, size) || !read(frame.returns, size) || !read(frame.fired, 2 * frame.width) || !read(frame.expected, size))
      return 2;
  }
  const auto begun = std::chrono::steady_clock::now();
  const std::uint64_t from = ticks();
  while (std::chrono::steady_clock::now() - begun < std::chrono::milliseconds(50)) {
  }
  std::printf("%.3f\n", static_cast<double>(ticks() - from) / 5e7);
  const auto measure_with = [&]<class Forms>(const Forms&) {
    measure<Forms, false>(all, geometry, cells, std::atoi(words[2]));
    measure<Forms, true>(all, geometry, cells, std::atoi(words[2]));
  };
  switch (path_named(words[1])) {
    case Path::Plain:  // is nobody's path
    case Path::Vector:
      measure_with(VectorForms{});
      break;
    case Path::Avx2:
#if defined(__x86_64__)
      measure_with(Avx2Forms{});
#endif
      break;
  }
}
