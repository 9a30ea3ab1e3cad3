// Predictive coder: the ranges of the returns of a frame, by adaptive models of their neighbours. No weights.
// The format is docs/wire-format-predictive.md.
//
// Rows are coded from the top. The two halves of a row are coded at the same time, each with a range coder of its own and
// both with the same models, so that a core has something to do while one of them waits for its next decision.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "mask/coder.hpp"
#include "predictive/model.hpp"
#include "base/processor.hpp"
#include "network/net.hpp"
#include "network/samples.hpp"

namespace lidarcodec {

// What turns ranges into cells. The coder has them in sixteenths of a cell.
struct RangeCells {
  std::uint32_t step = 1;                        // odd, 1 to 65535
  std::array<std::int32_t, kMaskRows> level{};   // 0 to 1000, range steps
  bool free = false;  // cells are counted from the last return (predictive/free_cells.hpp), not from 0; the coder sets it

  // Those of a row. A copy: what loops write would else have to be told from it.
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

struct SlabStates;

// Columns that are known already, on the left of an image; -1: it is coded as a whole frame, else as a slab.
using KnownColumns = std::int64_t;
inline constexpr KnownColumns kWholeFrame = -1;

// How many columns the bytes of a slab need to be known; kWholeFrame for those of a whole frame, and for none. Raises Truncated.
KnownColumns known_columns(const std::uint8_t* data, std::size_t size);

// Networks that say what is likely to begin with: of frames alone, and of those that expect something.
struct RiddleNets {
  std::optional<RiddleNet> alone, expecting;
};

// What one frame taught stays for the next one, until `reset`. After an error only `reset` may be called.
class PredictiveCoder {
 public:
  // path: how it computes. All paths give the same bytes. nets: where there are any, codes with them.
  explicit PredictiveCoder(Path path = quickest_path(), std::shared_ptr<const RiddleNets> nets = nullptr);
  ~PredictiveCoder();

  // Forgets everything.
  void reset();

  // Ranges of the cells set in `returns`; both (64, W). `expected`: (64, W), 0 where nothing is; or nullptr. `turn`:
  // columns in a full turn, up to 65535; 0: found from the mask. `firing`: how many columns the
  // sensor had fired before those that are not known, modulo kFirings or not. `known`: of W, columns that are known already. `samples`: takes some of the returns, where there is a network. `quick`: with fewer
  // contexts, where there is none: three tenths less time, up to 0.03 bits a return more. `sent`: (64, W), takes what a decoder gets; ranges are then free
  // to be any within half a step that cost least, else rounded. Raises Section if a cell is set in a block that did not fire, or has no range.
  std::vector<std::uint8_t> encode(const std::uint16_t* ranges, const std::uint8_t* returns, const RangeCells& cells,
                                   const MaskGeometry& geometry, std::uint32_t turn, std::uint32_t firing,
                                   const std::uint16_t* expected = nullptr, KnownColumns known = kWholeFrame,
                                   RiddleSamples* samples = nullptr, bool quick = false, std::uint16_t* sent = nullptr);

  // Goes on with other networks, or with none; what was learned stays. Raises Section if there were none or are none now.
  void change(std::shared_ptr<const RiddleNets> nets);

  // (64, W), within half a step, 0 outside of `returns`. `before`: (64, known), ranges of a slab's known columns. Raises
  // Section or Truncated.
  std::vector<std::uint16_t> decode(const std::uint8_t* data, std::size_t size, const std::uint8_t* returns,
                                    const RangeCells& cells, const MaskGeometry& geometry,
                                    const std::uint16_t* expected = nullptr, KnownColumns known = kWholeFrame,
                                    const std::uint16_t* before = nullptr);

  // Takes samples of what networks are told of a frame, and of what came. All else as for `encode`.
  static void sample(const std::uint16_t* ranges, const std::uint8_t* returns, const RangeCells& cells,
                     const MaskGeometry& geometry, std::uint32_t turn, const std::uint16_t* expected,
                     RiddleSamples& samples);

 private:
  // Raises Section if there are networks, but not that for such a frame.
  const RiddleNet* net_of(bool expects) const;

  Path path_;
  std::shared_ptr<const RiddleNets> nets_;
  PredictiveModel model_;
  std::unique_ptr<SlabStates> states_;  // of rows at the end of the last slab
};

}  // namespace lidarcodec
