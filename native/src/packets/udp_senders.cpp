#include "packets/udp_senders.hpp"

#include <algorithm>
#include <tuple>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kBlocks = 12, kBlockBytes = 100, kTime = 1200, kHdl64eBytes = 1206;
constexpr int kUpper = 0xEEFF, kLower = 0xDDFF;
constexpr int kTurn = 36000;       // 0.01 degree
constexpr int kMaxAdvance = 1500;  // a sensor turns 0.5 to 2.1 degrees a packet; some packets may be lost
constexpr std::uint32_t kMaxPauseUs = 5000;
constexpr std::uint32_t kHourUs = 3'600'000'000;
constexpr std::uint32_t kMaxPartOfTurn = 8;  // a packet holds less than an eighth of a turn

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

bool PacketShape::fits(std::span<const std::uint8_t> payload) const {
  return payload.size() == size &&
         std::all_of(marks.begin(), marks.end(), [&](const Mark& mark) { return payload[mark.offset] == mark.value; });
}

int PacketShape::position(std::span<const std::uint8_t> payload) const {
  const int at = word(payload.data() + turn_offset);
  return static_cast<std::uint32_t>(at) < span ? at : -1;
}

// A little further in the turn, or in the same turn or the next one.
bool PacketShape::goes_on(int before, int position) const {
  if (before < 0 || position < 0) return false;
  const std::uint32_t advance = (static_cast<std::uint32_t>(position - before) + span) % span;
  return counts ? advance <= 1 : advance > 0 && advance <= span / kMaxPartOfTurn;
}

SenderJudge::SenderJudge(std::span<const std::uint8_t> pinned, bool all, std::vector<PacketShape> shapes, bool hdl64e)
    : pinned_(pinned.begin(), pinned.end()), all_(all), hdl64e_(hdl64e), shapes_(std::move(shapes)) {
  senders_.reserve(kMaxSenders);
  for (const PacketShape& shape : shapes_) {
    const bool inside = shape.size >= 2 && shape.turn_offset <= shape.size - 2 && shape.span >= 2 &&
                        shape.span <= 0x10000 &&
                        std::all_of(shape.marks.begin(), shape.marks.end(),
                                    [&](const PacketShape::Mark& mark) { return mark.offset < shape.size; });
    if (!inside) throw Error(ErrorCode::Settings, "a packet shape that does not fit into its packet");
  }
}

bool SenderJudge::knows_size(std::size_t size) const {
  return size == kHdl64eBytes ||
         std::any_of(shapes_.begin(), shapes_.end(), [size](const PacketShape& shape) { return shape.size == size; });
}

SenderVerdict SenderJudge::judge(std::span<const std::uint8_t> payload, const SenderAddress& from, std::int64_t now_ns,
                                 std::uint32_t& id) {
  if (!pinned_.empty() &&
      !std::equal(pinned_.begin(), pinned_.end(), from.bytes.begin(), from.bytes.begin() + from.size)) {
    ++refused_;
    ++not_pinned_;
    last_not_pinned_ = from;
    return SenderVerdict::Refuse;
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
    const Evidence evidence{both, s.now.consistent + s.last.consistent, s.now.shaped + s.last.shaped};
    return std::tuple(score(evidence, 2), both, ~s.id);  // then who came first
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

// Evidence of so many windows as a number that more packets than a sensor's can only lower. Sensors beside the HDL-64E
// send at many rates, so their part of consistent packets counts.
std::uint32_t SenderJudge::score(const Evidence& evidence, std::uint32_t windows) {
  const std::uint32_t most = evidence.shaped > 0 ? kMostShaped : kMost;
  if (evidence.packets > most * windows) return 0;
  if (evidence.shaped >= kFew * windows && 2 * evidence.shaped > evidence.consistent)
    return kFull * windows * evidence.consistent / evidence.packets;
  return std::min(evidence.consistent, kFull * windows);
}

std::uint32_t SenderJudge::recent(const Sender& sender) { return sender.now.packets + sender.last.packets; }

// Count a packet, and whether it goes on from the one before it: the azimuth advances a little, or the rotor stands and
// the sensor's own clock advances a little.
void SenderJudge::look(Sender& sender, std::span<const std::uint8_t> payload) const {
  ++sender.now.packets;
  const auto shape =
      std::find_if(shapes_.begin(), shapes_.end(), [payload](const PacketShape& one) { return one.fits(payload); });
  if (shape != shapes_.end() && !shape->wanted) {
    sender.shape = nullptr;
    sender.azimuth = sender.position = -1;
  } else if (shape != shapes_.end()) {
    const int position = shape->position(payload);
    const bool goes_on = sender.shape == &*shape && shape->goes_on(sender.position, position);
    sender.now.consistent += goes_on;
    sender.now.shaped += goes_on;
    sender.shape = &*shape;
    sender.position = position;
    sender.azimuth = -1;
  } else if (hdl64e_ && payload.size() == kHdl64eBytes) {
    const int azimuth = azimuth_of(payload.data());
    const std::uint32_t gps_us = time_us(payload.data());
    if (azimuth >= 0 && sender.azimuth >= 0) {
      const int advance = (azimuth - sender.azimuth + kTurn) % kTurn;
      const std::uint32_t pause_us =
          gps_us >= sender.gps_us ? gps_us - sender.gps_us : gps_us + kHourUs - sender.gps_us;
      const bool runs = pause_us > 0 && pause_us <= kMaxPauseUs;
      sender.now.consistent += advance == 0 ? runs : advance <= kMaxAdvance;
    }
    sender.azimuth = azimuth;
    sender.gps_us = gps_us;
    sender.shape = nullptr;
  }
  sender.proven |= sender.now.consistent + sender.last.consistent >= kProof;
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
  // Of whole windows only, the last one behind the choice, for bursts prove nothing; and a short pause is no reason,
  // nor are the few packets of the window in which it began.
  if (holder->last.packets == 0 || now_ns - holder->heard_ns >= kPauseNs) return false;
  const std::uint32_t theirs = score(sender.last, 1);
  if (now_ns - chosen_ns_ < 2 * kWindowNs || theirs < kRival || theirs < kClearly * score(holder->last, 1))
    return false;
  choose(sender, SenderReason::Implausible, now_ns);
  return true;
}

}  // namespace lidarcodec
