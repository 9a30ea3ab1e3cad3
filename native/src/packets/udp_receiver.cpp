#include "packets/udp_receiver.hpp"

#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kBatch = 64;            // datagrams a system call
constexpr std::size_t kBufferBytes = 65'536;  // more than any datagram has
constexpr std::size_t kControlBytes = 128;    // a time stamp and a drop count
constexpr int kCallsBeforeLooking = 64;       // so that stop() is seen under any load
constexpr std::size_t kCompany = 4;           // packets worth waking the interpreter for
constexpr auto kCompanyTime = std::chrono::milliseconds(1);
// Until its time stamps run, the kernel stamps packets when they are read: later than those that come behind them.
constexpr std::int64_t kJitterNs = 20'000'000;
constexpr std::int64_t kSecondNs = 1'000'000'000;

std::int64_t nanoseconds(const timespec& t) { return std::int64_t{t.tv_sec} * kSecondNs + t.tv_nsec; }

std::int64_t now_ns() {
  timespec t{};
  clock_gettime(CLOCK_REALTIME, &t);
  return nanoseconds(t);
}

std::int64_t steady_ns() { return std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1); }

}  // namespace

// What recvmmsg writes to; one for the life of the thread.
struct UdpReceiver::Buffers {
  std::array<std::array<std::uint8_t, kBufferBytes>, kBatch> data;
  std::array<sockaddr_storage, kBatch> from;
  std::array<iovec, kBatch> parts;
  std::array<mmsghdr, kBatch> messages;
  struct alignas(cmsghdr) Control {
    std::array<std::uint8_t, kControlBytes> bytes;
  };
  std::array<Control, kBatch> control;

  void reset() {
    for (std::size_t k = 0; k < kBatch; ++k) {
      parts[k] = {data[k].data(), data[k].size()};
      msghdr& m = messages[k].msg_hdr;
      m = {};
      m.msg_name = &from[k];
      m.msg_namelen = sizeof from[k];
      m.msg_iov = &parts[k];
      m.msg_iovlen = 1;
      m.msg_control = control[k].bytes.data();
      m.msg_controllen = control[k].bytes.size();
    }
  }
};

UdpReceiver::UdpReceiver(int fd, std::size_t capacity, std::span<const std::uint8_t> pinned, bool all,
                         std::vector<PacketShape> shapes, bool any_size, bool hdl64e)
    : capacity_(capacity), any_size_(any_size), judge_(pinned, all, std::move(shapes), hdl64e) {
  if (capacity < 1 || capacity > kMaxRing) throw Error(ErrorCode::Settings, "a receiver holds 1 to 1048576 packets");
  socket_ = dup(fd);
  wake_ = eventfd(0, EFD_CLOEXEC);
  if (socket_ < 0 || wake_ < 0) {
    const std::string why = std::strerror(errno);
    if (socket_ >= 0) close(socket_);
    if (wake_ >= 0) close(wake_);
    throw Error(ErrorCode::Settings, "no socket to receive from: " + why);
  }
  try {
    thread_ = std::thread(&UdpReceiver::run, this);
  } catch (const std::system_error& error) {
    close(socket_);
    close(wake_);
    throw Error(ErrorCode::Settings, std::string("no thread to receive with: ") + error.what());
  }
}

UdpReceiver::~UdpReceiver() {
  stop();
  close(wake_);
}

void UdpReceiver::stop() {
  const std::lock_guard lock(stop_);
  {
    const std::lock_guard ring(ring_);  // no take() may be between its look at stopping_ and its wait
    stopping_ = true;
  }
  arrived_.notify_all();
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(wake_, &one, sizeof one);
  if (!thread_.joinable()) return;
  thread_.join();
  close(socket_);
}

ReceivedBatch UdpReceiver::take(std::size_t most, std::chrono::nanoseconds limit) {
  std::unique_lock lock(ring_);
  const auto ended = [this] { return stopping_ || failure_ != 0; };
  const std::int64_t end_ns = steady_ns() + limit.count();
  while ((held_.empty() || !released_) && !ended()) {
    const std::int64_t now = steady_ns();
    if (!held_.empty() && judge_.settle(now)) {
      release();
    } else if (now >= end_ns) {
      return {};
    } else {
      const std::int64_t until_ns = !held_.empty() ? std::min(end_ns, judge_.decide_ns()) : end_ns;
      arrived_.wait_for(lock, std::chrono::nanoseconds(until_ns - now));
    }
  }
  if (!held_.empty() && held_.size() < kCompany) {
    arrived_.wait_for(lock, kCompanyTime, [&] { return held_.size() >= kCompany || ended(); });
  }
  ReceivedBatch batch;
  if (stopping_ || !released_) return batch;
  const std::size_t n = std::min(most, held_.size());
  for (std::size_t k = 0; k < n; ++k) {
    const Held& one = held_.front();
    batch.payloads.insert(batch.payloads.end(), one.payload.begin(), one.payload.end());
    batch.sizes.push_back(static_cast<std::uint32_t>(one.payload.size()));
    batch.stamps_ns.push_back(one.stamp_ns);
    batch.senders.push_back(one.from);
    drop_oldest();
  }
  return batch;
}

SenderJudge UdpReceiver::senders() const {
  const std::lock_guard lock(ring_);
  return judge_;
}

bool UdpReceiver::holding() const {
  const std::lock_guard lock(ring_);
  return !held_.empty() && !released_;
}

ReceiverCounts UdpReceiver::counts() const {
  const std::lock_guard lock(ring_);
  return counts_;
}

void UdpReceiver::run() {
  sigset_t all;
  sigfillset(&all);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);  // signals are the interpreter's
  const auto buffers = std::make_unique<Buffers>();
  while (!stopping_) {
    std::array<pollfd, 2> waiting{{{socket_, POLLIN, 0}, {wake_, POLLIN, 0}}};
    if (poll(waiting.data(), waiting.size(), -1) < 0 && errno != EINTR) failure_ = errno;
    if ((waiting[0].revents & POLLNVAL) != 0) failure_ = EBADF;
    if (failure_ != 0 || !drain(*buffers)) break;
  }
  const std::lock_guard lock(ring_);
  arrived_.notify_all();
}

// Take what the kernel holds; false if the socket failed.
bool UdpReceiver::drain(Buffers& buffers) {
  for (int calls = 0; calls < kCallsBeforeLooking && !stopping_; ++calls) {
    buffers.reset();
    const int n = recvmmsg(socket_, buffers.messages.data(), kBatch, MSG_DONTWAIT, nullptr);
    if (n < 0) {
      if (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR) return true;
      failure_ = errno;
      return false;
    }
    const std::lock_guard lock(ring_);
    const bool was_empty = held_.empty();
    const std::int64_t now = steady_ns();
    for (std::size_t k = 0; k < static_cast<std::size_t>(n); ++k) {
      msghdr& m = buffers.messages[k].msg_hdr;
      std::int64_t stamp_ns = 0;
      for (cmsghdr* c = CMSG_FIRSTHDR(&m); c != nullptr; c = CMSG_NXTHDR(&m, c)) {
        if (c->cmsg_level != SOL_SOCKET) continue;
        if (c->cmsg_type == SCM_TIMESTAMPNS && c->cmsg_len >= CMSG_LEN(sizeof(timespec))) {
          timespec t;
          std::memcpy(&t, CMSG_DATA(c), sizeof t);
          stamp_ns = nanoseconds(t);
        } else if (c->cmsg_type == SO_RXQ_OVFL && c->cmsg_len >= CMSG_LEN(sizeof(std::uint32_t))) {
          std::uint32_t total;  // since the socket was opened, modulo 2^32
          std::memcpy(&total, CMSG_DATA(c), sizeof total);
          counts_.kernel_drops += static_cast<std::uint32_t>(total - overflow_);
          overflow_ = total;
        }
      }
      const std::size_t size = buffers.messages[k].msg_len;
      if ((m.msg_flags & MSG_TRUNC) != 0 || !(any_size_ || judge_.knows_size(size))) {
        const bool position = size == kPositionBytes && (m.msg_flags & MSG_TRUNC) == 0;
        ++(position ? counts_.position : counts_.wrong_length);
        continue;
      }
      SenderAddress from;
      if (m.msg_namelen >= sizeof(sockaddr_in6) && buffers.from[k].ss_family == AF_INET6) {
        const auto& whole = reinterpret_cast<const sockaddr_in6&>(buffers.from[k]);
        const auto& a = whole.sin6_addr;
        from.port = ntohs(whole.sin6_port);
        const bool mapped = IN6_IS_ADDR_V4MAPPED(&a);
        from.size = mapped ? 4 : 16;
        std::memcpy(from.bytes.data(), a.s6_addr + (mapped ? 12 : 0), from.size);
      } else if (m.msg_namelen >= sizeof(sockaddr_in) && buffers.from[k].ss_family == AF_INET) {
        from.size = 4;
        const auto& whole = reinterpret_cast<const sockaddr_in&>(buffers.from[k]);
        from.port = ntohs(whole.sin_port);
        std::memcpy(from.bytes.data(), &whole.sin_addr, 4);
      }
      keep({buffers.data[k].data(), size}, stamp_ns != 0 ? stamp_ns : now_ns(), from, now);
    }
    if ((was_empty && !held_.empty()) || held_.size() >= kCompany) arrived_.notify_all();
    if (static_cast<std::size_t>(n) < kBatch) return true;
  }
  return true;
}

// Called with the ring locked.
void UdpReceiver::keep(std::span<const std::uint8_t> payload, std::int64_t stamp_ns, const SenderAddress& from,
                       std::int64_t now_ns) {
  std::uint32_t id = 0;
  const SenderVerdict verdict = judge_.judge(payload, from, now_ns, id);
  if (verdict == SenderVerdict::Refuse) {
    if (judge_.chosen() != 0 && !released_) release();
    return;
  }
  if (stamp_ns < last_ns_ && last_ns_ - stamp_ns < kJitterNs) stamp_ns = last_ns_;
  last_ns_ = stamp_ns;
  while (!held_.empty() && (held_.size() >= capacity_ || held_bytes_ + payload.size() > kMaxRingBytes)) {
    drop_oldest();
    ++counts_.queue_drops;
  }
  held_.push_back({{payload.begin(), payload.end()}, stamp_ns, id});
  held_bytes_ += payload.size();
  if (judge_.chosen() != 0 && !released_) release();
}

void UdpReceiver::drop_oldest() {
  held_bytes_ -= held_.front().payload.size();
  held_.pop_front();
}

// A sender was chosen: of the packets that waited for it, keep its own. Called with the ring locked.
void UdpReceiver::release() {
  released_ = true;
  if (judge_.keeps_all()) return;
  std::erase_if(held_, [this](const Held& one) {
    if (one.from == judge_.chosen()) return false;
    judge_.drop(one.from);
    held_bytes_ -= one.payload.size();
    return true;
  });
}

}  // namespace lidarcodec
