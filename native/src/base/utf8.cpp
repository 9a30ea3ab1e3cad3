#include "base/utf8.hpp"

namespace lidarcodec {

bool is_utf8(Bytes text) {
  for (std::size_t i = 0; i < text.size();) {
    const std::uint8_t first = text[i++];
    if (first < 0x80) continue;
    const std::size_t more = first >= 0xF0 ? 3 : first >= 0xE0 ? 2 : 1;
    if (first < 0xC2 || first > 0xF4 || text.size() - i < more) return false;
    std::uint32_t point = first & (0x3Fu >> more);
    for (std::size_t j = 0; j < more; ++j, ++i) {
      if ((text[i] & 0xC0) != 0x80) return false;
      point = point << 6 | (text[i] & 0x3Fu);
    }
    if (point > 0x10FFFF || (point >= 0xD800 && point < 0xE000) || (more == 2 && point < 0x800) ||
        (more == 3 && point < 0x10000))
      return false;
  }
  return true;
}

}  // namespace lidarcodec
