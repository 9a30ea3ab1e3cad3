#include "packets/udp_senders.hpp"

#include <algorithm>
#include <tuple>

namespace lidarcodec {
namespace {

constexpr std::size_t kBlocks = 12, kBlockBytes = 100, kTime = 1200, kMode = 1204, kModel = 1205;
constexpr int kUpper = 0xEEFF, kLower = 0xDDFF, kThird = 0xCCFF, kFourth = 0xBBFF, kNone = 0xFFFF;
constexpr int kTurn = 36000;       // 0.01 degree
constexpr int kMaxAdvance = 1500;  // a sensor turns 0.5 to 2.1 degrees a packet; some packets may be lost
constexpr std::uint32_t kMaxPauseUs = 5000;
constexpr std::uint32_t kHourUs = 3'600'000'000;
constexpr std::array<std::uint8_t, 7> kOtherModels = {0x21, 0x22, 0x23, 0x24, 0x28, 0x31, 0xA1};
constexpr std::uint8_t kVls128 = 0xA1;

int word(const std::uint8_t* at) { return at[0] | at[1] << 8; }

std::uint32_t time_us(const std::uint8_t* payload) {
  const std::uint8_t* at = payload + kTime;
  return static_cast<std::uint32_t>(word(at)) | static_cast<std::uint32_t>(word(at + 2)) << 16;
}

// Azimuth of the first block, or -1 if these are not the blocks of an HDL-64E.
int azimuth_of(const std::uint8_t* payload) {
  for (std::size_t block = 0; block < kBlocks; ++block) {
    const std::uint8_t* at = payload + block * kBlockBytes;
    const int flag = word(at);
    if ((flag != kUpper && flag != kLower) || word(at + 2) >= kTurn) return -1;
  }
  return word(payload + 2);
}

}  // namespace

bool other_sensor(const std::uint8_t* payload) {
  const std::uint8_t mode = payload[kMode], model = payload[kModel];
  if (mode < 0x37 || mode > 0x39) return false;
  if (std::find(kOtherModels.begin(), kOtherModels.end(), model) == kOtherModels.end()) return false;
  bool upper = false, lower = false, third = false, fourth = false;
  for (std::size_t block = 0; block < kBlocks; ++block) {
    const int flag = word(payload + block * kBlockBytes);
    upper |= flag == kUpper;
    lower |= flag == kLower;
    third |= flag == kThird;
    fourth |= flag == kFourth;
    const bool vls =
        flag == kUpper || flag == kLower || flag == kThird || flag == kFourth || flag == kNone || flag == 0;
    if (model == kVls128 ? !vls : flag != kUpper) return false;
  }
  return model != kVls128 || (upper && lower && third && fourth);
}

SenderJudge::SenderJudge(std::span<const std::uint8_t> pinned, bool all)
    : pinned_(pinned.begin(), pinned.end()), all_(all) {
  senders_.reserve(kMaxSenders);
}

SenderVerdict SenderJudge::judge(const std::uint8_t* payload, const SenderAddress& from, std::int64_t now_ns,
                                 std::uint32_t& id) {
  if (!pinned_.empty() &&
      !std::equal(pinned_.begin(), pinned_.end(), from.bytes.begin(), from.bytes.begin() + from.size)) {
    ++refused_;
    ++not_pinned_;
    last_not_pinned_ = from;
    return SenderVerdict::Refuse;
  }
  if (chosen_ == 0 && other_sensor(payload)) {
    ++other_;
    return SenderVerdict::OtherSensor;
  }
  turn_windows(now_ns);
  Sender& sender = known(from, now_ns);
  look(sender, payload);
  id = sender.id;
  if (chosen_ == 0) {
    if (first_ns_ < 0) first_ns_ = now_ns;
    if (all_ || (sender.now.consistent + sender.last.consistent >= kProof && alone(sender))) {
      choose(sender, SenderReason::First, now_ns);
    } else if (!settle(now_ns)) {
      ++sender.kept;
      return SenderVerdict::Hold;
    }
  } else if (!all_ && sender.id != chosen_ && beats_chosen(sender, now_ns)) {
    ++changes_;
  }
  if (!all_ && sender.id != chosen_) {
    ++sender.refused;
    ++refused_;
    return SenderVerdict::Refuse;
  }
  ++sender.kept;
  return SenderVerdict::Keep;
}

bool SenderJudge::settle(std::int64_t now_ns) {
  if (chosen_ != 0 || first_ns_ < 0 || now_ns < decide_ns() || senders_.empty()) return false;
  const auto weight = [](const Sender& s) {
    const std::uint32_t both = recent(s);
    return std::tuple(score({both, s.now.consistent + s.last.consistent}, 2), both, ~s.id);  // then who came first
  };
  choose(*std::max_element(senders_.begin(), senders_.end(),
                           [&](const Sender& a, const Sender& b) { return weight(a) < weight(b); }),
         SenderReason::First, now_ns);
  return true;
}

void SenderJudge::drop(std::uint32_t id) {
  ++refused_;
  for (Sender& s : senders_) {
    if (s.id != id) continue;
    --s.kept;
    ++s.refused;
  }
}

std::vector<SenderReport> SenderJudge::report() const {
  std::vector<SenderReport> found;
  for (const Sender& s : senders_) found.push_back({s.id, s.address, s.kept, s.refused, score(s.last, 1)});
  return found;
}

// Evidence of so many windows as a number that more packets than a sensor's can only lower.
std::uint32_t SenderJudge::score(const Evidence& evidence, std::uint32_t windows) {
  return evidence.packets > kMost * windows ? 0 : std::min(evidence.consistent, kFull * windows);
}

std::uint32_t SenderJudge::recent(const Sender& sender) { return sender.now.packets + sender.last.packets; }

// Count a packet, and whether it goes on from the one before it: the azimuth advances a little, or the rotor stands and
// the sensor's own clock advances a little.
void SenderJudge::look(Sender& sender, const std::uint8_t* payload) {
  const int azimuth = azimuth_of(payload);
  const std::uint32_t gps_us = time_us(payload);
  ++sender.now.packets;
  if (azimuth >= 0 && sender.azimuth >= 0) {
    const int advance = (azimuth - sender.azimuth + kTurn) % kTurn;
    const std::uint32_t pause_us = gps_us >= sender.gps_us ? gps_us - sender.gps_us : gps_us + kHourUs - sender.gps_us;
    const bool runs = pause_us > 0 && pause_us <= kMaxPauseUs;
    sender.now.consistent += advance == 0 ? runs : advance <= kMaxAdvance;
  }
  sender.proven |= sender.now.consistent + sender.last.consistent >= kProof;
  sender.azimuth = azimuth;
  sender.gps_us = gps_us;
}

SenderJudge::Sender& SenderJudge::known(const SenderAddress& from, std::int64_t now_ns) {
  auto found = std::find_if(senders_.begin(), senders_.end(), [&](const Sender& s) { return s.address == from; });
  if (found == senders_.end()) {
    if (senders_.size() < kMaxSenders) {
      found = senders_.insert(found, Sender{});
    } else {
      found = std::min_element(senders_.begin(), senders_.end(), [this](const Sender& a, const Sender& b) {
        return std::tuple(a.id == chosen_, recent(a), a.heard_ns) < std::tuple(b.id == chosen_, recent(b), b.heard_ns);
      });
      *found = Sender{};
    }
    found->id = next_id_++;
    found->address = from;
  }
  found->heard_ns = now_ns;
  return *found;
}

void SenderJudge::turn_windows(std::int64_t now_ns) {
  const std::int64_t passed = (now_ns - window_ns_) / kWindowNs;
  if (passed < 1) return;
  for (Sender& s : senders_) {
    s.last = passed == 1 ? s.now : Evidence{};
    s.now = {};
  }
  window_ns_ = passed == 1 ? window_ns_ + kWindowNs : now_ns;
}

void SenderJudge::choose(const Sender& sender, SenderReason reason, std::int64_t now_ns) {
  chosen_ = sender.id;
  chosen_ns_ = now_ns;
  reason_ = reason;
}

// Whether nobody else has shown a fourth of what this sender has.
bool SenderJudge::alone(const Sender& sender) const {
  const auto shown = [](const Sender& s) { return s.now.consistent + s.last.consistent; };
  return std::all_of(senders_.begin(), senders_.end(), [&](const Sender& other) {
    return other.id == sender.id || shown(other) * kClearly <= shown(sender);
  });
}

// Whether this sender takes the place of the one chosen, which is then done.
bool SenderJudge::beats_chosen(const Sender& sender, std::int64_t now_ns) {
  const auto holder =
      std::find_if(senders_.begin(), senders_.end(), [this](const Sender& s) { return s.id == chosen_; });
  const bool silent = now_ns - holder->heard_ns >= kSilenceNs;
  const bool shows = sender.now.consistent + sender.last.consistent >= kProof;
  if (shows && (silent || (!holder->proven && alone(sender)))) {
    choose(sender, silent ? SenderReason::Silent : SenderReason::Implausible, now_ns);
    return true;
  }
  // Of whole windows only, the last one behind the choice, for bursts prove nothing; and a short pause is no reason.
  if (holder->last.packets == 0) return false;
  const std::uint32_t theirs = score(sender.last, 1);
  if (now_ns - chosen_ns_ < 2 * kWindowNs || theirs < kRival || theirs < kClearly * score(holder->last, 1))
    return false;
  choose(sender, SenderReason::Implausible, now_ns);
  return true;
}

}  // namespace lidarcodec
