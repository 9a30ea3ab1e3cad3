// Messages of jpeg-layered: several frames, and one picture in which the rows of a laser are its turns
// (docs/wire-format.md, "jpeg-layered"); in Python lidarcodec/ranges/image/group_head.py and layers.py.
#pragma once
#include "session/frames/image_frame.hpp"
#include "session/planes.hpp"

namespace lidarcodec {

// A message of several frames. alone: for each frame a message as if it were alone; turn and starts say where its
// columns lie in the picture; rest: what follows
struct Group {
  std::vector<Message> alone;
  std::size_t turn = 0;
  std::vector<std::uint64_t> starts;
  Bytes rest;
};

// data: the RANGE section from the head of the group on. Raises Section.
Group split_group(Bytes data, const Message& message);

// Raises Section for a message of too many frames, or that needs another.
void check_group(const Message& message);

// Raises Section if the planes of frames of another sensor than an HDL-64E are too large to be decoded together, or
// Truncated.
void check_sizes(const Group& group);

// Puts the ranges of a group into the planes of its frames, of HDL-64Es. Raises Section.
void put_group_ranges(const Group& group, const Outside& outside, const std::vector<Planes*>& frames);

// The same of another sensor, with ranges of so many bits. Raises Section.
void put_group_ranges(const Group& group, std::uint32_t bits, const Outside& outside,
                      const std::vector<ImageFrame*>& frames);

// Raises Section if frames of so many columns lie over each other, or are too large for a picture.
void check_layers(const Group& group, std::size_t rows, const std::vector<std::size_t>& widths);

}  // namespace lidarcodec
