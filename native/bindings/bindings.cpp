#include "bindings.hpp"

NB_MODULE(_native, m) {
  m.doc() =
      "Native core of lidarcodec. Every function checks its sizes, raises lidarcodec.errors and has no global state.";
  bind_errors(m);
  bind_crc32c(m);
  bind_activity(m);
  bind_neighbour(m);
  bind_voxel_index(m);
  bind_images(m);
  bind_mask(m);
  bind_mask_stream(m);
  bind_motion(m);
  bind_intensity(m);
  bind_layers(m);
  bind_riddle(m);
  bind_riddle_train(m);
  bind_predictive(m);
  bind_planes(m);
  bind_entropy(m);
  bind_simulator(m);
  bind_assembly(m);
  bind_points(m);
  bind_receiver(m);
  bind_session(m);
  bind_clouds(m);
  bind_reduction(m);
  bind_maps(m);
  bind_segments(m);
}
