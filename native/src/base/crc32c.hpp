// CRC-32C (Castagnoli, polynomial 0x1EDC6F41 reflected), as in RFC 3720 appendix B.4.
#pragma once
#include <cstddef>
#include <cstdint>

namespace lidarcodec {

// Checksum of `size` bytes; pass an earlier result as `seed` to go on.
std::uint32_t crc32c(const std::uint8_t* data, std::size_t size, std::uint32_t seed = 0);

}  // namespace lidarcodec
