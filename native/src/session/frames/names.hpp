// Names in sections of other sensors than an HDL-64E.
#pragma once
#include <algorithm>
#include <string_view>

#include "base/bytes.hpp"

namespace lidarcodec {

// Whether a name is of ASCII letters, digits, underscores and the characters in `also`.
inline bool is_plain_name(Bytes name, std::string_view also = "") {
  return std::all_of(name.begin(), name.end(), [&](std::uint8_t one) {
    return (one >= '0' && one <= '9') || (one >= 'A' && one <= 'Z') || (one >= 'a' && one <= 'z') || one == '_' ||
           also.find(static_cast<char>(one)) != std::string_view::npos;
  });
}

}  // namespace lidarcodec
