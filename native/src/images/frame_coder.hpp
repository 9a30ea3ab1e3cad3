// The planes of a frame together: rows that are aligned, and the coders of all planes.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "images/heads.hpp"
#include "images/plane_coder.hpp"

namespace lidarcodec {

// Column of the image of each column of the aligned row: neighbouring rows look in one direction then.
class Alignment {
 public:
  explicit Alignment(const PlaneFrame& frame) : columns_(frame.columns), first_(frame.rows) {
    if (columns_ == 0) return;
    const auto columns = static_cast<std::int64_t>(columns_);
    for (std::size_t row = 0; row < frame.rows; ++row)
      first_[row] = static_cast<std::size_t>((-std::int64_t{frame.shift[row]} % columns + columns) % columns);
  }
  // Calls act(column of the aligned row, cell of the image).
  template <class Act>
  void for_row(std::size_t row, const Act& act) const {
    const std::size_t first = first_[row], rest = columns_ - first;
    for (std::size_t x = 0; x < rest; ++x) act(x, row * columns_ + first + x);
    for (std::size_t x = rest; x < columns_; ++x) act(x, row * columns_ + x - rest);
  }

 private:
  std::size_t columns_;
  std::vector<std::size_t> first_;
};

// The numbers of a plane in rows that are aligned.
inline PlaneNumbers numbers_of(const PlaneImage& image, const PlaneFrame& frame, std::size_t plane,
                               const Alignment& alignment) {
  const PlaneForm& form = frame.planes[plane];
  const std::uint32_t most = (1u << form.bits) - 1;
  if (std::any_of(image.begin(), image.end(), [&](std::uint32_t value) { return value > most; }))
    throw Error(ErrorCode::Settings, "a plane has a value of more bits than it says");
  const RangeSteps steps(frame.step, form.bits);
  PlaneNumbers numbers(image.size());
  for (std::size_t row = 0; row < frame.rows; ++row) {
    std::int32_t* const to = numbers.data() + row * frame.columns;
    alignment.for_row(row, [&](std::size_t x, std::size_t cell) {
      const std::uint32_t value = image[cell];
      to[x] = static_cast<std::int32_t>(form.role == PlaneRole::Attribute ? value : steps.number(value));
    });
  }
  return numbers;
}

// The planes of a frame, row by row, each by its coder.
template <class Coder, PlaneEffort Effort>
class FrameCoder {
 public:
  explicit FrameCoder(std::size_t columns) : columns_(columns) {}

  // models: outlive this.
  void add(const PlaneHead& head, PlaneModels<Effort>& models, Coder coder) {
    heads_.push_back(head);
    coders_.push_back(std::make_unique<PlaneCoder<Coder, Effort>>(head.plan, columns_, models, std::move(coder)));
  }
  // values: of each plane, the row's.
  void code_row(std::size_t row, const std::vector<std::int32_t*>& values) {
    for (std::size_t plane = 0; plane < heads_.size(); ++plane) {
      const PlaneForm& form = heads_[plane].plan.form;
      OtherPlanes others;
      others.range = &coders_[form.of]->rows();
      if (form.like != plane) others.like = &coders_[form.like]->rows();
      if (heads_[plane].mate != kNoMate) others.mate = &coders_[heads_[plane].mate]->rows();
      const std::size_t kin = kin_of(plane);
      if (kin < plane) others.kin = &coders_[kin]->rows();
      coders_[plane]->begin_row(row, values[plane], others);
    }
    // Each plane is one cell behind the one before: their streams wait for each other as little as can be.
    for (std::size_t step = 0; step < columns_ + heads_.size(); ++step)
      for (std::size_t plane = 0; plane < heads_.size(); ++plane)
        if (step - plane < columns_) coders_[plane]->code(static_cast<std::ptrdiff_t>(step - plane));
  }
  PlaneCoder<Coder, Effort>& operator[](std::size_t plane) { return *coders_[plane]; }

 private:
  // The plane's own number if there is none.
  std::size_t kin_of(std::size_t plane) const {
    const PlaneForm& form = heads_[plane].plan.form;
    if (form.role != PlaneRole::Attribute || heads_[plane].mate != kNoMate) return std::min(plane, heads_[plane].mate);
    std::size_t kin = 0;
    while (kin < plane && (heads_[kin].plan.form.role != PlaneRole::Attribute || heads_[kin].plan.form.of != form.of ||
                           heads_[kin].plan.way == PlaneWay::Constant))
      ++kin;
    return kin;
  }

  std::size_t columns_;
  std::vector<PlaneHead> heads_;
  std::vector<std::unique_ptr<PlaneCoder<Coder, Effort>>> coders_;
};

// The numbers of all planes. Raises Settings if images or values do not fit the frame.
inline std::vector<PlaneNumbers> numbers_of_all(const PlaneFrame& frame, const std::vector<PlaneImage>& images) {
  const std::size_t cells = frame.rows * frame.columns;
  if (images.size() != frame.planes.size()) throw Error(ErrorCode::Settings, "a frame has one image for each plane");
  const Alignment alignment(frame);
  std::vector<PlaneNumbers> all;
  for (std::size_t plane = 0; plane < images.size(); ++plane) {
    if (images[plane].size() != cells) throw Error(ErrorCode::Settings, "the images of planes have H times W cells");
    all.push_back(numbers_of(images[plane], frame, plane, alignment));
  }
  return all;
}

// Values of a plane as a decoder gets them.
class PlaneValues {
 public:
  PlaneValues(const PlaneFrame& frame, const PlaneHead& head)
      : attribute_(head.plan.form.role == PlaneRole::Attribute),
        unit_(head.unit),
        steps_(frame.step, head.plan.form.bits) {}

  std::uint32_t value(std::int32_t number) const {
    const auto n = static_cast<std::uint32_t>(number);
    return attribute_ ? n * unit_ : steps_.range(n);
  }
  std::int32_t number(std::uint32_t value) const {
    return static_cast<std::int32_t>(attribute_ ? value / unit_ : steps_.number(value));
  }

 private:
  bool attribute_;
  std::uint32_t unit_;
  RangeSteps steps_;
};

}  // namespace lidarcodec
