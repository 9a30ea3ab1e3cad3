#include "network/train.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

constexpr float kCaseUnit = 1.0f / 64.0f, kInputUnit = 32.0f, kMiddleUnit = 8.0f, kTop = static_cast<float>(kMiddleTop) / kMiddleUnit;
constexpr float kOutputUnit = 32768.0f / 6.0f, kOutputScale = kOutputUnit / 4096.0f;
constexpr float kRecent = 8.0f;  // the running mean is over about one in so many of all steps
// Steps of weights that are turned are longer than those of biases, and in the last layer shorter.
constexpr std::array<float, kNetLayers> kTurnedRates = {2.0f, 2.0f, 0.6f};
constexpr std::int16_t kMostByte = 127;
constexpr float kLargestByte = kMostByte;
constexpr float kLeastLeft = 0.085f;  // (1 - u) where the coder's smallest probability lies

// The probability of what did not come is (1 - u)^3 / 2 where it was the less likely, u being its log odds of six.
struct Paid {
  float slope;  // of the natural units paid, by the log odds of a one
  float bits;
};
Paid paid(float odds, bool one) {
  const float u = std::min(std::fabs(odds) / 6.0f, 1.0f), left = std::max(1.0f - u, kLeastLeft);
  const float rare = 0.5f * left * left * left;
  const bool rare_came = (odds >= 0.0f) != one;
  const float size = rare_came ? 0.5f / left : 0.25f * left * left / (1.0f - rare);
  return {one ? -size : size, std::log2(rare_came ? rare : 1.0f - rare) * -1.0f};
}

// A decision of a return: the output that speaks of it, how much of its log odds counts, and whether it came as a one.
struct Decision {
  std::size_t output = 0;
  float share = 1.0f;
  bool one = false;
};

// Those of a return, `count` of them.
struct Decisions {
  std::array<Decision, RiddleSamples::kDecisions> of;
  std::size_t count = 4;

  Decisions(std::uint32_t leaf, const std::uint8_t* offsets) {
    for (std::uint32_t level = 0; level < 4; ++level)
      of[level] = {(16 + leaf) >> (4 - level), 1.0f, (leaf >> (3 - level) & 1u) != 0};
    float share = 1.0f;
    for (std::size_t i = 0; i < RiddleSamples::kOffsets && offsets[i] != RiddleSamples::kNone; ++i, share *= 0.5f)
      of[count++] = {16 + leaf, share, offsets[i] == 1};
  }
};

// Of a number that is not negative. (std::floor would take a call each where processors are not asked what they can do.)
float rounded(float value) { return static_cast<float>(static_cast<std::int32_t>(value + 0.5f)); }

// In single precision, as compilers find vectors for it. (Of std::clamp they take addresses.)
float within(float value, float least, float most) {
  value = value > least ? value : least;
  return value < most ? value : most;
}

// As eight bits will hold it.
float in_bytes(float weight) { return rounded(within(weight, -kLargestByte, kLargestByte) + kLargestByte) - kLargestByte; }

// Hidden values of their sums, and which of them move with these.
void settle(std::size_t count, float* __restrict values, std::uint8_t* __restrict moves) {
  for (std::size_t i = 0; i < count; ++i) moves[i] = static_cast<std::uint8_t>((values[i] > 0.0f) & (values[i] < kTop));
  for (std::size_t i = 0; i < count; ++i) values[i] = rounded(within(values[i], 0.0f, kTop) * kMiddleUnit) * (1.0f / kMiddleUnit);
}

// Which inputs each block of sums looks at.
Runs runs_of(const GivenLayer& layer) {
  Runs found;
  for (std::size_t block = 0; block * kBlock < layer.out; ++block) {
    std::vector<Run>& runs = found.emplace_back();
    for (std::size_t in = 0; in < layer.in; in += kTileInputs) {
      if (is_tile_empty(layer, block, in)) continue;
      if (runs.empty() || runs.back().to != in) runs.push_back({in, in});
      runs.back().to = in + kTileInputs;
    }
  }
  return found;
}

RiddleTrainer::Layer of_zeros(const RiddleTrainer::Layer& like) {
  return {like.in, like.out, std::vector<float>(like.weights.size()), std::vector<float>(like.bias.size()), std::vector<float>(like.cases.size())};
}

// Which biases of cases a sample has, (96, out) as they lie: those of its row, and those of its scale.
std::array<std::size_t, 2> cases_of(const std::int8_t* in, std::size_t out) {
  return {row_case(in[kRowInput]) * out, (kRowCases + scale_case(in[kScaleInput])) * out};
}

}  // namespace

void SampleRoom::put(const RiddleSamples& from, std::size_t i, std::size_t at) {
  if (at == size()) {
    in_.resize((at + 1) * inputs_);
    said_.resize((at + 1) * RiddleSamples::kDecisions);
    offsets_.resize((at + 1) * RiddleSamples::kOffsets);
    leaf_.push_back(0);
  }
  std::copy_n(from.in.data() + i * inputs_, inputs_, in_.data() + at * inputs_);
  constexpr std::size_t kDecisions = RiddleSamples::kDecisions, kOffsets = RiddleSamples::kOffsets;
  std::copy_n(from.said.data() + i * kDecisions, kDecisions, said_.data() + at * kDecisions);
  std::copy_n(from.offset.data() + i * kOffsets, kOffsets, offsets_.data() + at * kOffsets);
  leaf_[at] = from.leaf[i];
}

RiddleTrainer::RiddleTrainer(const std::array<GivenLayer, kNetLayers>& given, const TrainSettings& settings, std::uint32_t seed)
    : settings_(settings), seed_(seed), learned_(given[0].in, settings.room), held_(given[0].in, settings.held_room) {
  const auto is_within = [](auto value, auto least, auto most) { return value >= least && value <= most; };
  if (!is_within(settings.rate, 0.0f, 1.0f) || !is_within(settings.mean, 0.0f, 1.0f) || !is_within(settings.beside, 0.0f, 1.0f) ||
      !is_within(settings.batch, 8u, 4096u) || !is_within(settings.room, 1u, 1u << 22) || !is_within(settings.turns, 1u, 1u << 20) ||
      !is_within(settings.held_room, 1u, 1u << 20))
    throw Error(ErrorCode::Settings, "training with settings out of range");
  values_[0].resize(settings.batch * given[0].in);
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    Layer& layer = layers_[l];
    layer.in = given[l].in;
    layer.out = given[l].out;
    const float unit = 1.0f / static_cast<float>(1u << given[l].shift), scale = l + 1 == kNetLayers ? unit / kOutputScale : unit;
    layer.weights.resize(layer.in * layer.out);
    for (std::size_t o = 0; o < layer.out; ++o) {
      for (std::size_t i = 0; i < layer.in; ++i)
        layer.weights[i * layer.out + o] = static_cast<float>(given[l].weights[o * layer.in + i]) * scale;
      layer.bias.push_back(static_cast<float>(given[l].bias[o]) * scale / (l == 0 ? kInputUnit : kMiddleUnit));
    }
    if (l == 0) layer.cases.resize(kCases * layer.out);
    if (given[l].cases != nullptr)
      std::transform(given[l].cases, given[l].cases + layer.cases.size(), layer.cases.begin(), [](std::int8_t c) { return static_cast<float>(c) * kCaseUnit; });
    runs_[l] = runs_of(given[l]);
    gradient_[l] = of_zeros(layer);
    const Layer none = of_zeros(layer);
    moments_[l] = {{{none.bias, none.bias}, {none.cases, none.cases}}};
    turned_weights_[l] = turned_weights(runs_[l], layer.out);
    values_[l + 1].resize(settings.batch * layer.out);
    slopes_[l + 1].resize(settings.batch * layer.out);
    if (l + 1 < kNetLayers) moves_[l].resize(settings.batch * layer.out);
  }
  const std::int16_t* const first = given[0].weights;
  if (std::all_of(first, first + given[0].in * given[0].out, [](std::int16_t w) { return w >= -kMostByte && w <= kMostByte; }))
    byte_unit_ = 1.0f / static_cast<float>(1u << given[0].shift);
  mean_ = layers_;
  drawn_.resize(settings.batch);
}

void RiddleTrainer::add(const RiddleSamples& samples, bool held) {
  if (samples.size() == 0) return;
  if (samples.inputs != inputs()) throw Error(ErrorCode::Section, "samples of other inputs than the network's");
  const std::size_t room = std::min(learned_.room(), samples.size() * settings_.turns);
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (held) {
      held_.put(samples, i, next_held_);
      next_held_ = (next_held_ + 1) % held_.room();
    } else {
      learned_.put(samples, i, learned_.size() < room ? learned_.size() : random() % learned_.size());
    }
  }
}

std::uint32_t RiddleTrainer::random() {
  seed_ = seed_ * 6364136223846793005u + 1442695040888963407u;
  return static_cast<std::uint32_t>(seed_ >> 33);
}

std::size_t RiddleTrainer::train(std::size_t steps, const std::function<bool()>& go_on) {
  std::size_t done = 0;
  for (; done < steps && learned_.size() >= settings_.batch && go_on(); ++done) step();
  return done;
}

void RiddleTrainer::step() {
  const std::size_t inputs = layers_[0].in;
  for (std::size_t b = 0; b < settings_.batch; ++b) {
    drawn_[b] = random() % learned_.size();
    const std::int8_t* const in = learned_.in(drawn_[b]);
    for (std::size_t i = 0; i < inputs; ++i) values_[0][b * inputs + i] = static_cast<float>(in[i]) * (1.0f / kInputUnit);
  }
  forward();
  backward();
  update();
  ++steps_;
}

void RiddleTrainer::forward() {
  rounded_ = layers_[0].weights;
  if (byte_unit_ > 0.0f)
    for (float& weight : rounded_) weight = in_bytes(weight / byte_unit_) * byte_unit_;
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    const Layer& layer = layers_[l];
    std::vector<float>& out = values_[l + 1];
    for (std::size_t b = 0; b < settings_.batch; ++b) std::copy(layer.bias.begin(), layer.bias.end(), out.begin() + static_cast<std::ptrdiff_t>(b * layer.out));
    for (std::size_t b = 0; l == 0 && b < settings_.batch; ++b)
      for (const std::size_t from : cases_of(learned_.in(drawn_[b]), layer.out))
        for (std::size_t o = 0; o < layer.out; ++o) out[b * layer.out + o] += layer.cases[from + o];
    const std::vector<float>& weights = l == 0 ? rounded_ : layer.weights;
    add_product_with(runs_[l], settings_.batch, layer.out, {values_[l].data(), layer.in, 1}, weights.data(), out.data());
    if (l + 1 == kNetLayers) break;
    settle(out.size(), out.data(), moves_[l].data());
  }
}

void RiddleTrainer::backward() {
  std::vector<float>& last = slopes_[kNetLayers];
  std::fill(last.begin(), last.end(), 0.0f);
  const float share = 1.0f / static_cast<float>(settings_.batch);
  for (std::size_t b = 0; b < settings_.batch; ++b) {
    const std::size_t sample = drawn_[b];
    const Decisions decisions(learned_.leaf(sample), learned_.offsets(sample));
    const std::int16_t* const said = learned_.said(sample);
    for (std::size_t d = 0; d < decisions.count; ++d) {
      const Decision& of = decisions.of[d];
      const std::size_t at = b * kNetOutputs + of.output;
      const float beside = settings_.beside * static_cast<float>(said[d]) * (1.0f / kOutputUnit);
      last[at] += paid(values_[kNetLayers][at] * of.share + beside, of.one).slope * of.share * share;
    }
  }
  for (std::size_t l = kNetLayers; l-- > 0;) {
    const Layer& layer = layers_[l];
    const std::vector<float>& slopes = slopes_[l + 1];
    Layer& gradient = gradient_[l];
    std::fill(gradient.weights.begin(), gradient.weights.end(), 0.0f);
    std::fill(gradient.bias.begin(), gradient.bias.end(), 0.0f);
    std::fill(gradient.cases.begin(), gradient.cases.end(), 0.0f);
    add_product_to(runs_[l], layer.out, settings_.batch, {values_[l].data(), 1, layer.in}, slopes.data(), gradient.weights.data());
    for (std::size_t b = 0; b < settings_.batch; ++b)
      for (std::size_t o = 0; o < layer.out; ++o) gradient.bias[o] += slopes[b * layer.out + o];
    for (std::size_t b = 0; l == 0 && b < settings_.batch; ++b)
      for (const std::size_t to : cases_of(learned_.in(drawn_[b]), layer.out))
        for (std::size_t o = 0; o < layer.out; ++o) gradient.cases[to + o] += slopes[b * layer.out + o];
    if (l == 0) break;
    turned_.resize(layer.weights.size());
    for (std::size_t i = 0; i < layer.in; ++i)
      for (std::size_t o = 0; o < layer.out; ++o) turned_[o * layer.in + i] = layer.weights[i * layer.out + o];
    std::vector<float>& before = slopes_[l];
    std::fill(before.begin(), before.end(), 0.0f);
    add_product(settings_.batch, layer.in, layer.out, {slopes.data(), layer.out, 1}, turned_.data(), before.data());
    for (std::size_t i = 0; i < before.size(); ++i) before[i] = moves_[l - 1][i] != 0 ? before[i] : 0.0f;
  }
}

void RiddleTrainer::update() {
  left_first_ *= kFirstDecay;
  left_second_ *= kSecondDecay;
  const AdamStep step{settings_.rate, 1.0f / (1.0f - left_first_), 1.0f / (1.0f - left_second_),
                      std::clamp(1.0f - kRecent / static_cast<float>(steps_ + 1), 0.0f, settings_.mean)};
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    Layer &layer = layers_[l], &mean = mean_[l];
    AdamStep turned = step;
    turned.rate *= kTurnedRates[l];
    for (TurnedWeights& weights : turned_weights_[l]) weights.take_step(turned, steps_, layer.out, gradient_[l].weights, layer.weights, mean.weights);
    take_step(step, gradient_[l].bias, moments_[l][0], layer.bias, mean.bias);
    take_step(step, gradient_[l].cases, moments_[l][1], layer.cases, mean.cases);
  }
}

double RiddleTrainer::cost(const RiddleNet& net, float beside) const {
  if (net.inputs() != inputs()) throw Error(ErrorCode::Section, "a network of other inputs");
  double bits = 0;
  NetValues values;
  for (std::size_t i = 0; i < held_.size(); ++i) {
    std::copy_n(held_.in(i), inputs(), values.in.begin());
    net.run(std::array{&values});
    const Decisions decisions(held_.leaf(i), held_.offsets(i));
    for (std::size_t d = 0; d < decisions.count; ++d) {
      const Decision& of = decisions.of[d];
      const std::int16_t said = of.output < kTreeOdds ? values.out[of.output] : net.leaf_odds(values, of.output - kTreeOdds);
      const float odds = static_cast<float>(said) * of.share + beside * static_cast<float>(held_.said(i)[d]);
      bits += static_cast<double>(paid(odds * (1.0f / kOutputUnit), of.one).bits);
    }
  }
  return held_.size() == 0 ? 0.0 : bits / static_cast<double>(held_.size());
}

}  // namespace lidarcodec
