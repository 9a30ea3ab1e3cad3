// Names in sections of other sensors than an HDL-64E.
#pragma once
#include <algorithm>

#include "base/bytes.hpp"

namespace lidarcodec {

// Whether a name is of ASCII letters, digits and underscores.
inline bool is_plain_name(Bytes name) {
  return std::all_of(name.begin(), name.end(), [](std::uint8_t one) {
    return (one >= '0' && one <= '9') || (one >= 'A' && one <= 'Z') || (one >= 'a' && one <= 'z') || one == '_';
  });
}

}  // namespace lidarcodec
