#include "packets/assembly.hpp"

#include <cstring>
#include <unordered_map>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

// Largest step, in 0.01 degree, from a lower block to an upper block that still makes one column: the real HDL-64E S3
// fires a lower block and then three upper ones, 9 or 18 steps apart.
constexpr unsigned kPairStep = 50;

std::uint16_t read16(const std::uint8_t* p) { return static_cast<std::uint16_t>(p[0] | (p[1] << 8)); }

void write16(std::uint8_t* p, std::uint16_t v) {
  p[0] = static_cast<std::uint8_t>(v & 0xFF);
  p[1] = static_cast<std::uint8_t>(v >> 8);
}

std::uint8_t code(Role role) { return static_cast<std::uint8_t>(role); }

bool regular(std::uint16_t flag, std::uint16_t azimuth) {
  return (flag == kUpperFlag || flag == kLowerFlag) && azimuth < kAzimuthTurn;
}

// A dual-return packet names every (flag, azimuth) exactly twice; a sensor that stands still does not count as one.
bool dual_return(const std::uint8_t* packet) {
  std::array<std::uint32_t, kBlocks> id;
  bool turning = false;
  for (std::size_t b = 0; b < kBlocks; ++b) {
    const std::uint8_t* block = packet + b * kBlockBytes;
    if (!regular(read16(block), read16(block + 2))) return false;
    id[b] = static_cast<std::uint32_t>(read16(block)) << 16 | read16(block + 2);
    turning |= (id[b] & 0xFFFF) != (id[0] & 0xFFFF);
  }
  if (!turning) return false;
  for (std::size_t b = 0; b < kBlocks; ++b) {
    int same = 0;
    for (std::size_t c = 0; c < kBlocks; ++c) same += id[c] == id[b];
    if (same != 2) return false;
  }
  return true;
}

}  // namespace

Layout layout_of(const std::uint8_t* packet) {
  Layout roles{};
  const bool dual = dual_return(packet);
  bool column = false;                      // a column is open
  bool just_opened = false;                 // by the block right before this one
  std::array<bool, 2> has{}, has_second{};  // halves of the open column: 0 upper, 1 lower
  std::array<std::uint16_t, 2> azimuth_of_half{};
  for (std::size_t b = 0; b < kBlocks; ++b) {
    const std::uint8_t* block = packet + b * kBlockBytes;
    const std::uint16_t flag = read16(block), azimuth = read16(block + 2);
    if (!regular(flag, azimuth)) {
      roles[b] = code(Role::Irregular);
      just_opened = false;
      continue;
    }
    const std::size_t half = flag == kLowerFlag, other = 1 - half;
    if (dual && column && has[half] && !has_second[half] && azimuth_of_half[half] == azimuth) {
      roles[b] = code(half ? Role::LowerSecond : Role::UpperSecond);
      has_second[half] = true;
      // E E D D: the lower block of the firing is still to come, so the column stays joinable.
      continue;
    }
    const unsigned step = static_cast<unsigned>(azimuth + kAzimuthTurn - azimuth_of_half[other]) % kAzimuthTurn;
    if (column && just_opened && !has[half] && has[other] && (step == 0 || (half == 0 && step <= kPairStep))) {
      roles[b] = code(half ? Role::LowerJoins : Role::UpperJoins);
      just_opened = false;
    } else {
      roles[b] = code(half ? Role::LowerOpens : Role::UpperOpens);
      has = {false, false};
      has_second = {false, false};
      column = just_opened = true;
    }
    has[half] = true;
    azimuth_of_half[half] = azimuth;
  }
  return roles;
}

Assembled assemble(const std::uint8_t* payloads, std::size_t bytes, const RingOfLaser& ring_of_laser) {
  if (bytes % kPacketBytes != 0) throw Error(ErrorCode::Packet, "payloads are not a whole number of 1206-byte packets");
  const std::size_t packets = bytes / kPacketBytes;
  if (packets > kMaxPackets) throw Error(ErrorCode::Packet, "more than 2048 packets in one frame");
  for (const std::uint8_t ring : ring_of_laser)
    if (ring >= kRings) throw Error(ErrorCode::Packet, "a laser's ring is not below 64");

  Assembled out;
  out.layout.resize(packets);
  out.gps_us.resize(packets);
  out.status.resize(2 * packets);
  std::unordered_map<std::uint64_t, std::uint16_t> known;  // looked up only, never iterated
  std::size_t irregular = 0, second = 0;
  for (std::size_t p = 0; p < packets; ++p) {
    const std::uint8_t* packet = payloads + p * kPacketBytes;
    const Layout roles = layout_of(packet);
    std::uint64_t key = 0;
    for (const std::uint8_t role : roles) {
      key = key << 3 | role;
      out.width += role == code(Role::UpperOpens) || role == code(Role::LowerOpens);
      irregular += role == code(Role::Irregular);
      second += role == code(Role::UpperSecond) || role == code(Role::LowerSecond);
    }
    const auto [found, fresh] = known.try_emplace(key, static_cast<std::uint16_t>(known.size()));
    if (fresh) out.layouts.insert(out.layouts.end(), roles.begin(), roles.end());
    out.layout[p] = found->second;
    const std::uint8_t* tail = packet + kBlocks * kBlockBytes;
    out.gps_us[p] = static_cast<std::uint32_t>(read16(tail)) | static_cast<std::uint32_t>(read16(tail + 2)) << 16;
    out.status[2 * p] = tail[4];
    out.status[2 * p + 1] = tail[5];
  }

  const std::size_t width = out.width;
  out.range.resize(kRings * width);
  out.intensity.resize(kRings * width);
  out.azimuth.resize(2 * width);
  out.fired.resize(2 * width);
  out.irregular.resize(irregular * kBlockBytes);
  out.second.resize(second * kBlockReturnBytes);
  std::uint8_t* next_irregular = out.irregular.data();
  std::uint8_t* next_second = out.second.data();
  std::size_t columns = 0;  // opened so far; the current column is the one before
  for (std::size_t p = 0; p < packets; ++p) {
    const std::uint8_t* packet = payloads + p * kPacketBytes;
    const std::uint8_t* roles = out.layouts.data() + out.layout[p] * kBlocks;
    for (std::size_t b = 0; b < kBlocks; ++b) {
      const std::uint8_t* block = packet + b * kBlockBytes;
      const Role role = static_cast<Role>(roles[b]);
      if (role == Role::Irregular) {
        std::memcpy(next_irregular, block, kBlockBytes);
        next_irregular += kBlockBytes;
        continue;
      }
      if (role == Role::UpperSecond || role == Role::LowerSecond) {
        std::memcpy(next_second, block + 4, kBlockReturnBytes);
        next_second += kBlockReturnBytes;
        continue;
      }
      const std::size_t half = role == Role::LowerOpens || role == Role::LowerJoins;
      const bool opens = role == Role::UpperOpens || role == Role::LowerOpens;
      if (opens) ++columns;
      const std::size_t column = columns - 1;
      const std::uint16_t azimuth = read16(block + 2);
      out.azimuth[half * width + column] = azimuth;
      if (opens) out.azimuth[(1 - half) * width + column] = azimuth;  // until the other half comes, if it does
      out.fired[half * width + column] = 1;
      const std::uint8_t* value = block + 4;
      const std::uint8_t* ring = ring_of_laser.data() + half * kBlockLasers;
      for (std::size_t i = 0; i < kBlockLasers; ++i, value += 3) {
        const std::size_t cell = ring[i] * width + column;
        out.range[cell] = read16(value);
        out.intensity[cell] = value[2];
      }
    }
  }
  return out;
}

std::vector<std::uint8_t> disassemble(const Images& in, const RingOfLaser& ring_of_laser) {
  const auto misfit = [](const char* what) { throw Error(ErrorCode::Section, what); };
  if (in.packets > kMaxPackets) misfit("more than 2048 packets in one frame");
  for (const std::uint8_t ring : ring_of_laser)
    if (ring >= kRings) misfit("a laser's ring is not below 64");
  for (std::size_t i = 0; i < in.layout_count * kBlocks; ++i)
    if (in.layouts[i] >= kRoles) misfit("a packet layout holds an unknown role");

  const std::size_t width = in.width;
  std::vector<std::uint8_t> out(in.packets * kPacketBytes);
  std::size_t columns = 0, irregular = 0, second = 0;
  for (std::size_t p = 0; p < in.packets; ++p) {
    if (in.layout[p] >= in.layout_count) misfit("a packet names a layout that is not there");
    const std::uint8_t* roles = in.layouts + in.layout[p] * kBlocks;
    std::uint8_t* packet = out.data() + p * kPacketBytes;
    bool open = false;
    for (std::size_t b = 0; b < kBlocks; ++b) {
      std::uint8_t* block = packet + b * kBlockBytes;
      const Role role = static_cast<Role>(roles[b]);
      if (role == Role::Irregular) {
        if (irregular == in.irregular_count) misfit("fewer irregular blocks than the layouts name");
        std::memcpy(block, in.irregular + kBlockBytes * irregular++, kBlockBytes);
        continue;
      }
      const bool opens = role == Role::UpperOpens || role == Role::LowerOpens;
      if (opens) {
        if (columns == width) misfit("fewer columns than the layouts name");
        ++columns;
        open = true;
      }
      if (!open) misfit("a packet layout joins a column that is not open");
      const std::size_t column = columns - 1;
      const std::size_t half = role == Role::LowerOpens || role == Role::LowerJoins || role == Role::LowerSecond;
      if (!in.fired[half * width + column]) misfit("a packet layout names a half column that was not fired");
      write16(block, half ? kLowerFlag : kUpperFlag);
      write16(block + 2, in.azimuth[half * width + column]);
      if (role == Role::UpperSecond || role == Role::LowerSecond) {
        if (second == in.second_count) misfit("fewer second returns than the layouts name");
        std::memcpy(block + 4, in.second + kBlockReturnBytes * second++, kBlockReturnBytes);
        continue;
      }
      std::uint8_t* value = block + 4;
      const std::uint8_t* ring = ring_of_laser.data() + half * kBlockLasers;
      for (std::size_t i = 0; i < kBlockLasers; ++i, value += 3) {
        const std::size_t cell = ring[i] * width + column;
        write16(value, in.range[cell]);
        value[2] = in.intensity[cell];
      }
    }
    std::uint8_t* tail = packet + kBlocks * kBlockBytes;
    write16(tail, static_cast<std::uint16_t>(in.gps_us[p] & 0xFFFF));
    write16(tail + 2, static_cast<std::uint16_t>(in.gps_us[p] >> 16));
    tail[4] = in.status[2 * p];
    tail[5] = in.status[2 * p + 1];
  }
  if (columns != width || irregular != in.irregular_count || second != in.second_count)
    misfit("more columns or blocks than the packet layouts name");
  return out;
}

}  // namespace lidarcodec
