// A thread that moves sensor packets from a socket into a bounded ring, without the interpreter: however busy Python is,
// the kernel's buffer stays empty. What does not belong there is counted; the oldest packets go first when nobody takes.
#pragma once
#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace lidarcodec {

constexpr std::size_t kDatagramBytes = 1206;
constexpr std::size_t kPositionBytes = 512;
constexpr std::size_t kMaxSenders = 64;  // told apart; packets of further ones count as strangers'
constexpr std::size_t kMaxRing = std::size_t{1} << 20;

// n packets in order of arrival: their bytes, kernel times in ns since the Unix epoch, and who sent each.
struct ReceivedBatch {
  std::vector<std::uint8_t> payloads;   // n x 1206
  std::vector<std::int64_t> stamps_ns;  // n
  std::vector<std::uint8_t> senders;    // n, index for sender()
};

struct ReceiverCounts {
  std::uint64_t kernel_drops = 0, queue_drops = 0, wrong_length = 0, position = 0, strangers = 0;
};

class UdpReceiver {
 public:
  // Starts at once on a copy of the socket, which must be one of udp_socket.open_socket. Throws Error(Settings).
  UdpReceiver(int fd, std::size_t capacity);
  ~UdpReceiver();
  UdpReceiver(const UdpReceiver&) = delete;
  UdpReceiver& operator=(const UdpReceiver&) = delete;

  // Up to `most` packets; waits for the first one, and then 1 ms for company. Empty after the time limit or stop().
  ReceivedBatch take(std::size_t most, std::chrono::nanoseconds limit);
  // From now on packets of other senders are counted as strangers' and not kept.
  void only(std::uint8_t sender) { only_ = sender; }
  // Address of a sender: 4 bytes, or 16 of IPv6; empty for a number that was never given.
  std::vector<std::uint8_t> sender(std::size_t number) const;
  ReceiverCounts counts() const;
  // errno that ended the thread, or 0.
  int failure() const { return failure_; }
  // Ends the thread and every take() that waits, and lets go of the socket; harmless when called twice, or by two threads.
  void stop();

 private:
  struct Address {
    std::array<std::uint8_t, 16> bytes{};
    std::uint8_t size = 0;
    bool operator==(const Address&) const = default;
  };
  struct Buffers;

  void run();
  bool drain(Buffers& buffers);
  void keep(const std::uint8_t* payload, std::int64_t stamp_ns, const Address& from);

  int socket_ = -1, wake_ = -1;
  const std::size_t capacity_;
  std::unique_ptr<std::uint8_t[]> payloads_;
  std::vector<std::int64_t> stamps_ns_;
  std::vector<std::uint8_t> from_;
  std::size_t first_ = 0, count_ = 0;
  std::int64_t last_ns_ = 0;
  std::uint32_t overflow_ = 0;
  std::vector<Address> senders_;
  ReceiverCounts counts_;
  std::atomic<int> only_{-1}, failure_{0};
  std::atomic<bool> stopping_{false};
  mutable std::mutex ring_;
  std::mutex stop_;
  std::condition_variable arrived_;
  std::thread thread_;
};

}  // namespace lidarcodec
