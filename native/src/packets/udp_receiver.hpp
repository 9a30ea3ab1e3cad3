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
#include <memory>
#include <mutex>
#include <span>
#include <thread>
#include <vector>

#include "packets/udp_senders.hpp"

namespace lidarcodec {

constexpr std::size_t kDatagramBytes = 1206;
constexpr std::size_t kPositionBytes = 512;
constexpr std::size_t kMaxRing = std::size_t{1} << 20;

// n packets in order of arrival: their bytes, kernel times in ns since the Unix epoch, and who sent each.
struct ReceivedBatch {
  std::vector<std::uint8_t> payloads;   // n x 1206
  std::vector<std::int64_t> stamps_ns;  // n
  std::vector<std::uint32_t> senders;   // n, ids: another one than before is another sender
};

struct ReceiverCounts {
  std::uint64_t kernel_drops = 0, queue_drops = 0, wrong_length = 0, position = 0;
};

class UdpReceiver {
 public:
  // Starts at once on a copy of the socket, which must be one of sources/udp/socket.py. pinned: address of the only
  // sender that is listened to, empty for any;  all: keep packets of every sender. Throws Error(Settings).
  UdpReceiver(int fd, std::size_t capacity, std::span<const std::uint8_t> pinned, bool all);
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
  // The last packet that was refused because another sensor sent it; empty if there was none.
  std::vector<std::uint8_t> foreign() const;
  // errno that ended the thread, or 0.
  int failure() const { return failure_; }
  // Ends the thread and every take() that waits, and lets go of the socket; harmless when called twice, or by two
  // threads.
  void stop();

 private:
  struct Buffers;

  void run();
  bool drain(Buffers& buffers);
  void keep(const std::uint8_t* payload, std::int64_t stamp_ns, const SenderAddress& from, std::int64_t now_ns);
  void release();

  int socket_ = -1, wake_ = -1;
  const std::size_t capacity_;
  std::unique_ptr<std::uint8_t[]> payloads_;
  std::vector<std::int64_t> stamps_ns_;
  std::vector<std::uint32_t> from_;
  std::size_t first_ = 0, count_ = 0;
  std::int64_t last_ns_ = 0;
  std::uint32_t overflow_ = 0;
  SenderJudge judge_;
  bool released_ = false;
  std::vector<std::uint8_t> foreign_;
  ReceiverCounts counts_;
  std::atomic<int> failure_{0};
  std::atomic<bool> stopping_{false};
  mutable std::mutex ring_;
  std::mutex stop_;
  std::condition_variable arrived_;
  std::thread thread_;
};

}  // namespace lidarcodec
