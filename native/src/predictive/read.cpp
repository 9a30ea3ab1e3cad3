#include "predictive/paths.hpp"

namespace lidarcodec {

void read_image(const ImageCoding& on, const RowSource& source, PredictiveParts<WideDecoder>& parts,
                std::uint16_t* image) {
  code_image(on, source, parts, image);
}

}  // namespace lidarcodec
