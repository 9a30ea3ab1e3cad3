// Which of those that send to a socket is the sensor. It is judged by what each sent lately, never by who came first,
// and the choice is revised: a forged packet cannot keep a sensor out, and many forged senders cannot fill the table.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace lidarcodec {

constexpr std::size_t kMaxSenders = 64;             // told apart; the one with the least evidence gives way
constexpr std::int64_t kWindowNs = 100'000'000;     // evidence is counted in windows of this length
constexpr std::int64_t kDecideNs = 2 * kWindowNs;   // from the first packet to a choice, however little was seen
constexpr std::int64_t kSilenceNs = 1'000'000'000;  // a sensor that sends nothing for so long may be replaced
constexpr std::uint32_t kProof = 32;                // packets that hang together: 9 ms of an HDL-64E
constexpr std::uint32_t kRival = 64;                // such packets in a window that make a sender a rival
constexpr std::uint32_t kFull = 300;                // more than these in a window prove nothing more (a sensor: 347)
constexpr std::uint32_t kMost = 1200;  // packets in a window beyond which this is no sensor (dual return: 579)
constexpr std::uint32_t kClearly = 4;  // times as much evidence as the other

// An IP address of 4 or 16 bytes, and a port.
struct SenderAddress {
  std::array<std::uint8_t, 16> bytes{};
  std::uint8_t size = 0;
  std::uint16_t port = 0;
  bool operator==(const SenderAddress&) const = default;
};

// What is known of one sender. `score` is its evidence in the last whole window, 0 to kFull.
struct SenderReport {
  std::uint32_t id = 0;
  SenderAddress address;
  std::uint64_t kept = 0, refused = 0;
  std::uint32_t score = 0;
};

// The numbers of both stand in lidarcodec/sources/udp/senders.py, too.
enum class SenderVerdict { Keep, Hold, Refuse, OtherSensor };
enum class SenderReason : std::uint8_t { None, First, Silent, Implausible };

// Whether a payload of 1206 bytes is positively one of another Velodyne sensor, as lidarcodec/sensors/table.py tells.
bool other_sensor(const std::uint8_t* payload);

class SenderJudge {
 public:
  // pinned: address of the only sender that is listened to, empty for any;  all: keep packets of every sender
  SenderJudge(std::span<const std::uint8_t> pinned, bool all);

  // What to do with a packet that came at this time of a steady clock. `id` is set for Keep and Hold.
  SenderVerdict judge(const std::uint8_t* payload, const SenderAddress& from, std::int64_t now_ns, std::uint32_t& id);
  // Choose, if packets are held and the time for it has come; whether a sender was chosen.
  bool settle(std::int64_t now_ns);
  // Count a packet that was held, and belongs to another sender than the one chosen.
  void drop(std::uint32_t id);

  bool keeps_all() const { return all_; }
  std::uint32_t chosen() const { return chosen_; }  // id, or 0 while none is
  std::int64_t decide_ns() const { return first_ns_ + kDecideNs; }
  SenderReason reason() const { return reason_; }
  std::uint64_t changes() const { return changes_; }
  std::uint64_t refused() const { return refused_; }
  std::uint64_t other() const { return other_; }
  std::uint64_t not_pinned() const { return not_pinned_; }
  const SenderAddress& last_not_pinned() const { return last_not_pinned_; }
  std::vector<SenderReport> report() const;

 private:
  struct Evidence {
    std::uint32_t packets = 0, consistent = 0;
  };
  struct Sender {
    std::uint32_t id = 0;
    SenderAddress address;
    std::uint64_t kept = 0, refused = 0;
    Evidence now, last;
    std::int64_t heard_ns = 0;
    int azimuth = -1;
    bool proven = false;  // it once showed kProof packets that hang together
    std::uint32_t gps_us = 0;
  };

  static std::uint32_t score(const Evidence& evidence, std::uint32_t windows);
  static std::uint32_t recent(const Sender& sender);
  static void look(Sender& sender, const std::uint8_t* payload);
  Sender& known(const SenderAddress& from, std::int64_t now_ns);
  void turn_windows(std::int64_t now_ns);
  void choose(const Sender& sender, SenderReason reason, std::int64_t now_ns);
  bool alone(const Sender& sender) const;
  bool beats_chosen(const Sender& sender, std::int64_t now_ns);

  std::vector<std::uint8_t> pinned_;
  bool all_;
  std::vector<Sender> senders_;
  std::uint32_t next_id_ = 1, chosen_ = 0;
  std::int64_t window_ns_ = 0, first_ns_ = -1, chosen_ns_ = 0;
  SenderReason reason_ = SenderReason::None;
  std::uint64_t changes_ = 0, refused_ = 0, other_ = 0, not_pinned_ = 0;
  SenderAddress last_not_pinned_;
};

}  // namespace lidarcodec
