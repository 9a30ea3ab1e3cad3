// SHA-256 (FIPS 180-4): names of calibrations and of weights are its first bytes.
#pragma once
#include <array>
#include <cstdint>

#include "base/bytes.hpp"

namespace lidarcodec {

std::array<std::uint8_t, 32> sha256(Bytes data);

// "0a1b..." of bytes.
std::string hex(Bytes data);

}  // namespace lidarcodec
