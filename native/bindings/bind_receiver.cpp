#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <span>
#include <tuple>
#include <vector>

#include "base/error.hpp"
#include "bindings.hpp"
#include "packets/udp_receiver.hpp"

namespace lc = lidarcodec;

namespace {

using Address = Tuple<nb::bytes, std::uint16_t>;

Address place_of(const lc::SenderAddress& a) {
  return nb::make_tuple(give_bytes(std::vector<std::uint8_t>(a.bytes.begin(), a.bytes.begin() + a.size)), a.port);
}

// (size, turn offset, span, counts, marks, wanted), the marks as offset and value in turn.
using ShapeArgument = std::tuple<std::uint32_t, std::uint32_t, std::uint32_t, bool, std::vector<std::uint32_t>, bool>;

std::vector<lc::PacketShape> shapes_of(const std::vector<ShapeArgument>& given) {
  std::vector<lc::PacketShape> shapes;
  for (const auto& [size, offset, span, counts, marks, wanted] : given) {
    lc::PacketShape shape{size, offset, span, counts, {}, wanted};
    for (std::size_t k = 0; k + 1 < marks.size(); k += 2)
      shape.marks.push_back({marks[k], static_cast<std::uint8_t>(marks[k + 1])});
    shapes.push_back(std::move(shape));
  }
  return shapes;
}

std::span<const std::uint8_t> bytes_of(const nb::bytes& b) {
  return {static_cast<const std::uint8_t*>(b.data()), b.size()};
}

}  // namespace

void bind_receiver(nb::module_& m) {
  // Integers instead of nb::enum_, which runs Python code while the module is loaded: a signal would then end the
  // process.
  nb::class_<lc::SenderJudge>(m, "SenderJudge",
                              "Decides which sender is the sensor, from the packets that each sent lately.")
      .def(
          "__init__",
          [](lc::SenderJudge* self, const nb::bytes& pinned, bool all, const std::vector<ShapeArgument>& shapes,
             bool hdl64e) { new (self) lc::SenderJudge(bytes_of(pinned), all, shapes_of(shapes), hdl64e); },
          nb::arg("pinned") = nb::bytes("", 0), nb::arg("all") = false,
          nb::arg("shapes") = std::vector<ShapeArgument>{}, nb::arg("hdl64e") = true)
      .def(
          "judge",
          [](lc::SenderJudge& judge, const nb::bytes& payload, const nb::bytes& address, std::uint16_t port,
             std::int64_t now_ns) {
            lc::SenderAddress from;
            if (address.size() > from.bytes.size() || now_ns < 0)
              throw lc::Error(lc::ErrorCode::Packet, "a packet from an address of 16 bytes at most");
            const auto bytes = bytes_of(address);
            std::copy(bytes.begin(), bytes.end(), from.bytes.begin());
            from.size = static_cast<std::uint8_t>(bytes.size());
            from.port = port;
            std::uint32_t id = 0;
            return static_cast<int>(judge.judge(bytes_of(payload), from, now_ns, id));
          },
          nb::arg("payload"), nb::arg("address"), nb::arg("port"), nb::arg("now_ns"),
          "The verdict on a packet, a SenderVerdict.")
      .def("settle", &lc::SenderJudge::settle, nb::arg("now_ns"), "Chooses a sender, if it is time.")
      .def_prop_ro("chosen", &lc::SenderJudge::chosen, "Id of the sender, 0 while there is none.")
      .def_prop_ro(
          "reason", [](const lc::SenderJudge& j) { return static_cast<int>(j.reason()); },
          "The reason of the choice, a SenderReason.")
      .def_prop_ro("changes", &lc::SenderJudge::changes, "How often the choice changed.")
      .def_prop_ro("refused", &lc::SenderJudge::refused, "Packets of other senders.")
      .def_prop_ro("not_pinned", &lc::SenderJudge::not_pinned, "Packets from addresses other than the pinned one.")
      .def_prop_ro(
          "last_not_pinned", [](const lc::SenderJudge& j) { return place_of(j.last_not_pinned()); },
          "Address and port of the last packet that did not come from the pinned address.")
      .def(
          "report",
          [](const lc::SenderJudge& judge)
              -> List<Tuple<std::uint32_t, Address, std::uint64_t, std::uint64_t, std::uint32_t>> {
            nb::list found;
            for (const lc::SenderReport& r : judge.report()) {
              found.append(nb::make_tuple(r.id, place_of(r.address), r.kept, r.refused, r.score));
            }
            return found;
          },
          "For each sender: id, (address, port), packets kept, packets refused, score from 0 to 300.");
  nb::class_<lc::UdpReceiver>(m, "UdpReceiver", "A thread that reads datagrams from a socket into a bounded queue.")
      .def(
          "__init__",
          [](lc::UdpReceiver* self, int fd, std::size_t capacity, const nb::bytes& pinned, bool all,
             const std::vector<ShapeArgument>& shapes, bool any_size, bool hdl64e) {
            new (self) lc::UdpReceiver(fd, capacity, bytes_of(pinned), all, shapes_of(shapes), any_size, hdl64e);
          },
          nb::arg("fd"), nb::arg("capacity"), nb::arg("pinned") = nb::bytes("", 0), nb::arg("all") = false,
          nb::arg("shapes") = std::vector<ShapeArgument>{}, nb::arg("any_size") = false, nb::arg("hdl64e") = true)
      .def(
          "take",
          [](lc::UdpReceiver& receiver, std::size_t most,
             double limit_s) -> Tuple<nb::bytes, Array<std::uint32_t>, Array<std::int64_t>, Array<std::uint32_t>> {
            const double bounded = std::isfinite(limit_s) ? std::clamp(limit_s, 0.0, 3600.0) : 0.0;
            const auto limit = std::chrono::nanoseconds(static_cast<std::int64_t>(bounded * 1e9));
            lc::ReceivedBatch b;
            {
              nb::gil_scoped_release release;
              b = receiver.take(most, limit);
            }
            const std::size_t n = b.senders.size();
            return nb::make_tuple(give_bytes(b.payloads), give(std::move(b.sizes), {n}),
                                  give(std::move(b.stamps_ns), {n}), give(std::move(b.senders), {n}));
          },
          nb::arg("most"), nb::arg("limit_s"),
          "Payloads one after the other, their sizes uint32(n), kernel times int64(n) and ids of the senders "
          "uint32(n).")
      .def("senders", &lc::UdpReceiver::senders, "A copy of the judge of senders.")
      .def("holding", &lc::UdpReceiver::holding, "Whether packets wait for a choice of their sender.")
      .def(
          "counts",
          [](const lc::UdpReceiver& r) -> Tuple<std::uint64_t, std::uint64_t, std::uint64_t, std::uint64_t> {
            const lc::ReceiverCounts c = r.counts();
            return nb::make_tuple(c.kernel_drops, c.queue_drops, c.wrong_length, c.position);
          },
          "Kernel drops, queue drops, wrong lengths, position packets.")
      .def("failure", &lc::UdpReceiver::failure, "The errno that ended the thread, or 0.")
      .def("stop", &lc::UdpReceiver::stop, nb::call_guard<nb::gil_scoped_release>(),
           "Ends the thread, and every `take` that waits.");
}
