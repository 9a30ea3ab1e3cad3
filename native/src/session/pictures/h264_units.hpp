// NAL units of H.264 (ITU-T H.264, 7.3 and annex B): the content of an access unit, checked before a decoder from
// outside gets it; in Python lidarcodec/ranges/video/h264_units.py.
#pragma once
#include "session/outside.hpp"

namespace lidarcodec {

// Raises Section if a picture is no access unit of one IDR picture of these sides and bits, where it begins, or else of
// one P picture.
void check_h264(const Picture& picture);

}  // namespace lidarcodec
