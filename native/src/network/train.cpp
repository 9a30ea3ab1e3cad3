#include "network/train.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

// Units of RiddleNet in natural ones: biases of rows and scales, inputs, hidden values, and log odds (32768 for 6). The
// last layer's sums have steps of 1 / 4096.
constexpr float kConditionalUnit = 1.0f / 64.0f, kInputUnit = 32.0f, kHiddenUnit = 8.0f,
                kClip = static_cast<float>(kHiddenMax) / kHiddenUnit;
constexpr float kOutputUnit = 32768.0f / 6.0f, kOutputScale = kOutputUnit / 4096.0f;
constexpr float kRecent = 8.0f;  // the running mean is over about the last 1 / kRecent of all steps
// Learning rates of the weights in their rotated basis, relative to that of the biases; smaller in the last layer.
constexpr std::array<float, kNetLayers> kRotatedRates = {2.0f, 2.0f, 0.6f};
constexpr std::int16_t kMostByte = 127;
constexpr float kLargestByte = kMostByte;
constexpr float kLeastRemainder = 0.085f;  // 1 - u at the coder's smallest probability: 0.085^3 / 2 is 10 / 32768

// What the coder spends on a bit, given log odds. With u = |odds| / 6, the less likely value has the probability
// (1 - u)^3 / 2: the cubic that stands for the logistic function (bits/cells.hpp).
struct Cost {
  float gradient;  // of the cost in natural units, by the log odds of a one
  float bits;
};
Cost cost_of(float odds, bool one) {
  const float u = std::min(std::fabs(odds) / 6.0f, 1.0f), left = std::max(1.0f - u, kLeastRemainder);
  const float rare = 0.5f * left * left * left;
  const bool rare_came = (odds >= 0.0f) != one;
  const float size = rare_came ? 0.5f / left : 0.25f * left * left / (1.0f - rare);
  return {one ? -size : size, std::log2(rare_came ? rare : 1.0f - rare) * -1.0f};
}

// A decision of a return: the output that predicts it, the factor of its log odds, and the value.
struct Decision {
  std::size_t output = 0;
  float share = 1.0f;
  bool one = false;
};

// The decisions of a return.
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

// A number that is not negative, rounded. (std::floor would be a call on processors without an instruction for it.)
float rounded(float value) { return static_cast<float>(static_cast<std::int32_t>(value + 0.5f)); }

// Like std::clamp, but by value, so that compilers vectorise it.
float clamped(float value, float least, float most) {
  value = value > least ? value : least;
  return value < most ? value : most;
}

// A weight as eight bits will hold it.
float to_byte(float weight) {
  return rounded(clamped(weight, -kLargestByte, kLargestByte) + kLargestByte) - kLargestByte;
}

// Turns sums into hidden values, clipped and rounded, and notes which of them were not clipped: only these pass
// gradients.
void clip_and_round(std::size_t count, float* __restrict values, std::uint8_t* __restrict unclipped) {
  for (std::size_t i = 0; i < count; ++i)
    unclipped[i] = static_cast<std::uint8_t>((values[i] > 0.0f) & (values[i] < kClip));
  for (std::size_t i = 0; i < count; ++i)
    values[i] = rounded(clamped(values[i], 0.0f, kClip) * kHiddenUnit) * (1.0f / kHiddenUnit);
}

// The inputs of each block of outputs whose tiles are not pruned.
Runs runs_of(const GivenLayer& layer) {
  Runs found;
  for (std::size_t block = 0; block * kTileOutputs < layer.out; ++block) {
    std::vector<Run>& runs = found.emplace_back();
    for (std::size_t in = 0; in < layer.in; in += kTileInputs) {
      if (is_pruned(layer, block, in)) continue;
      if (runs.empty() || runs.back().to != in) runs.push_back({in, in});
      runs.back().to = in + kTileInputs;
    }
  }
  return found;
}

RiddleTrainer::Layer of_zeros(const RiddleTrainer::Layer& like) {
  return {like.in, like.out, std::vector<float>(like.weights.size()), std::vector<float>(like.bias.size()),
          std::vector<float>(like.conditional_bias.size())};
}

// Where the biases of a sample's row and of its scale begin in (96, out).
std::array<std::size_t, 2> conditional_biases_of(const std::int8_t* in, std::size_t out) {
  return {row_bias_of(in[kRowInput]) * out, (kRowBiases + scale_bias_of(in[kScaleInput])) * out};
}

}  // namespace

void SampleBuffer::put(const RiddleSamples& from, std::size_t i, std::size_t at) {
  if (at == size()) {
    in_.resize((at + 1) * inputs_);
    context_odds_.resize((at + 1) * RiddleSamples::kDecisions);
    offsets_.resize((at + 1) * RiddleSamples::kOffsets);
    leaf_.push_back(0);
  }
  std::copy_n(from.in.data() + i * inputs_, inputs_, in_.data() + at * inputs_);
  constexpr std::size_t kDecisions = RiddleSamples::kDecisions, kOffsets = RiddleSamples::kOffsets;
  std::copy_n(from.context_odds.data() + i * kDecisions, kDecisions, context_odds_.data() + at * kDecisions);
  std::copy_n(from.offset.data() + i * kOffsets, kOffsets, offsets_.data() + at * kOffsets);
  leaf_[at] = from.leaf[i];
}

RiddleTrainer::RiddleTrainer(const std::array<GivenLayer, kNetLayers>& given, const TrainSettings& settings,
                             std::uint32_t seed)
    : settings_(settings), seed_(seed), learned_(given[0].in, settings.room), held_(given[0].in, settings.held_room) {
  const auto is_within = [](auto value, auto least, auto most) { return value >= least && value <= most; };
  if (!is_within(settings.rate, 0.0f, 1.0f) || !is_within(settings.mean, 0.0f, 1.0f) ||
      !is_within(settings.beside, 0.0f, 1.0f) || !is_within(settings.batch, 8u, 4096u) ||
      !is_within(settings.room, 1u, 1u << 22) || !is_within(settings.turns, 1u, 1u << 20) ||
      !is_within(settings.held_room, 1u, 1u << 20))
    throw Error(ErrorCode::Settings, "training with settings out of range");
  values_[0].resize(settings.batch * given[0].in);
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    Layer& layer = layers_[l];
    layer.in = given[l].in;
    layer.out = given[l].out;
    const float unit = 1.0f / static_cast<float>(1u << given[l].shift),
                scale = l + 1 == kNetLayers ? unit / kOutputScale : unit;
    layer.weights.resize(layer.in * layer.out);
    for (std::size_t o = 0; o < layer.out; ++o) {
      for (std::size_t i = 0; i < layer.in; ++i)
        layer.weights[i * layer.out + o] = static_cast<float>(given[l].weights[o * layer.in + i]) * scale;
      layer.bias.push_back(static_cast<float>(given[l].bias[o]) * scale / (l == 0 ? kInputUnit : kHiddenUnit));
    }
    if (l == 0) layer.conditional_bias.resize(kConditionalBiases * layer.out);
    if (given[l].conditional_bias != nullptr)
      std::transform(given[l].conditional_bias, given[l].conditional_bias + layer.conditional_bias.size(),
                     layer.conditional_bias.begin(),
                     [](std::int8_t c) { return static_cast<float>(c) * kConditionalUnit; });
    runs_[l] = runs_of(given[l]);
    gradient_[l] = of_zeros(layer);
    const Layer none = of_zeros(layer);
    moments_[l] = {{{none.bias, none.bias}, {none.conditional_bias, none.conditional_bias}}};
    rotated_weights_[l] = rotated_weights(runs_[l], layer.out);
    values_[l + 1].resize(settings.batch * layer.out);
    gradients_[l + 1].resize(settings.batch * layer.out);
    if (l + 1 < kNetLayers) unclipped_[l].resize(settings.batch * layer.out);
  }
  const std::int16_t* const first = given[0].weights;
  if (std::all_of(first, first + given[0].in * given[0].out,
                  [](std::int16_t w) { return w >= -kMostByte && w <= kMostByte; }))
    byte_unit_ = 1.0f / static_cast<float>(1u << given[0].shift);
  mean_ = layers_;
  drawn_.resize(settings.batch);
}

void RiddleTrainer::add(const RiddleSamples& samples, bool held) {
  if (samples.size() == 0) return;
  if (samples.inputs != inputs()) throw Error(ErrorCode::Section, "samples of other inputs than the network's");
  const std::size_t room = std::min(learned_.capacity(), samples.size() * settings_.turns);
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (held) {
      held_.put(samples, i, next_held_);
      next_held_ = (next_held_ + 1) % held_.capacity();
    } else {
      learned_.put(samples, i, learned_.size() < room ? learned_.size() : random() % learned_.size());
    }
  }
}

std::uint32_t RiddleTrainer::random() {
  seed_ = seed_ * 6364136223846793005u + 1442695040888963407u;  // the linear congruential generator of Knuth's MMIX
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
    for (std::size_t i = 0; i < inputs; ++i)
      values_[0][b * inputs + i] = static_cast<float>(in[i]) * (1.0f / kInputUnit);
  }
  forward();
  backward();
  update();
  ++steps_;
}

void RiddleTrainer::forward() {
  rounded_ = layers_[0].weights;
  if (byte_unit_ > 0.0f)
    for (float& weight : rounded_) weight = to_byte(weight / byte_unit_) * byte_unit_;
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    const Layer& layer = layers_[l];
    std::vector<float>& out = values_[l + 1];
    for (std::size_t b = 0; b < settings_.batch; ++b)
      std::copy(layer.bias.begin(), layer.bias.end(), out.begin() + static_cast<std::ptrdiff_t>(b * layer.out));
    for (std::size_t b = 0; l == 0 && b < settings_.batch; ++b)
      for (const std::size_t from : conditional_biases_of(learned_.in(drawn_[b]), layer.out))
        for (std::size_t o = 0; o < layer.out; ++o) out[b * layer.out + o] += layer.conditional_bias[from + o];
    const std::vector<float>& weights = l == 0 ? rounded_ : layer.weights;
    add_product_with(runs_[l], settings_.batch, layer.out, {values_[l].data(), layer.in, 1}, weights.data(),
                     out.data());
    if (l + 1 == kNetLayers) break;
    clip_and_round(out.size(), out.data(), unclipped_[l].data());
  }
}

void RiddleTrainer::backward() {
  std::vector<float>& last = gradients_[kNetLayers];
  std::fill(last.begin(), last.end(), 0.0f);
  const float share = 1.0f / static_cast<float>(settings_.batch);
  for (std::size_t b = 0; b < settings_.batch; ++b) {
    const std::size_t sample = drawn_[b];
    const Decisions decisions(learned_.leaf(sample), learned_.offsets(sample));
    const std::int16_t* const context_odds = learned_.context_odds(sample);
    for (std::size_t d = 0; d < decisions.count; ++d) {
      const Decision& of = decisions.of[d];
      const std::size_t at = b * kNetOutputs + of.output;
      const float beside = settings_.beside * static_cast<float>(context_odds[d]) * (1.0f / kOutputUnit);
      last[at] += cost_of(values_[kNetLayers][at] * of.share + beside, of.one).gradient * of.share * share;
    }
  }
  for (std::size_t l = kNetLayers; l-- > 0;) {
    const Layer& layer = layers_[l];
    const std::vector<float>& gradients = gradients_[l + 1];
    Layer& gradient = gradient_[l];
    std::fill(gradient.weights.begin(), gradient.weights.end(), 0.0f);
    std::fill(gradient.bias.begin(), gradient.bias.end(), 0.0f);
    std::fill(gradient.conditional_bias.begin(), gradient.conditional_bias.end(), 0.0f);
    add_product_to(runs_[l], layer.out, settings_.batch, {values_[l].data(), 1, layer.in}, gradients.data(),
                   gradient.weights.data());
    for (std::size_t b = 0; b < settings_.batch; ++b)
      for (std::size_t o = 0; o < layer.out; ++o) gradient.bias[o] += gradients[b * layer.out + o];
    for (std::size_t b = 0; l == 0 && b < settings_.batch; ++b)
      for (const std::size_t to : conditional_biases_of(learned_.in(drawn_[b]), layer.out))
        for (std::size_t o = 0; o < layer.out; ++o) gradient.conditional_bias[to + o] += gradients[b * layer.out + o];
    if (l == 0) break;
    transposed_.resize(layer.weights.size());
    for (std::size_t i = 0; i < layer.in; ++i)
      for (std::size_t o = 0; o < layer.out; ++o) transposed_[o * layer.in + i] = layer.weights[i * layer.out + o];
    std::vector<float>& before = gradients_[l];
    std::fill(before.begin(), before.end(), 0.0f);
    add_product(settings_.batch, layer.in, layer.out, {gradients.data(), layer.out, 1}, transposed_.data(),
                before.data());
    for (std::size_t i = 0; i < before.size(); ++i) before[i] = unclipped_[l - 1][i] != 0 ? before[i] : 0.0f;
  }
}

void RiddleTrainer::update() {
  beta1_power_ *= kBeta1;
  beta2_power_ *= kBeta2;
  const AdamStep step{settings_.rate, 1.0f / (1.0f - beta1_power_), 1.0f / (1.0f - beta2_power_),
                      std::clamp(1.0f - kRecent / static_cast<float>(steps_ + 1), 0.0f, settings_.mean)};
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    Layer &layer = layers_[l], &mean = mean_[l];
    AdamStep rotated = step;
    rotated.rate *= kRotatedRates[l];
    for (RotatedWeights& weights : rotated_weights_[l])
      weights.take_step(rotated, steps_, layer.out, gradient_[l].weights, layer.weights, mean.weights);
    take_step(step, gradient_[l].bias, moments_[l][0], layer.bias, mean.bias);
    take_step(step, gradient_[l].conditional_bias, moments_[l][1], layer.conditional_bias, mean.conditional_bias);
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
      const std::int16_t net_odds =
          of.output < kTreeOdds ? values.out[of.output] : net.leaf_odds(values, of.output - kTreeOdds);
      const float odds =
          static_cast<float>(net_odds) * of.share + beside * static_cast<float>(held_.context_odds(i)[d]);
      bits += static_cast<double>(cost_of(odds * (1.0f / kOutputUnit), of.one).bits);
    }
  }
  return held_.size() == 0 ? 0.0 : bits / static_cast<double>(held_.size());
}

}  // namespace lidarcodec
