#include "predictive/paths.hpp"

namespace lidarcodec {

void write_image(const ImageCoding& on, const RowSource& source, PredictiveParts<WideEncoder>& parts,
                 const std::uint16_t* image) {
  code_image(on, source, parts, image);
}

}  // namespace lidarcodec
