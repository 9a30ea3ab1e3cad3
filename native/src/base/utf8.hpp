// Whether bytes are UTF-8 (RFC 3629): no surrogates, none longer than it has to be, none beyond U+10FFFF.
#pragma once
#include "base/bytes.hpp"

namespace lidarcodec {

bool is_utf8(Bytes text);

}  // namespace lidarcodec
