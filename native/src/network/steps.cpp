#include "network/steps.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace lidarcodec {
namespace {

constexpr float kLeast = 1e-6f;
constexpr std::size_t kSums = 16;
constexpr std::size_t kMostInputs = 64;  // of a group: what turning it takes grows with their third power
constexpr std::size_t kTurnEvery = 100, kTurnEveryAtFirst = 20;  // steps
constexpr float kTogetherDecay = 0.99f;
constexpr float kAlike = 0.05f;  // directions whose slopes go together less are left as they are

// Moments of slopes, and what numbers move by.
float move_of(const AdamStep& step, float slope, float& first, float& second) {
  first += (1.0f - kFirstDecay) * (slope - first);
  second += (1.0f - kSecondDecay) * (slope * slope - second);
  return first * step.first / (std::sqrt(second * step.second) + kLeast);
}

// Two rows turned towards each other. Pointers, as compilers find vectors for them.
void rotate(std::size_t count, float cosine, float sine, float* __restrict a, float* __restrict b) {
  for (std::size_t i = 0; i < count; ++i) {
    const float x = a[i], y = b[i];
    a[i] = cosine * x - sine * y;
    b[i] = sine * x + cosine * y;
  }
}

std::vector<float> transposed(std::size_t rows, std::size_t columns, const std::vector<float>& of) {
  std::vector<float> found(of.size());
  for (std::size_t r = 0; r < rows; ++r)
    for (std::size_t c = 0; c < columns; ++c) found[c * rows + r] = of[r * columns + c];
  return found;
}

void step_one_by_one(const AdamStep& step, std::size_t count, const float* __restrict slopes, float* __restrict first, float* __restrict second, float* __restrict values, float* __restrict mean) {
  for (std::size_t i = 0; i < count; ++i) {
    values[i] -= step.rate * move_of(step, slopes[i], first[i], second[i]);
    mean[i] += (1.0f - step.stays) * (values[i] - mean[i]);
  }
}

void moves_one_by_one(const AdamStep& step, std::size_t count, const float* __restrict slopes, float* __restrict first, float* __restrict second, float* __restrict moves) {
  for (std::size_t i = 0; i < count; ++i) moves[i] = move_of(step, slopes[i], first[i], second[i]);
}

}  // namespace

void take_step(const AdamStep& step, const std::vector<float>& slopes, Moments& moments, std::vector<float>& values, std::vector<float>& mean) {
  step_one_by_one(step, values.size(), slopes.data(), moments.first.data(), moments.second.data(), values.data(), mean.data());
}

TurnedWeights::TurnedWeights(std::size_t column, std::size_t width, std::vector<std::size_t> inputs)
    : column_(column), width_(width), inputs_(std::move(inputs)), size_((inputs_.size() + 7) / 8 * 8), together_(size_ * size_), basis_(size_ * size_),
      moments_{std::vector<float>(size_ * width), std::vector<float>(size_ * width)}, slopes_(size_ * width), moves_(size_ * width) {
  for (std::size_t i = 0; i < size_; ++i) basis_[i * size_ + i] = 1.0f;
}

void TurnedWeights::take_step(const AdamStep& step, std::size_t number, std::size_t sums, const std::vector<float>& slopes, std::vector<float>& values, std::vector<float>& mean) {
  gather(sums, slopes);
  if (number > 0 && number % (number < kTurnEvery ? kTurnEveryAtFirst : kTurnEvery) == 0) turn();
  std::fill(moves_.begin(), moves_.end(), 0.0f);
  add_product(size_, width_, size_, {basis_.data(), size_, 1}, slopes_.data(), moves_.data());
  slopes_.swap(moves_);
  moves_one_by_one(step, slopes_.size(), slopes_.data(), moments_.first.data(), moments_.second.data(), moves_.data());
  std::fill(slopes_.begin(), slopes_.end(), 0.0f);
  add_product(size_, width_, size_, {basis_.data(), 1, size_}, moves_.data(), slopes_.data());
  for (std::size_t i = 0; i < inputs_.size(); ++i)
    for (std::size_t o = 0, at = inputs_[i] * sums + column_; o < width_; ++o, ++at) {
      values[at] -= step.rate * slopes_[i * width_ + o];
      mean[at] += (1.0f - step.stays) * (values[at] - mean[at]);
    }
}

void TurnedWeights::gather(std::size_t sums, const std::vector<float>& slopes) {
  std::fill(slopes_.begin(), slopes_.end(), 0.0f);
  for (std::size_t i = 0; i < inputs_.size(); ++i) std::copy_n(slopes.begin() + static_cast<std::ptrdiff_t>(inputs_[i] * sums + column_), width_, slopes_.begin() + static_cast<std::ptrdiff_t>(i * width_));
  for (float& number : together_) number *= kTogetherDecay;
  std::vector<float> across = transposed(size_, width_, slopes_);
  for (float& number : across) number *= 1.0f - kTogetherDecay;
  add_product(size_, size_, width_, {slopes_.data(), width_, 1}, across.data(), together_.data());
}

// A sweep of Jacobi's rotations: after a few of them directions are eigenvectors, and they follow where these go.
void TurnedWeights::turn() {
  const std::size_t n = size_;
  std::vector<float> half(n * n), left(n * n);  // what goes together, as it is turned
  add_product(n, n, n, {basis_.data(), n, 1}, together_.data(), half.data());
  add_product(n, n, n, {half.data(), n, 1}, transposed(n, n, basis_).data(), left.data());
  for (std::size_t p = 0; p < n; ++p)
    for (std::size_t q = p + 1; q < n; ++q) {
      const float both = left[p * n + q], of_p = left[p * n + p], of_q = left[q * n + q];
      if (!(std::fabs(both) > kAlike * std::sqrt(std::max(of_p, 0.0f)) * std::sqrt(std::max(of_q, 0.0f)))) continue;
      const float twice = (of_q - of_p) / (2.0f * both);
      const float tangent = (twice >= 0.0f ? 1.0f : -1.0f) / (std::fabs(twice) + std::sqrt(1.0f + twice * twice));
      const float cosine = 1.0f / std::sqrt(1.0f + tangent * tangent), sine = tangent * cosine;
      rotate(n, cosine, sine, &left[p * n], &left[q * n]);
      for (std::size_t i = 0; i < n; ++i) rotate(1, cosine, sine, &left[i * n + p], &left[i * n + q]);
      rotate(n, cosine, sine, &basis_[p * n], &basis_[q * n]);
      rotate(width_, cosine, sine, &moments_.first[p * width_], &moments_.first[q * width_]);
    }
  for (std::size_t p = 0; p < n; ++p) {  // what rounding did to their lengths in hours
    float length = 0.0f;
    for (std::size_t i = 0; i < n; ++i) length += basis_[p * n + i] * basis_[p * n + i];
    for (std::size_t i = 0; i < n; ++i) basis_[p * n + i] /= std::sqrt(length);
  }
}

std::vector<TurnedWeights> turned_weights(const Runs& runs, std::size_t sums) {
  std::vector<TurnedWeights> found;
  for (std::size_t block = 0; block < runs.size(); ++block) {
    std::vector<std::size_t> inputs;
    for (const Run& run : runs[block])
      for (std::size_t i = run.from; i < run.to; ++i) inputs.push_back(i);
    const std::size_t column = block * kSums, groups = (inputs.size() + kMostInputs - 1) / kMostInputs;
    for (std::size_t g = 0; g < groups; ++g) {
      const auto at = [&](std::size_t group) { return inputs.begin() + static_cast<std::ptrdiff_t>(inputs.size() * group / groups); };
      found.emplace_back(column, std::min(kSums, sums - column), std::vector<std::size_t>(at(g), at(g + 1)));
    }
  }
  return found;
}

}  // namespace lidarcodec
