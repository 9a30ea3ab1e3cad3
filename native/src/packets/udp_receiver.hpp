// A thread that moves sensor packets from a socket into a bounded ring, without the interpreter: however busy Python
// is, the kernel's buffer stays empty. What does not belong there is counted; the oldest packets go first when nobody
// takes.
#pragma once
#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <span>
#include <thread>
#include <vector>

#include "packets/udp_senders.hpp"

namespace lidarcodec {

constexpr std::size_t kPositionBytes = 512;
constexpr std::size_t kMaxRing = std::size_t{1} << 20;
constexpr std::size_t kMaxRingBytes = std::size_t{128} << 20;  // 7 s of the sensor that sends most

// n packets in order of arrival: their bytes, kernel times in ns since the Unix epoch, and who sent each.
struct ReceivedBatch {
  std::vector<std::uint8_t> payloads;   // one after the other
  std::vector<std::uint32_t> sizes;     // n, bytes of each
  std::vector<std::int64_t> stamps_ns;  // n
  std::vector<std::uint32_t> senders;   // n, ids: another one than before is another sender
};

struct ReceiverCounts {
  std::uint64_t kernel_drops = 0, queue_drops = 0, wrong_length = 0, position = 0;
};

class UdpReceiver {
 public:
  // Starts at once on a copy of the socket, which must be one of sources/udp/socket.py. pinned: address of the only
  // sender that is listened to, empty for any;  all: keep packets of every sender;  shapes: of the sensors beside the
  // HDL-64E;  any_size: keep packets of every size, not only of those that a known sensor sends;  hdl64e: packets of
  // an HDL-64E are evidence. Throws Error(Settings).
  UdpReceiver(int fd, std::size_t capacity, std::span<const std::uint8_t> pinned, bool all,
              std::vector<PacketShape> shapes = {}, bool any_size = false, bool hdl64e = true);
  ~UdpReceiver();
  UdpReceiver(const UdpReceiver&) = delete;
  UdpReceiver& operator=(const UdpReceiver&) = delete;

  // Up to `most` packets of the sender chosen; waits for the first one, and then 1 ms for company. Empty after the time
  // limit or stop(), and while none is chosen.
  ReceivedBatch take(std::size_t most, std::chrono::nanoseconds limit);
  ReceiverCounts counts() const;
  // A copy of what is known of those who send.
  SenderJudge senders() const;
  // Whether packets wait for a choice of their sender.
  bool holding() const;
  // errno that ended the thread, or 0.
  int failure() const { return failure_; }
  // Ends the thread and every take() that waits, and lets go of the socket; harmless when called twice, or by two
  // threads.
  void stop();

 private:
  struct Buffers;
  struct Held {
    std::vector<std::uint8_t> payload;
    std::int64_t stamp_ns;
    std::uint32_t from;
  };

  void run();
  bool drain(Buffers& buffers);
  void keep(std::span<const std::uint8_t> payload, std::int64_t stamp_ns, const SenderAddress& from,
            std::int64_t now_ns);
  void drop_oldest();
  void release();

  int socket_ = -1, wake_ = -1;
  const std::size_t capacity_;
  const bool any_size_;
  std::deque<Held> held_;
  std::size_t held_bytes_ = 0;
  std::int64_t last_ns_ = 0;
  std::uint32_t overflow_ = 0;
  SenderJudge judge_;
  bool released_ = false;
  ReceiverCounts counts_;
  std::atomic<int> failure_{0};
  std::atomic<bool> stopping_{false};
  mutable std::mutex ring_;
  std::mutex stop_;
  std::condition_variable arrived_;
  std::thread thread_;
};

}  // namespace lidarcodec
