// Logistic mixing of several models (Mahoney 2005), as bits/bitmodel.hpp has it for two. In integers, so every machine
// gives the same bytes.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bits/bitmodel.hpp"

namespace lidarcodec {

// One decision: the models that its contexts name, their mix, and the update of all of them.
template <std::size_t kModels>
class Mix {
 public:
  Mix() { weights_.fill(kFirst); }

  template <class Bits>
  bool code(Bits& bits, bool wanted, const std::array<BitModel*, kModels>& models) {
    std::array<std::int32_t, kModels> odds;
    std::int64_t sum = 0;
    for (std::size_t i = 0; i < kModels; ++i) {
      odds[i] = kStretch[models[i]->raw() >> 20];
      sum += static_cast<std::int64_t>(weights_[i]) * odds[i];
    }
    const auto place = static_cast<std::size_t>(std::clamp<std::int64_t>(sum >> 16, -2048, 2047) + 2048);
    const std::uint32_t p = std::clamp<std::uint32_t>(kSquash[place], kMinProbability, 65536u - kMinProbability);
    const bool bit = bits.bit(wanted, p);
    const std::int32_t error = (bit ? 65536 : 0) - static_cast<std::int32_t>(p);
    for (std::size_t i = 0; i < kModels; ++i) {
      weights_[i] = std::clamp(weights_[i] + ((error * odds[i] + 0x2000) >> 14), -kMost, kMost);
      models[i]->update(bit);
    }
    return bit;
  }

 private:
  static constexpr std::int32_t kFirst = 65536 / static_cast<std::int32_t>(kModels);
  static constexpr std::int32_t kMost = 1 << 19;  // 8.0
  std::array<std::int32_t, kModels> weights_;
};

// Models by context, all of them fresh at first.
class Models {
 public:
  explicit Models(std::size_t contexts) : models_(contexts) {}
  BitModel* at(std::size_t context) { return &models_[context]; }

 private:
  std::vector<BitModel> models_;
};

}  // namespace lidarcodec
