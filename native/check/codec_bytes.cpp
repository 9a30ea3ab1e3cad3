// Codes frames made by arithmetic alone, on every path that this processor has, decodes them again, and prints a hash
// of each kind of bytes: `make identity` and a test build this with compilers, optimisations and processors that are at
// hand. Usage: codec_bytes [COLUMNS]
#include <algorithm>
#include <array>
#include <bit>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "mask/coder.hpp"
#include "mask/stream.hpp"
#include "motion/registration.hpp"
#include "motion/warp.hpp"
#include "network/train.hpp"
#include "planes/intensity_choice.hpp"
#include "planes/intensity_coder.hpp"
#include "predictive/coder.hpp"
#include "random_nets.hpp"

using namespace lidarcodec;

namespace {

constexpr std::size_t kFrames = 3;
constexpr std::array<std::uint32_t, 3> kSteps = {1, 11, 51};

using Bytes = std::vector<std::uint8_t>;
using Ranges = std::vector<std::uint16_t>;

// FNV-1a (Fowler, Noll, Vo 1991).
class Hash {
 public:
  template <class T>
  void add(const std::vector<T>& values) {
    for (const T value : values)
      for (std::size_t byte = 0; byte < sizeof(T); ++byte) add_byte(static_cast<std::uint8_t>(value >> (8 * byte)));
  }
  void add_number(std::int64_t value) { add(std::vector<std::uint64_t>{static_cast<std::uint64_t>(value)}); }
  void print(const std::string& name) const {
    std::printf("%s %016llx\n", name.c_str(), static_cast<unsigned long long>(hash_));
  }

 private:
  void add_byte(std::uint8_t byte) { hash_ = (hash_ ^ byte) * 1099511628211u; }
  std::uint64_t hash_ = 14695981039346656037u;
};

[[noreturn]] void fail(const std::string& what) {
  std::fprintf(stderr, "%s do not come back as they were\n", what.c_str());
  std::exit(1);
}

// A number that looks random, the same for the same place.
std::uint32_t noise(std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  std::uint32_t x = a * 0x9E3779B1u ^ b * 0x85EBCA77u ^ c * 0xC2B2AE3Du;
  for (const int shift : {15, 13, 16}) x = (x ^ x >> shift) * 0x2C1B3C6Du;
  return x ^ x >> 15;
}

// A sensor whose rows look downwards, and what stands around it: ground, walls in some directions, posts before them.
struct Scene {
  BeamTable table;
  MaskGeometry geometry;
  RangeCells cells;
  Bytes fired;
  std::size_t width;

  explicit Scene(std::size_t columns) : fired(2 * columns, 1), width(columns) {
    for (std::size_t c = 0; c < width; c += 97) fired[width + c] = 0;
    geometry.width = width;
    geometry.fired = fired.data();
    for (std::size_t row = 0; row < kRows; ++row) {
      const auto r = static_cast<std::int32_t>(row);
      table.half[row] = row >= 32;
      table.rotation[row] = (r % 4 - 2) * 7'700'000;
      table.vertical[row] = 3'400'000 - r * 720'000;
      table.distance[row] = 11'000'000 + r % 5 * 300'000;
      table.vertical_offset[row] = 2'100'000;
      table.horizontal_offset[row] = r % 2 != 0 ? 260'000 : -260'000;
      geometry.half[row] = table.half[row];
      geometry.rotation[row] = table.rotation[row];
      cells.level[row] = r % 5 * 15;
    }
  }

  std::vector<std::uint16_t> azimuths(std::uint32_t frame) const {
    std::vector<std::uint16_t> azimuth(2 * width);
    for (std::size_t c = 0; c < 2 * width; ++c) {
      const std::size_t column = c % width;
      azimuth[c] = static_cast<std::uint16_t>((column * 36'000 / width + 7 * frame + (c >= width ? 4 : 0)) % 36'000);
    }
    return azimuth;
  }

  // Ranges of a frame, 0 where there is no return; it comes nearer by 0.3 m a turn where it looks ahead.
  Ranges ranges(std::uint32_t frame) const {
    Ranges image(kRows * width);
    for (std::uint32_t row = 0; row < kRows; ++row) {
      const std::uint32_t ground = row < 6 ? 60'000 : 40'000 / (row - 4) + 400;
      for (std::uint32_t c = 0; c < width; ++c) {
        const auto sector = static_cast<std::uint32_t>(c * 24 / width);
        const std::uint32_t wall =
            2'000 + noise(sector, 1, 2) % 12'000 + (c * 48 / static_cast<std::uint32_t>(width)) % 2 * 900;
        const std::uint32_t post = noise(c * 200 / static_cast<std::uint32_t>(width), 3, 4) % 9 == 0 ? 1'500 : 65'000;
        const std::uint32_t ahead = 150 * frame * (sector < 6 || sector >= 18 ? 1 : 0);
        std::uint32_t range =
            std::min(std::min(ground, wall - std::min(wall, ahead)), post) + noise(row, c, 10 + frame) % 9;
        if (noise(row, c, 20 + frame) % 300 == 0) range = 1 + noise(row, c, 30) % 65'535;
        const bool lost = range > 45'000 || noise(row / 3, c / 4, 40) % 17 == 0 || noise(row, c, 50 + frame) % 90 == 0;
        const bool shot = fired[table.half[row] * width + c] != 0;
        if (shot && !lost) image[row * width + c] = static_cast<std::uint16_t>(range);
      }
    }
    return image;
  }
};

Bytes returns_of(const Ranges& image) {
  Bytes returns(image.size());
  for (std::size_t i = 0; i < image.size(); ++i) returns[i] = image[i] != 0;
  return returns;
}

// What ranges are coded with: a path of the processor, and maybe networks or few contexts.
struct Way {
  Path path;
  std::shared_ptr<const RiddleNets> nets;
  std::string codec, name;
  bool quick = false;

  PredictiveCoder coder() const { return PredictiveCoder(path, nets); }
};

std::vector<Way> ways_here() {
  const std::vector<NetForm> forms = net_forms_here();
  std::vector<Way> ways;
  const auto with_nets = [&](Path path, NetForm form) {
    for (const bool in_bytes : {false, true})
      ways.push_back({path, random_nets(form, in_bytes), in_bytes ? "riddle, bytes, " : "riddle, ",
                      name_of(path) + std::string("/") + name_of(form)});
  };
  for (const Path path : paths_here()) {
    ways.push_back({path, nullptr, "", name_of(path)});
    ways.push_back({path, nullptr, "quick ", name_of(path), true});
    if (path != paths_here().back()) with_nets(path, forms.front());
  }
  for (const NetForm form : forms) with_nets(paths_here().back(), form);
  return ways;
}

void check_ranges(const Scene& scene, const Way& way, bool free) {
  for (const bool expects : {false, true}) {
    Hash hash;
    for (const std::uint32_t step : kSteps) {
      RangeCells cells = scene.cells;
      cells.step = step;
      PredictiveCoder encoder = way.coder(), decoder = way.coder();
      RangeHistory history;
      for (std::uint32_t frame = 0; frame < kFrames; ++frame) {
        const Ranges image = scene.ranges(frame);
        const Bytes returns = returns_of(image);
        Ranges sent(image.size());
        const auto azimuth = scene.azimuths(frame);
        const Columns columns{scene.width, azimuth.data(), scene.fired.data()};
        const Ranges seen = expected_ranges(history, scene.table, Motion{}, columns);
        const std::uint16_t* const expected = expects ? seen.data() : nullptr;
        const Bytes data = encoder.encode(image.data(), returns.data(), cells, scene.geometry, 0, 7 * frame, expected,
                                          kWholeFrame, nullptr, way.quick, free ? sent.data() : nullptr, frame > 0);
        const Ranges came = decoder.decode(data.data(), data.size(), returns.data(), cells, scene.geometry, expected);
        if (free && step > 1 && came != sent) fail("free ranges");
        for (std::size_t i = 0; i < came.size(); ++i)
          if (static_cast<std::uint32_t>(std::abs(came[i] - image[i])) > step / 2) fail("ranges");
        hash.add(data);
        hash.add(came);
        history.remember(came.data(), columns, scene.table.half);
      }
    }
    hash.print(way.codec + (free ? "free " : "") + (expects ? "ranges with motion, " : "ranges, ") + way.name);
  }
}

// The same in slabs of a third of a turn, each of which goes on where the one before ended.
void check_slabs(const Scene& scene, const Way& way) {
  Hash hash;
  PredictiveCoder encoder = way.coder(), decoder = way.coder();
  const Ranges image = scene.ranges(0);
  const std::size_t each = scene.width / 3;
  for (std::size_t slab = 0; slab < 3; ++slab) {
    const std::size_t known = std::min<std::size_t>(slab * each, 100), from = slab * each - known, width = each + known;
    MaskGeometry geometry = scene.geometry;
    const auto cut = [&](const auto& all, std::size_t columns) {
      std::remove_cvref_t<decltype(all)> part;
      for (std::size_t at = from; at < all.size(); at += scene.width)
        part.insert(part.end(), all.begin() + static_cast<std::ptrdiff_t>(at),
                    all.begin() + static_cast<std::ptrdiff_t>(at + columns));
      return part;
    };
    const Bytes fired = cut(scene.fired, width);
    const Ranges ranges = cut(image, width), before = cut(image, known);
    const Bytes returns = returns_of(ranges);
    geometry.width = width;
    geometry.fired = fired.data();
    const auto past = static_cast<KnownColumns>(known);
    const Bytes data = encoder.encode(ranges.data(), returns.data(), scene.cells, geometry, 2000,
                                      static_cast<std::uint32_t>(slab * each), nullptr, past, nullptr, way.quick);
    const Ranges came =
        decoder.decode(data.data(), data.size(), returns.data(), scene.cells, geometry, nullptr, past, before.data());
    for (std::size_t i = 0; i < came.size(); ++i)
      if (i % width >= known && came[i] != ranges[i]) fail("slabs");
    hash.add(data);
  }
  hash.print(way.codec + "slabs, " + way.name);
}

// Networks alone, in every form.
void check_networks() {
  for (const NetForm form : net_forms_here()) {
    const auto print = [form](const std::string& kind, bool with_cases, bool all_tiles) {
      Hash hash;
      hash.add(odds_of_networks(form, with_cases, all_tiles));
      hash.print(kind + ", " + name_of(form));
    };
    print("networks", false, true);
    print("networks with cases", true, true);
    print("networks of few tiles", true, false);
  }
}

// Weights that a network has after some steps on returns that were coded with it.
void check_training(const Scene& scene) {
  constexpr std::size_t kMiddle = 16;
  const std::array<std::size_t, 4> dims = {kInputsAlone, kMiddle, kMiddle, kNetOutputs};
  std::array<std::vector<std::int16_t>, kNetLayers> weights;
  std::array<std::vector<std::int32_t>, kNetLayers> biases;
  std::array<GivenLayer, kNetLayers> layers;
  for (std::uint32_t l = 0; l < kNetLayers; ++l) {
    for (std::uint32_t i = 0; i < dims[l] * dims[l + 1]; ++i)
      weights[l].push_back(static_cast<std::int16_t>(static_cast<int>(noise(i, l, 60) % 255) - 127));
    biases[l].resize(dims[l + 1]);
    layers[l] = {dims[l], dims[l + 1], weights[l].data(), biases[l].data(), l == 0 ? 6u : 11u};
  }
  const auto nets = std::make_shared<RiddleNets>();
  nets->alone.emplace(layers);
  PredictiveCoder coder(paths_here().back(), nets);
  RiddleSamples samples;
  const Ranges image = scene.ranges(0);
  coder.encode(image.data(), returns_of(image).data(), scene.cells, scene.geometry, 0, 0, nullptr, kWholeFrame,
               &samples);
  TrainSettings settings;
  settings.batch = 64;
  RiddleTrainer trainer(layers, settings, 1);
  trainer.add(samples, false);
  trainer.train(40, [] { return true; });
  Hash hash;
  for (const RiddleTrainer::Layer& layer : trainer.layers())
    for (const auto* numbers : {&layer.weights, &layer.bias, &layer.conditional_bias})
      for (const float number : *numbers) hash.add_number(std::bit_cast<std::int32_t>(number));
  hash.print("training");
}

void check_masks(const Scene& scene) {
  Hash hash;
  Bytes before;
  for (std::uint32_t frame = 0; frame < kFrames; ++frame) {
    const Bytes mask = returns_of(scene.ranges(frame));
    const EarlierMask earlier{before.data(), before.empty() ? 0 : scene.width};
    const Bytes data = encode_mask(mask.data(), scene.geometry, earlier);
    if (decode_mask(data.data(), data.size(), scene.geometry, earlier) != mask) fail("masks");
    hash.add(data);
    before = mask;
  }
  hash.print("mask");
}

// Masks of a stream, which the motion and what is expected help to say.
void check_mask_stream(const Scene& scene, Path path) {
  Hash hash;
  MaskStream encoder(path), decoder(path);
  RangeHistory history;
  for (std::uint32_t frame = 0; frame < kFrames; ++frame) {
    const Ranges image = scene.ranges(frame);
    const Bytes mask = returns_of(image);
    const auto azimuth = scene.azimuths(frame);
    const Columns columns{scene.width, azimuth.data(), scene.fired.data()};
    MaskView view;
    view.geometry = scene.geometry;
    view.azimuth = azimuth.data();
    view.vertical = scene.table.vertical;
    view.motion.translation = {-4'800, 160, 16};
    const Ranges expected = expected_ranges(history, scene.table, view.motion, columns);
    if (frame > 0) view.expected = expected.data();
    const Bytes data = encoder.encode(mask.data(), view);
    if (decoder.decode(data.data(), data.size(), view) != mask) fail("masks of a stream");
    hash.add(data);
    history.remember(image.data(), columns, scene.table.half);
  }
  hash.print(std::string("mask of a stream, ") + name_of(path));
}

void check_intensities(const Scene& scene) {
  Hash hash, few;
  for (const std::uint32_t levels : {4u, 64u, 256u}) {
    const Ranges image = scene.ranges(0);
    const Bytes returns = returns_of(image);
    Bytes values(image.size());
    for (std::uint32_t i = 0; i < values.size(); ++i) {
      const std::uint32_t value =
          (noise(image[i] / 400u, 6, 7) % 200 + noise(i, 8, 9) % 30) * levels / 256 * (256 / levels);
      values[i] = static_cast<std::uint8_t>(returns[i] != 0 ? value : 0);
    }
    const Bytes data = encode_intensity(values.data(), returns.data(), scene.geometry, 0);
    if (decode_intensity(data.data(), data.size(), returns.data(), scene.geometry) != values) fail("intensities");
    hash.add(data);
    for (const std::size_t at_most : {2, 6, 20, 70})
      few.add(choose_levels(values.data(), returns.data(), scene.geometry, at_most));
  }
  hash.print("intensity");
  few.print("few intensities");
}

// What is expected of a frame, and the motion that is found for it.
void check_motion(const Scene& scene) {
  Hash expected, found;
  RangeHistory history;
  Motion motion;
  for (std::uint32_t frame = 0; frame < kFrames; ++frame) {
    const Ranges image = scene.ranges(frame);
    const auto azimuth = scene.azimuths(frame);
    const Columns columns{scene.width, azimuth.data(), scene.fired.data()};
    const FoundMotion result = find_motion(history, image.data(), columns, scene.table, motion);
    if (result.found != (frame > 0)) fail("motions");
    motion = result.motion;
    for (const std::int32_t number : motion.rotation) found.add_number(number);
    for (const std::int32_t number : motion.translation) found.add_number(number);
    Motion turned;  // by a tenth of a radian, and 0.5 m
    turned.rotation = {1'068'378'104, -107'195'196, 0, 107'195'196, 1'068'378'104, 0, 0, 0, 1 << 30};
    turned.translation = {-8'000, 160, 16};
    for (const Motion& given : {motion, turned}) expected.add(expected_ranges(history, scene.table, given, columns));
    history.remember(image.data(), columns, scene.table.half);
  }
  expected.print("warp");
  found.print("motion search");
}

}  // namespace

int main(int count, char** words) {
  const long columns = count > 1 ? std::atol(words[1]) : 300;
  if (columns < 1 || columns > 4096) return 2;
  const Scene scene(static_cast<std::size_t>(columns));
  for (const Way& way : ways_here()) {
    for (const bool free : {false, true}) check_ranges(scene, way, free);
    check_slabs(scene, way);
  }
  check_networks();
  check_training(scene);
  check_masks(scene);
  for (const Path path : paths_here()) check_mask_stream(scene, path);
  check_intensities(scene);
  check_motion(Scene(1'200));
}
