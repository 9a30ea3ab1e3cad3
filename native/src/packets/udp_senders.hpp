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
constexpr std::int64_t kPauseNs = 20'000'000;  // longer than any sensor takes from packet to packet (the slowest: 3 ms)
constexpr std::uint32_t kProof = 32;           // packets that hang together: 9 ms of an HDL-64E
constexpr std::uint32_t kRival = 64;           // such packets in a window that make a sender a rival
constexpr std::uint32_t kFull = 300;           // more than these in a window prove nothing more (a sensor: 347)
constexpr std::uint32_t kMost = 1200;          // packets in a window beyond which this is no HDL-64E (dual return: 579)
constexpr std::uint32_t kMostShaped = 2500;    // and no other sensor (a VLS-128 with two returns: 1250)
constexpr std::uint32_t kFew = 16;             // such packets of another sensor in a window: the slowest sends 32
constexpr std::uint32_t kClearly = 4;          // times as much evidence as the other

// An IP address of 4 or 16 bytes, and a port.
struct SenderAddress {
  std::array<std::uint8_t, 16> bytes{};
  std::uint8_t size = 0;
  std::uint16_t port = 0;
  bool operator==(const SenderAddress&) const = default;
};

// What packets of a layout look like: lidarcodec/sensors/models/shapes.py makes one for each layout of each sensor.
struct PacketShape {
  struct Mark {
    std::uint32_t offset;
    std::uint8_t value;
  };
  std::uint32_t size = 0;         // bytes
  std::uint32_t turn_offset = 0;  // of a u16 that says how far the sensor turned, or in which turn it is
  std::uint32_t span = 0;         // where that wraps; beyond it there is no value
  bool counts = false;            // it is the number of the turn
  std::vector<Mark> marks;        // bytes that each packet has
  bool wanted = true;             // such packets are evidence; false for a model that is not asked for

  bool fits(std::span<const std::uint8_t> payload) const;
  int position(std::span<const std::uint8_t> payload) const;  // -1 if it is beyond the span
  bool goes_on(int before, int position) const;
};

// What is known of one sender. `score` is its evidence in the last whole window, 0 to kFull.
struct SenderReport {
  std::uint32_t id = 0;
  SenderAddress address;
  std::uint64_t kept = 0, refused = 0;
  std::uint32_t score = 0;
};

// The numbers of both stand in lidarcodec/sources/udp/senders.py, too.
enum class SenderVerdict { Keep, Hold, Refuse };
enum class SenderReason : std::uint8_t { None, First, Silent, Implausible };

class SenderJudge {
 public:
  // pinned: address of the only sender that is listened to, empty for any;  all: keep packets of every sender
  // shapes: of the sensors beside the HDL-64E;  hdl64e: its packets are evidence. Throws Error(Settings) for a shape
  // that does not fit into its packet.
  SenderJudge(std::span<const std::uint8_t> pinned, bool all, std::vector<PacketShape> shapes = {}, bool hdl64e = true);

  // What to do with a packet that came at this time of a steady clock. `id` is set for Keep and Hold.
  SenderVerdict judge(std::span<const std::uint8_t> payload, const SenderAddress& from, std::int64_t now_ns,
                      std::uint32_t& id);
  // Whether any known sensor sends packets of so many bytes.
  bool knows_size(std::size_t size) const;
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
  std::uint64_t not_pinned() const { return not_pinned_; }
  const SenderAddress& last_not_pinned() const { return last_not_pinned_; }
  std::vector<SenderReport> report() const;

 private:
  struct Evidence {
    std::uint32_t packets = 0, consistent = 0, shaped = 0;  // shaped: of the consistent ones, those of a PacketShape
  };
  struct Sender {
    std::uint32_t id = 0;
    SenderAddress address;
    std::uint64_t kept = 0, refused = 0;
    Evidence now, last;
    std::int64_t heard_ns = 0;
    int azimuth = -1;
    const PacketShape* shape = nullptr;  // of the last packet
    int position = -1;
    bool proven = false;  // it once showed kProof packets that hang together
    std::uint32_t gps_us = 0;
  };

  static std::uint32_t score(const Evidence& evidence, std::uint32_t windows);
  static std::uint32_t recent(const Sender& sender);
  void look(Sender& sender, std::span<const std::uint8_t> payload) const;
  Sender& known(const SenderAddress& from, std::int64_t now_ns);
  void turn_windows(std::int64_t now_ns);
  void choose(const Sender& sender, SenderReason reason, std::int64_t now_ns);
  bool alone(const Sender& sender) const;
  bool beats_chosen(const Sender& sender, std::int64_t now_ns);

  std::vector<std::uint8_t> pinned_;
  bool all_, hdl64e_;
  std::vector<PacketShape> shapes_;
  std::vector<Sender> senders_;
  std::uint32_t next_id_ = 1, chosen_ = 0;
  std::int64_t window_ns_ = 0, first_ns_ = -1, chosen_ns_ = 0;
  SenderReason reason_ = SenderReason::None;
  std::uint64_t changes_ = 0, refused_ = 0, not_pinned_ = 0;
  SenderAddress last_not_pinned_;
};

}  // namespace lidarcodec
