// Weights that a session knows: those given from outside, by name, and the last few that its stream has brought.
#pragma once
#include <deque>
#include <memory>
#include <string>

#include "network/weight_file.hpp"
#include "session/message.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

class Shelf {
 public:
  using Weights = std::shared_ptr<const WeightFile>;

  // Takes the WEIGHTS sections of a message, in order: one file and one update at most. Raises Section, Reference, or
  // as read_weights and applied_update do.
  void take_all(const Message& message, const Outside& outside);

  // The weights of a name, for a frame. Raises Reference if they are not here, or as read_weights does for those of
  // outside.
  Weights find(const std::string& name, std::uint64_t frame, const Outside& outside);

  // Name of weights that a message needs and that are neither here nor in it; "" if there are none. name: those of its
  // ranges.
  std::string missing(const Message& message, const std::string& name, const Outside& outside) const;

  // Forgets what a stream has brought.
  void forget() { brought_.clear(); }

 private:
  static constexpr std::size_t kKept = 4;

  static Weights used(std::deque<Weights>& kept, const std::string& name);
  static void put(std::deque<Weights>& kept, Weights weights);
  bool has(const std::string& name) const;

  std::deque<Weights> brought_, given_;  // the one used last is at the end
};

}  // namespace lidarcodec
