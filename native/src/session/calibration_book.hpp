// Sensors that the key messages of a stream described, by hash; the last eight are kept. Other messages have the hash
// alone (docs/wire-format.md, "Calibration").
#pragma once
#include <algorithm>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "base/sha256.hpp"
#include "session/message.hpp"

namespace lidarcodec {

inline constexpr std::size_t kHashBytes = 8;

template <class Described>
class CalibrationBook {
 public:
  // The sensor of a message. takes: whether a sensor is described in a form; read: makes it of the section's bytes,
  // with the hash of what it found. Raises Section, or Reference if the message names one that no key message
  // described.
  template <class Takes, class Read>
  std::shared_ptr<const Described> of(const Message& message, const Takes& takes, const Read& read) {
    constexpr std::uint8_t kFormHash = 0;
    const Bytes data = message.section(SectionType::Calibration);
    if (data.size() < 1 + kHashBytes || (data[0] != kFormHash && !takes(data[0])))
      throw Error(ErrorCode::Section,
                  "a calibration section of " + std::to_string(data.size()) + " bytes, or of an unknown form");
    const std::string name = hex(data.subspan(1, kHashBytes));
    auto found =
        std::find_if(known_.begin(), known_.end(), [&](const Known& known) { return known.sensor->hash == name; });
    Known used;
    if (found != known_.end()) used = *found;
    if (data[0] == kFormHash) {
      if (data.size() != 1 + kHashBytes)
        throw Error(ErrorCode::Section, std::to_string(data.size()) + " bytes for a calibration's hash");
      if (used.sensor == nullptr)
        throw Error(ErrorCode::Reference,
                    "frame " + std::to_string(message.frame_index) + " needs calibration " + name +
                        ", which no key frame has brought yet: ask for a key frame",
                    message.frame_index);
    } else if (used.sensor == nullptr || !std::equal(data.begin(), data.end(), used.data.begin(), used.data.end())) {
      used = {{data.begin(), data.end()}, read(data)};
      if (used.sensor->hash != name)
        throw Error(ErrorCode::Section, "a calibration with hash " + used.sensor->hash + " that calls itself " + name);
    }
    if (found != known_.end()) known_.erase(found);
    known_.push_back(used);
    if (known_.size() > kKept) known_.pop_front();
    return used.sensor;
  }

 private:
  static constexpr std::size_t kKept = 8;
  struct Known {
    std::vector<std::uint8_t> data;
    std::shared_ptr<const Described> sensor;
  };
  std::deque<Known> known_;  // the one used last is at the end
};

}  // namespace lidarcodec
