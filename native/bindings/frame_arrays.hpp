// The arrays by which a frame's columns and a sensor's beams are known to the native core.
#pragma once
#include "base/error.hpp"
#include "bindings.hpp"
#include "motion/beams.hpp"
#include "motion/range_history.hpp"

inline constexpr std::size_t kMostColumns = 24'576;

inline lidarcodec::Columns columns_of(const In<std::uint16_t, 2>& azimuth, const In<std::uint8_t, 2>& fired) {
  if (azimuth.shape(0) != 2 || fired.shape(0) != 2 || azimuth.shape(1) != fired.shape(1) ||
      fired.shape(1) > kMostColumns)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section,
                            "columns need azimuth (2, W) and fired (2, W), W up to 24576");
  return {azimuth.shape(1), azimuth.data(), fired.data()};
}

inline lidarcodec::BeamTable table_of(const In<std::int32_t, 2>& rows) {
  if (rows.shape(0) != 6 || rows.shape(1) != lidarcodec::kRows)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "beams need a table (6, 64)");
  const std::int32_t* at = rows.data();
  using lidarcodec::kRows;
  lidarcodec::BeamTable table;
  for (std::size_t r = 0; r < kRows; ++r) {
    table.half[r] = at[r] != 0;
    table.rotation[r] = at[kRows + r];
    table.vertical[r] = at[2 * kRows + r];
    table.distance[r] = at[3 * kRows + r];
    table.vertical_offset[r] = at[4 * kRows + r];
    table.horizontal_offset[r] = at[5 * kRows + r];
  }
  return table;
}
