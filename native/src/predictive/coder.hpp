// Predictive coder: codes the ranges of a frame's returns by adaptive models of their neighbours. README.md in this
// folder derives the models, docs/wire-format-predictive.md defines the format.
//
// Rows are coded from the top. The four quarters of a row are interleaved: each has its own range coder, all share the
// models. A core then works on one quarter while another waits for its decision. A frame that goes on from another can
// be coded in two halves, rows 0 to 31 and 32 to 63, each with models of its own, so that two cores work on it.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "base/processor.hpp"
#include "mask/coder.hpp"
#include "network/net.hpp"
#include "network/samples.hpp"
#include "predictive/model.hpp"

namespace lidarcodec {

// The quantisation of ranges: a cell is `step` range steps wide. The coder computes in sixteenths of a cell.
struct RangeCells {
  std::uint32_t step = 1;                       // odd, 1 to 65535
  std::array<std::int32_t, kMaskRows> level{};  // 0 to 1000, range steps
  bool free =
      false;  // cells are counted from the last return (predictive/free_cells.hpp), not from 0; the coder sets it

  // The quantisation of one row, by value: compilers then know that no loop writes to it.
  struct Row {
    std::int32_t step, level;
    bool free;

    std::int32_t sixteenths(std::int32_t range) const {
      const std::int32_t levelled = range + level;
      if (step == 1) return levelled * 16;
      return free ? (levelled * 16 + step / 2) / step : (levelled + step / 2) / step * 16;
    }
    std::int32_t range(std::int32_t sixteenths) const { return ((sixteenths * step + 8) >> 4) - level; }
  };
  Row row(std::size_t number) const { return {static_cast<std::int32_t>(step), level[number], free}; }
};

struct SlabEnds;

// Known columns at the left of a slab; -1: the image is a whole frame.
using KnownColumns = std::int64_t;
inline constexpr KnownColumns kWholeFrame = -1;

// The number of known columns that the bytes of a slab need; kWholeFrame for a whole frame, and for no bytes. Raises
// Truncated.
KnownColumns known_columns(const std::uint8_t* data, std::size_t size);

// Networks that give the prior of the trees: for frames alone, and for frames with expected ranges.
struct RiddleNets {
  std::optional<RiddleNet> alone, expecting;
};

// The models go on from frame to frame until `reset`. After an error only `reset` may be called.
class PredictiveCoder {
 public:
  // path: which instructions it uses; all paths give the same bytes. nets: the networks, or nullptr. at_once: whether
  // halves are coded by two threads; without it, if they are large and a processor is free. Bytes do not depend on it.
  explicit PredictiveCoder(Path path = quickest_path(), std::shared_ptr<const RiddleNets> nets = nullptr,
                           std::optional<bool> at_once = std::nullopt);
  // Copies go on from the same models, each by itself.
  PredictiveCoder(const PredictiveCoder& other);
  PredictiveCoder& operator=(const PredictiveCoder&) = delete;
  ~PredictiveCoder();

  // Returns all models to their initial state.
  void reset();

  // Encodes the ranges of the cells that are set in returns; both (64, W).
  // turn: columns in a full turn, up to 65535; 0: it is found from the mask.
  // firing: the number of columns that the sensor fired before the first one that is not known; taken modulo kFirings.
  // expected: (64, W), 0 where no range is expected; or nullptr.
  // known: the number of known columns, of W.
  // samples: with a network, receives some of the returns.
  // quick: without a network, uses fewer contexts: less time, a few more bits.
  // sent: (64, W), receives the ranges as they are decoded; ranges are then free to be the cheapest within half a step.
  // nullptr: ranges are rounded. halves: of a whole frame, code it in halves. Raises Section if a cell is set in a
  // block that did not fire, or has no range.
  std::vector<std::uint8_t> encode(const std::uint16_t* ranges, const std::uint8_t* returns, const RangeCells& cells,
                                   const MaskGeometry& geometry, std::uint32_t turn, std::uint32_t firing,
                                   const std::uint16_t* expected = nullptr, KnownColumns known = kWholeFrame,
                                   RiddleSamples* samples = nullptr, bool quick = false, std::uint16_t* sent = nullptr,
                                   bool halves = false);

  // Replaces the networks; the models stay. Raises Section if there were no networks or nets is nullptr, but not both.
  void change(std::shared_ptr<const RiddleNets> nets);

  // The ranges, (64, W), each within half a step, 0 outside of returns. before: (64, known), the ranges of a slab's
  // known columns. Raises Section or Truncated.
  std::vector<std::uint16_t> decode(const std::uint8_t* data, std::size_t size, const std::uint8_t* returns,
                                    const RangeCells& cells, const MaskGeometry& geometry,
                                    const std::uint16_t* expected = nullptr, KnownColumns known = kWholeFrame,
                                    const std::uint16_t* before = nullptr);

  // Collects training samples of a frame: inputs of networks, and the leaves and offset bits that they predict. All
  // else is as in `encode`.
  static void sample(const std::uint16_t* ranges, const std::uint8_t* returns, const RangeCells& cells,
                     const MaskGeometry& geometry, std::uint32_t turn, const std::uint16_t* expected,
                     RiddleSamples& samples);

 private:
  // The network for frames with or without expected ranges; nullptr without networks. Raises Section if only the other
  // one is there.
  const RiddleNet* net_of(bool expects) const;

  // Codes a frame, or each of its halves, by code(half, model, rows). The models of the lower half begin as a copy of
  // `model_`. at_once: by two threads.
  template <class Code>
  void code_halves(bool halves, bool at_once, const Code& code);
  bool at_once(std::size_t returns) const;

  Path path_;
  std::shared_ptr<const RiddleNets> nets_;
  std::optional<bool> at_once_;
  PredictiveModel model_;                   // of all rows, or of the upper half
  std::unique_ptr<PredictiveModel> lower_;  // of the lower half, after a frame in halves
  std::unique_ptr<SlabEnds> slab_ends_;     // the rows at the end of the last slab
};

}  // namespace lidarcodec
