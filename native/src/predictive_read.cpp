#include "predictive_paths.hpp"

namespace lidarcodec {

void read_image(const ImageCoding& on, const RowSource& source, std::array<PredictiveHalf<WideDecoder>, 2>& halves, std::uint16_t* image) {
  code_image(on, source, halves, image);
}

}  // namespace lidarcodec
