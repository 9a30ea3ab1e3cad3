// Each binding file converts arrays to pointers and back for one part of the core, and does nothing else.
// lidarcodec/_native.pyi has the signatures: tools/native_stub.py generates it from the built module.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <utility>
#include <vector>

namespace nb = nanobind;

// Read-only, C-contiguous inputs. Bind them with .noconvert(); otherwise nanobind silently copies a strided array.
template <typename T, int N>
using In = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

// What functions return, with types for _native.pyi.
template <typename T>
using Array = nb::ndarray<nb::numpy, T>;
template <typename... T>
using Tuple = nb::typed<nb::tuple, T...>;
template <typename T>
using List = nb::typed<nb::list, T>;

// A vector handed to NumPy without a copy.
template <typename T>
Array<T> give(std::vector<T>&& values, std::initializer_list<std::size_t> shape) {
  auto* owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return Array<T>(owned->data(), shape, owner);
}

inline nb::bytes give_bytes(const std::vector<std::uint8_t>& v) {
  return nb::bytes(reinterpret_cast<const char*>(v.data()), v.size());
}

inline const std::uint8_t* data_of(const nb::bytes& b) { return reinterpret_cast<const std::uint8_t*>(b.c_str()); }

void bind_errors(nb::module_& m);
void bind_crc32c(nb::module_& m);
void bind_activity(nb::module_& m);
void bind_neighbour(nb::module_& m);
void bind_voxel_index(nb::module_& m);
void bind_images(nb::module_& m);
void bind_assembly(nb::module_& m);
void bind_points(nb::module_& m);
void bind_simulator(nb::module_& m);
void bind_mask(nb::module_& m);
void bind_mask_stream(nb::module_& m);
void bind_motion(nb::module_& m);
void bind_intensity(nb::module_& m);
void bind_layers(nb::module_& m);
void bind_planes(nb::module_& m);
void bind_predictive(nb::module_& m);
void bind_riddle(nb::module_& m);
void bind_riddle_train(nb::module_& m);
void bind_entropy(nb::module_& m);
void bind_receiver(nb::module_& m);
void bind_session(nb::module_& m);
void bind_clouds(nb::module_& m);
void bind_reduction(nb::module_& m);
void bind_maps(nb::module_& m);
void bind_segments(nb::module_& m);
