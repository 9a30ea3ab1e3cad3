// Updates of weights: what networks became that were trained in a stream (docs/wire-format-riddle-weights.md,
// "Updates"), in Python lidarcodec/network/update.py.
#pragma once
#include <functional>
#include <string>

#include "network/weight_file.hpp"

namespace lidarcodec {

// Whether the bytes of a WEIGHTS section are an update, and not a file.
bool is_update(Bytes data);

struct UpdateNames {
  std::string of, to;  // names of the weights that it begins with, and of those that it gives
};

// Raises Truncated, Version or Checksum.
UpdateNames names_of_update(Bytes data);

// The weights that an update gives, from anybody. find: weights by name. Raises what `find` does, else as
// names_of_update, or Section.
WeightFile applied_update(Bytes data, const std::function<const WeightFile&(const std::string&)>& find);

}  // namespace lidarcodec
