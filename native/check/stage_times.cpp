// What each stage of coding the ranges of a frame takes: a program for benchmarks/predictive_stages.py, apart from the
// module so that its loops are not slowed down by being watched. Reads networks and frames from standard input, prints
// a line a stage: way, stage, ticks of the processor's counter a return. First line: ticks a nanosecond.
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <vector>

#if defined(__x86_64__)
#include <x86intrin.h>
#endif

#include "mask/align.hpp"
#include "predictive/avx2.hpp"
#include "predictive/image.hpp"
#include "predictive/stage.hpp"

using namespace lidarcodec;

namespace {

inline std::uint64_t ticks() {
#if defined(__x86_64__)
  return __rdtsc();
#else
  return static_cast<std::uint64_t>(std::chrono::steady_clock::now().time_since_epoch().count());
#endif
}

// Ticks of a stage, and how many times it was timed.
struct Spent {
  std::uint64_t sum = 0, times = 0;
  void add(std::uint64_t took) {
    sum += took;
    ++times;
  }
};

// Where the time of a frame went. A network has no form whose functions could be watched: the inputs of a return are
// found after its contexts and before those of the next one, and the network runs between the last inputs and the first
// sum.
struct Watch {
  Spent contexts, inputs, inputs_and_network, sums, learning;
  std::uint64_t found = 0;    // when the last contexts were
  std::size_t looked_at = 0;  // returns whose contexts were found, and not yet added up
};
Watch watch;

// The functions of a form, with a clock around each.
template <class Forms>
struct Watched : Forms {
  template <bool kExpects>
  static void find(const Known& known, Slots& found) {
    const std::uint64_t begun = ticks();
    if (watch.looked_at++ != 0) watch.inputs.add(begun - watch.found);  // with what it takes to look at the next return
    Forms::template find<kExpects>(known, found);
    watch.found = ticks();
    watch.contexts.add(watch.found - begun);
  }
  template <const auto& kUsed>
  static void add_up(const std::int16_t* cells, const Slots& slots, Probabilities& chances) {
    const std::uint64_t begun = ticks();
    watch.looked_at = 0;
    Forms::template add_up<kUsed>(cells, slots, chances);
    watch.sums.add(ticks() - begun);
  }
  template <const auto& kUsed>
  static void mix(const std::int16_t* cells, const Slots& slots, const std::int16_t* net, const MixingWeights& weights,
                  std::int16_t* context_odds, Probabilities& chances) {
    const std::uint64_t begun = ticks();
    if (watch.looked_at != 0) watch.inputs_and_network.add(begun - watch.found);
    watch.looked_at = 0;
    Forms::template mix<kUsed>(cells, slots, net, weights, context_odds, chances);
    watch.sums.add(ticks() - begun);
  }
  template <const auto& kUsed, bool kNetwork>
  static void learn(std::int16_t* cells, const Slots& slots, const Probabilities& chances, const Walk& walked) {
    const std::uint64_t begun = ticks();
    Forms::template learn<kUsed, kNetwork>(cells, slots, chances, walked);
    watch.learning.add(ticks() - begun);
  }
  static void learn_mixing(MixingWeights& weights, const std::int16_t* net, const std::int16_t* context_odds,
                           const Probabilities& chances, const Walk& walked) {
    const std::uint64_t begun = ticks();
    Forms::learn_mixing(weights, net, context_odds, chances, walked);
    watch.learning.add(ticks() - begun);
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

// A network: of each of its layers inputs, outputs, shift and how many cases have biases u32, weights i16 (out, in),
// biases i32, those of cases i8.
std::optional<RiddleNet> read_net(NetForm form) {
  std::array<GivenLayer, kNetLayers> layers;
  std::array<std::vector<std::int16_t>, kNetLayers> weights;
  std::array<std::vector<std::int32_t>, kNetLayers> biases;
  std::array<std::vector<std::int8_t>, kNetLayers> cases;
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    std::array<std::uint32_t, 4> head;
    if (std::fread(head.data(), sizeof head, 1, stdin) != 1 || head[0] > kMaxHidden || head[1] > kMaxHidden) return {};
    if (!read(weights[l], std::size_t{head[0]} * head[1]) || !read(biases[l], head[1])) return {};
    if ((head[3] != 0 && head[3] != kConditionalBiases) || !read(cases[l], std::size_t{head[3]} * head[1])) return {};
    layers[l] = {head[0],          head[1], weights[l].data(),
                 biases[l].data(), head[2], head[3] == 0 ? nullptr : cases[l].data()};
  }
  return RiddleNet(layers, form);
}

// Ticks a return, an entry a frame.
struct Stages {
  std::vector<double> canvas, contexts, inputs, network, sums, learning, whole;
};

// Codes all rows of an image as `code_rows` of predictive/paths.hpp does, watched.
template <class Forms, bool kExpects, bool kNetwork, class Coder, class Image>
void code_watched(const ImageCoding& on, const RowSource& source, PredictiveParts<Coder>& parts, Image* image,
                  Stages& stages) {
  using Rows = PredictiveRows<Coder, Watched<Forms>, kExpects, kNetwork>;
  const auto step = static_cast<std::int32_t>(source.cells.step);
  watch = {};
  std::uint64_t canvas = 0, last = ticks();
  Rows coder(on.model, on.network, source.cells, (kMaxRange + kMaxLevel) / step + 1, on.quick, parts);
  RowStage<Rows::kReads, kExpects, kNetwork> stage(source, 0, coder.start(), coder.first());
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    const RowTask work = stage.begin(row, image);
    canvas += ticks() - last;
    coder.code(work);
    last = ticks();
    stage.end(image);
  }
  canvas += ticks() - last;
  static const auto own = static_cast<double>(clock_takes());
  const auto n = static_cast<double>(watch.contexts.times);
  const auto taken = [](const Spent& of) { return static_cast<double>(of.sum) - own * static_cast<double>(of.times); };
  const auto put = [&](std::vector<double>& into, double all) { into.push_back(std::max(0.0, all / n)); };
  put(stages.canvas, static_cast<double>(canvas));
  put(stages.contexts, taken(watch.contexts));
  put(stages.sums, taken(watch.sums));
  put(stages.learning, taken(watch.learning));
  if (!kNetwork || watch.inputs.times == 0) return;
  const double inputs = taken(watch.inputs) / static_cast<double>(watch.inputs.times);
  put(stages.inputs, n * inputs);
  put(stages.network, taken(watch.inputs_and_network) - inputs * static_cast<double>(watch.inputs_and_network.times));
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0 : values[values.size() / 2];
}

// Everything that is measured: frames, and with what they are coded.
struct Task {
  Path path;
  int rounds;
  MaskGeometry geometry;
  RangeCells cells;
  std::optional<RiddleNet> alone, expecting;
  std::vector<Frame> frames;
};

template <class Forms, bool kExpects, bool kNetwork>
void measure(const Task& task) {
  Stages writing, reading;
  const std::optional<RiddleNet>& net = kExpects ? task.expecting : task.alone;
  const NetworkUse network{kNetwork ? &*net : nullptr, nullptr};
  MaskGeometry geometry = task.geometry;
  std::vector<PredictiveModel> models(4, PredictiveModel(kNetwork));
  SlabEnds states;
  const auto with = [&](std::size_t model) {
    return ImageCoding{task.path, models[model], network, states, false, !kNetwork};
  };
  for (int round = 0; round < task.rounds; ++round) {
    for (PredictiveModel& model : models) model.reset();
    for (const Frame& frame : task.frames) {
      geometry.width = frame.width;
      geometry.fired = frame.fired.data();
      const MaskLayout layout(geometry);
      const ClosedRows returned(frame.returns.data(), layout, frame.width);
      const std::uint16_t* const expected = kExpects ? frame.expected.data() : nullptr;
      const RowSource source{layout, returned, task.cells, expected, frame.width, 0, kNominalTurn, 0};
      const auto whole = [&](Stages& stages, const auto& work) {  // as the product has it, unwatched
        const std::uint64_t begun = ticks();
        work();
        stages.whole.push_back(static_cast<double>(ticks() - begun) / static_cast<double>(returned.returns));
      };
      PredictiveParts<WideEncoder> written, again;
      whole(writing, [&] { write_image(with(0), source, written, frame.ranges.data()); });
      code_watched<Forms, kExpects, kNetwork>(with(1), source, again, frame.ranges.data(), writing);
      std::array<std::vector<std::uint8_t>, kMostParts> streams;
      for (std::size_t p = 0; p < kMostParts; ++p) streams[p] = written[p].coder.finish(written[p].interval);
      const auto decode = [&](const auto& work) {
        PredictiveParts<WideDecoder> parts;
        for (std::size_t p = 0; p < kMostParts; ++p) {
          parts[p] = PredictivePart<WideDecoder>{WideDecoder(streams[p].data(), streams[p].size())};
          parts[p].interval = parts[p].coder.start();
        }
        std::vector<std::uint16_t> image(frame.ranges.size());
        work(parts, image.data());
        for (auto& part : parts) part.coder.finish(part.interval);
        if (image != frame.ranges) throw Error(ErrorCode::Section, "ranges that do not come back as they were");
      };
      decode([&](auto& parts, std::uint16_t* image) {
        whole(reading, [&] { read_image(with(2), source, parts, image); });
      });
      decode([&](auto& parts, std::uint16_t* image) {
        code_watched<Forms, kExpects, kNetwork>(with(3), source, parts, image, reading);
      });
    }
  }
  for (const auto& [way, stages] : {std::pair<const char*, Stages&>{"encode", writing}, {"decode", reading}}) {
    const std::string name = std::string(way) + (kExpects ? " with motion" : "");
    double rest = median(stages.whole);
    const auto print = [&](const char* stage, double value) {
      std::printf("%s,%s,%.2f\n", name.c_str(), stage, value);
    };
    for (const auto& [stage, values] : {std::pair<const char*, std::vector<double>&>{"canvas", stages.canvas},
                                        {"contexts", stages.contexts},
                                        {"inputs", stages.inputs},
                                        {"network", stages.network},
                                        {"sums", stages.sums},
                                        {"learning", stages.learning}}) {
      if (values.empty()) continue;
      print(stage, median(values));
      rest -= median(values);
    }
    print("coder and offsets", std::max(0.0, rest));
    print("whole", median(stages.whole));
  }
}

template <class Forms>
void measure_with(const Task& task) {
  if (task.alone && task.expecting) {
    measure<Forms, false, true>(task);
    measure<Forms, true, true>(task);
  } else {
    measure<Forms, false, false>(task);
    measure<Forms, true, false>(task);
  }
}

bool read_task(Task& task, NetForm form) {
  std::uint32_t nets = 0, frames = 0;
  if (std::fread(&nets, 4, 1, stdin) != 1 || (nets != 0 && nets != 2)) return false;
  if (nets == 2) {
    task.alone = read_net(form);
    task.expecting = read_net(form);
    if (!task.alone || !task.expecting) return false;
  }
  if (std::fread(&frames, 4, 1, stdin) != 1 || frames > 1000) return false;
  if (std::fread(task.geometry.half.data(), 1, 64, stdin) != 64 ||
      std::fread(task.geometry.rotation.data(), 8, 64, stdin) != 64 ||
      std::fread(task.cells.level.data(), 4, 64, stdin) != 64)
    return false;
  task.frames.resize(frames);
  for (Frame& frame : task.frames) {
    if (std::fread(&frame.width, 4, 1, stdin) != 1 || frame.width > 24576) return false;
    const std::size_t size = std::size_t{64} * frame.width;
    if (!read(frame.ranges, size) || !read(frame.returns, size) || !read(frame.fired, 2 * frame.width) ||
        !read(frame.expected, size))
      return false;
  }
  return true;
}

}  // namespace

// Words: path; form of networks; rounds. Input: networks u32 (0, or 2: of frames alone, and of those that expect
// something), those; frames u32, halves (64,) u8, rotations (64,) i64, levels (64,) i32; a frame:
// width u32, ranges, returns u8, fired u8, expected ranges.
int main(int count, char** words) {
  Task task;
  if (count != 4) return 2;
  task.path = path_named(words[1]);
  task.rounds = std::atoi(words[3]);
  if (!read_task(task, net_form_named(words[2]))) return 2;
  const auto begun = std::chrono::steady_clock::now();
  const std::uint64_t from = ticks();
  while (std::chrono::steady_clock::now() - begun < std::chrono::milliseconds(50)) {
  }
  std::printf("%.3f\n", static_cast<double>(ticks() - from) / 5e7);
  switch (task.path) {
    case Path::Plain:  // is nobody's path
      return 2;
    case Path::Vector:
      measure_with<VectorForms>(task);
      break;
    case Path::Avx2:
#if defined(__x86_64__)
      measure_with<Avx2Forms>(task);
#endif
      break;
  }
}
