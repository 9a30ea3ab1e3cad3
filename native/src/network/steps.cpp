#include "network/steps.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace lidarcodec {
namespace {

constexpr float kEpsilon = 1e-6f;
constexpr std::size_t kOutputs = 16;
constexpr std::size_t kMaxInputs = 64;  // of a group: the time of an update grows with their third power
constexpr std::size_t kUpdateEvery = 100, kUpdateEveryAtFirst = 20;  // steps
constexpr float kSecondMomentDecay = 0.99f;
constexpr float kLeastCorrelation = 0.05f;  // directions that are less correlated are not rotated

// Updates the moments of a gradient, and gives Adam's step for a learning rate of 1.
float adam_step_of(const AdamStep& step, float gradient, float& first, float& second) {
  first += (1.0f - kBeta1) * (gradient - first);
  second += (1.0f - kBeta2) * (gradient * gradient - second);
  return first * step.first / (std::sqrt(second * step.second) + kEpsilon);
}

// A Givens rotation of two rows.
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

void adam_update(const AdamStep& step, std::size_t count, const float* __restrict gradients, float* __restrict first,
                 float* __restrict second, float* __restrict values, float* __restrict mean) {
  for (std::size_t i = 0; i < count; ++i) {
    values[i] -= step.rate * adam_step_of(step, gradients[i], first[i], second[i]);
    mean[i] += (1.0f - step.stays) * (values[i] - mean[i]);
  }
}

void adam_steps(const AdamStep& step, std::size_t count, const float* __restrict gradients, float* __restrict first,
                float* __restrict second, float* __restrict steps) {
  for (std::size_t i = 0; i < count; ++i) steps[i] = adam_step_of(step, gradients[i], first[i], second[i]);
}

}  // namespace

void take_step(const AdamStep& step, const std::vector<float>& gradients, Moments& moments, std::vector<float>& values,
               std::vector<float>& mean) {
  adam_update(step, values.size(), gradients.data(), moments.first.data(), moments.second.data(), values.data(),
              mean.data());
}

RotatedWeights::RotatedWeights(std::size_t column, std::size_t width, std::vector<std::size_t> inputs)
    : column_(column),
      width_(width),
      inputs_(std::move(inputs)),
      size_((inputs_.size() + 7) / 8 * 8),
      second_moments_(size_ * size_),
      basis_(size_ * size_),
      moments_{std::vector<float>(size_ * width), std::vector<float>(size_ * width)},
      gradient_(size_ * width),
      steps_(size_ * width) {
  for (std::size_t i = 0; i < size_; ++i) basis_[i * size_ + i] = 1.0f;
}

void RotatedWeights::take_step(const AdamStep& step, std::size_t number, std::size_t outputs,
                               const std::vector<float>& gradients, std::vector<float>& values,
                               std::vector<float>& mean) {
  gather(outputs, gradients);
  if (number > 0 && number % (number < kUpdateEvery ? kUpdateEveryAtFirst : kUpdateEvery) == 0) update_basis();
  std::fill(steps_.begin(), steps_.end(), 0.0f);
  add_product(size_, width_, size_, {basis_.data(), size_, 1}, gradient_.data(), steps_.data());
  gradient_.swap(steps_);
  adam_steps(step, gradient_.size(), gradient_.data(), moments_.first.data(), moments_.second.data(), steps_.data());
  std::fill(gradient_.begin(), gradient_.end(), 0.0f);
  add_product(size_, width_, size_, {basis_.data(), 1, size_}, steps_.data(), gradient_.data());
  for (std::size_t i = 0; i < inputs_.size(); ++i)
    for (std::size_t o = 0, at = inputs_[i] * outputs + column_; o < width_; ++o, ++at) {
      values[at] -= step.rate * gradient_[i * width_ + o];
      mean[at] += (1.0f - step.stays) * (values[at] - mean[at]);
    }
}

void RotatedWeights::gather(std::size_t outputs, const std::vector<float>& gradients) {
  std::fill(gradient_.begin(), gradient_.end(), 0.0f);
  for (std::size_t i = 0; i < inputs_.size(); ++i)
    std::copy_n(gradients.begin() + static_cast<std::ptrdiff_t>(inputs_[i] * outputs + column_), width_,
                gradient_.begin() + static_cast<std::ptrdiff_t>(i * width_));
  for (float& number : second_moments_) number *= kSecondMomentDecay;
  std::vector<float> across = transposed(size_, width_, gradient_);
  for (float& number : across) number *= 1.0f - kSecondMomentDecay;
  add_product(size_, size_, width_, {gradient_.data(), width_, 1}, across.data(), second_moments_.data());
}

// One sweep of Jacobi's eigenvalue algorithm (Golub and Van Loan, Matrix Computations, section 8.5). After a few sweeps
// the directions are eigenvectors, and they follow when these change.
void RotatedWeights::update_basis() {
  const std::size_t n = size_;
  std::vector<float> half(n * n), rotated(n * n);  // second moments in the rotated basis
  add_product(n, n, n, {basis_.data(), n, 1}, second_moments_.data(), half.data());
  add_product(n, n, n, {half.data(), n, 1}, transposed(n, n, basis_).data(), rotated.data());
  for (std::size_t p = 0; p < n; ++p)
    for (std::size_t q = p + 1; q < n; ++q) {
      const float both = rotated[p * n + q], of_p = rotated[p * n + p], of_q = rotated[q * n + q];
      if (!(std::fabs(both) > kLeastCorrelation * std::sqrt(std::max(of_p, 0.0f)) * std::sqrt(std::max(of_q, 0.0f))))
        continue;
      const float twice = (of_q - of_p) / (2.0f * both);
      const float tangent = (twice >= 0.0f ? 1.0f : -1.0f) / (std::fabs(twice) + std::sqrt(1.0f + twice * twice));
      const float cosine = 1.0f / std::sqrt(1.0f + tangent * tangent), sine = tangent * cosine;
      rotate(n, cosine, sine, &rotated[p * n], &rotated[q * n]);
      for (std::size_t i = 0; i < n; ++i) rotate(1, cosine, sine, &rotated[i * n + p], &rotated[i * n + q]);
      rotate(n, cosine, sine, &basis_[p * n], &basis_[q * n]);
      rotate(width_, cosine, sine, &moments_.first[p * width_], &moments_.first[q * width_]);
    }
  for (std::size_t p = 0; p < n; ++p) {  // normalises the directions, whose lengths drift by rounding
    float length = 0.0f;
    for (std::size_t i = 0; i < n; ++i) length += basis_[p * n + i] * basis_[p * n + i];
    for (std::size_t i = 0; i < n; ++i) basis_[p * n + i] /= std::sqrt(length);
  }
}

std::vector<RotatedWeights> rotated_weights(const Runs& runs, std::size_t outputs) {
  std::vector<RotatedWeights> found;
  for (std::size_t block = 0; block < runs.size(); ++block) {
    std::vector<std::size_t> inputs;
    for (const Run& run : runs[block])
      for (std::size_t i = run.from; i < run.to; ++i) inputs.push_back(i);
    const std::size_t column = block * kOutputs, groups = (inputs.size() + kMaxInputs - 1) / kMaxInputs;
    for (std::size_t g = 0; g < groups; ++g) {
      const auto at = [&](std::size_t group) {
        return inputs.begin() + static_cast<std::ptrdiff_t>(inputs.size() * group / groups);
      };
      found.emplace_back(column, std::min(kOutputs, outputs - column), std::vector<std::size_t>(at(g), at(g + 1)));
    }
  }
  return found;
}

}  // namespace lidarcodec
