#include <array>

#include "simulator/scene.hpp"

namespace lidarcodec::sim {

const Surface& surface_of(Material material) {
  static constexpr std::array<Surface, static_cast<std::size_t>(Material::Count)> kSurfaces{{
      {0.00, 0.00, 0.000, 0.0},   // Nothing
      {0.17, 0.18, 0.0035, 0.1},  // Asphalt
      {0.62, 0.15, 0.001, 0.0},   // RoadPaint
      {0.32, 0.16, 0.002, 0.0},   // Slabs
      {0.25, 0.25, 0.006, 0.0},   // Cobbles
      {0.48, 0.22, 0.012, 0.0},   // Grass
      {0.30, 0.22, 0.008, 0.0},   // Gravel
      {0.22, 0.25, 0.010, 0.0},   // Soil
      {0.52, 0.12, 0.002, 0.0},   // Plaster
      {0.34, 0.20, 0.003, 0.0},   // Brick
      {0.40, 0.14, 0.002, 0.0},   // Concrete
      {0.10, 0.10, 0.001, 0.8},   // Glass
      {0.25, 0.20, 0.010, 0.0},   // Roof
      {0.40, 0.15, 0.001, 0.3},   // Metal
      {0.42, 0.20, 0.003, 0.0},   // Wood
      {0.30, 0.25, 0.006, 0.0},   // Bark
      {0.50, 0.30, 0.012, 0.0},   // Leaf
      {0.40, 0.05, 0.001, 0.5},   // CarPaint
      {0.10, 0.10, 0.001, 0.8},   // Cabin
      {0.06, 0.15, 0.002, 0.0},   // Rubber
      {0.40, 0.20, 0.006, 0.0},   // Cloth
      {0.55, 0.08, 0.002, 0.0},   // Skin
      {4.00, 0.10, 0.001, 0.0},   // Retro
      {0.35, 0.10, 0.001, 0.2},   // Plastic
      {0.50, 0.06, 0.001, 0.0},   // Painted
  }};
  return kSurfaces[static_cast<std::size_t>(material)];
}

namespace {

float f(double x) { return static_cast<float>(x); }

Part bounded(Part p, double x0, double x1, double y0, double y1, double z0, double z1) {
  p.lo[0] = f(x0), p.hi[0] = f(x1), p.lo[1] = f(y0), p.hi[1] = f(y1), p.lo[2] = f(z0), p.hi[2] = f(z1);
  return p;
}

Part make(Shape shape, Material material, std::initializer_list<double> values) {
  Part p;
  p.shape = shape;
  p.material = material;
  int k = 0;
  for (const double v : values) p.a[k++] = f(v);
  return p;
}

}  // namespace

Part taper(Material m, double x0, double x1, double y0, double y1, double z0, double X0, double X1, double Y0,
           double Y1, double z1) {
  return bounded(make(Shape::Taper, m, {x0, x1, y0, y1, z0, X0, X1, Y0, Y1, z1}), min_of(x0, X0), max_of(x1, X1),
                 min_of(y0, Y0), max_of(y1, Y1), z0, z1);
}
Part box(Material m, double x0, double x1, double y0, double y1, double z0, double z1) {
  return taper(m, x0, x1, y0, y1, z0, x0, x1, y0, y1, z1);
}
Part cylinder(Material m, double cx, double cy, double r, double z0, double z1) {
  return bounded(make(Shape::Cylinder, m, {cx, cy, r, z0, z1}), cx - r, cx + r, cy - r, cy + r, z0, z1);
}
Part wheel(Material m, double cx, double cz, double r, double y0, double y1) {
  return bounded(make(Shape::Wheel, m, {cx, cz, r, y0, y1}), cx - r, cx + r, y0, y1, cz - r, cz + r);
}
Part ellipsoid(Material m, double cx, double cy, double cz, double rx, double ry, double rz) {
  return bounded(make(Shape::Ellipsoid, m, {cx, cy, cz, rx, ry, rz}), cx - rx, cx + rx, cy - ry, cy + ry, cz - rz,
                 cz + rz);
}
Part leaves(double cx, double cy, double cz, double rx, double ry, double rz, double density, double cell) {
  return bounded(make(Shape::Leaves, Material::Leaf, {cx, cy, cz, rx, ry, rz, density, cell}), cx - rx, cx + rx,
                 cy - ry, cy + ry, cz - rz, cz + rz);
}
Part leaf_box(double x0, double x1, double y0, double y1, double z0, double z1, double density, double cell) {
  return bounded(make(Shape::LeafBox, Material::Leaf, {x0, x1, y0, y1, z0, z1, density, cell}), x0, x1, y0, y1, z0, z1);
}
Part facade_box(Material m, double x0, double x1, double y0, double y1, double z0, double z1, double bay, double floor,
                double first, std::uint16_t style) {
  Part p = bounded(make(Shape::Facade, m, {x0, x1, y0, y1, z0, z1, bay, floor, first}), x0, x1, y0, y1, z0, z1);
  p.style = style;
  return p;
}
Part fence(Material m, double x0, double x1, double y, double z0, double z1, double pitch, double duty) {
  return bounded(make(Shape::Fence, m, {x0, x1, y, z0, z1, pitch, duty}), x0, x1, y - 0.04, y + 0.04, z0, z1);
}

void set_bounds(Object& object) {
  for (int k = 0; k < 3; ++k) {
    object.lo[k] = object.part_count ? object.parts[0].lo[k] : 0.0F;
    object.hi[k] = object.part_count ? object.parts[0].hi[k] : 0.0F;
    for (std::uint32_t i = 1; i < object.part_count; ++i) {
      if (object.parts[i].lo[k] < object.lo[k]) object.lo[k] = object.parts[i].lo[k];
      if (object.hi[k] < object.parts[i].hi[k]) object.hi[k] = object.parts[i].hi[k];
    }
  }
}

}  // namespace lidarcodec::sim
