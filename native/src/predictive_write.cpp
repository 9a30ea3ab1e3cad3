#include "predictive_paths.hpp"

namespace lidarcodec {

void write_image(const ImageCoding& on, const RowSource& source, std::array<PredictiveHalf<WideEncoder>, 2>& halves, const std::uint16_t* image) {
  code_image(on, source, halves, image);
}

}  // namespace lidarcodec
