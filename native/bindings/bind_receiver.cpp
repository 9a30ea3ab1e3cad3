#include <algorithm>
#include <cmath>

#include "bindings.hpp"
#include "udp_receiver.hpp"

namespace lc = lidarcodec;

void bind_receiver(nb::module_& m) {
  nb::class_<lc::UdpReceiver>(m, "UdpReceiver",
                              "A thread that takes 1206-byte datagrams from a socket into a bounded ring.")
      .def(nb::init<int, std::size_t>(), nb::arg("fd"), nb::arg("capacity"))
      .def(
          "take",
          [](lc::UdpReceiver& receiver, std::size_t most, double limit_s) {
            const double bounded = std::isfinite(limit_s) ? std::clamp(limit_s, 0.0, 3600.0) : 0.0;
            const auto limit = std::chrono::nanoseconds(static_cast<std::int64_t>(bounded * 1e9));
            lc::ReceivedBatch b;
            {
              nb::gil_scoped_release release;
              b = receiver.take(most, limit);
            }
            return nb::make_tuple(give_bytes(b.payloads), give(std::move(b.stamps_ns), {b.senders.size()}),
                                  give_bytes(b.senders));
          },
          nb::arg("most"), nb::arg("limit_s"),
          "Payloads (n x 1206 bytes), kernel times int64(n) and numbers of the senders (n bytes), in order.")
      .def("only", &lc::UdpReceiver::only, nb::arg("sender"), "Keep packets of this sender and count the others.")
      .def(
          "sender", [](const lc::UdpReceiver& r, std::size_t number) { return give_bytes(r.sender(number)); },
          nb::arg("number"), "Address of a sender, 4 or 16 bytes.")
      .def("counts",
           [](const lc::UdpReceiver& r) {
             const lc::ReceiverCounts c = r.counts();
             return nb::make_tuple(c.kernel_drops, c.queue_drops, c.wrong_length, c.position, c.strangers);
           },
           "Kernel drops, queue drops, wrong lengths, position packets, packets of strangers.")
      .def("failure", &lc::UdpReceiver::failure, "The errno that ended it, or 0.")
      .def("stop", &lc::UdpReceiver::stop, nb::call_guard<nb::gil_scoped_release>(),
           "End the thread and every take that waits.");
}
