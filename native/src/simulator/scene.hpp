// Materials, the shapes of objects, and the nearest hit of a ray with an object.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "simulator/math.hpp"

namespace lidarcodec::sim {

enum class Material : std::uint8_t {
  Nothing,  // the beam is lost: sky, or glass that mirrors it away
  Asphalt,
  RoadPaint,
  Slabs,
  Cobbles,
  Grass,
  Gravel,
  Soil,
  Plaster,
  Brick,
  Concrete,
  Glass,
  Roof,
  Metal,
  Wood,
  Bark,
  Leaf,
  CarPaint,
  Cabin,
  Rubber,
  Cloth,
  Skin,
  Retro,
  Plastic,
  Painted,  // paint, paper and board, of the albedo of its object
  Count
};

struct Surface {
  double albedo;     // diffuse reflectivity at 905 nm
  double variation;  // of the albedo from place to place
  double rough_m;    // depth of its grain, one sigma
  double gloss;      // share that is mirrored away at slant incidence
};
const Surface& surface_of(Material material);

// What a return belongs to, for ground truth.
enum class Label : std::uint8_t { None, Ground, Building, Vegetation, Vehicle, Person, Pole, Other };

// What a road user is, for the truth of boxes.
enum class ObjectKind : std::uint8_t { None, Car, Van, Truck, Bus, Motorbike, Cyclist, Pedestrian };

enum class Shape : std::uint8_t {
  Taper,      // x0 x1 y0 y1 z0 | X0 X1 Y0 Y1 z1: a box whose top differs from its bottom: cabins, roofs, boxes
  Cylinder,   // cx cy r z0 z1, upright
  Wheel,      // cx cz r y0 y1, axis along y
  Ellipsoid,  // cx cy cz rx ry rz
  Leaves,     // cx cy cz rx ry rz density cell: an ellipsoid filled with leaves
  LeafBox,    // x0 x1 y0 y1 z0 z1 density cell: a hedge
  Facade,     // x0 x1 y0 y1 z0 z1 bay floor first: a house body with windows; see `style`
  Fence       // x0 x1 y z0 z1 pitch duty: an upright panel along x, partly open
};

struct Part {
  Shape shape = Shape::Taper;
  Material material = Material::Plaster;
  std::uint16_t style = 0;  // Facade: see FacadeStyle
  float a[10] = {};
  float lo[3] = {}, hi[3] = {};  // bounds, filled in by `bounded`
};

// Bits of a facade's style.
namespace facade {
constexpr std::uint16_t kWide = 1;       // wide windows
constexpr std::uint16_t kShop = 2;       // shop windows on the ground floor
constexpr std::uint16_t kBlindEnds = 4;  // no windows on the two sides across x
constexpr std::uint16_t kHall = 8;       // a hall: gates and a band of windows only
constexpr std::uint16_t kTall = 16;      // tall windows of an old house
}  // namespace facade

Part taper(Material m, double x0, double x1, double y0, double y1, double z0, double X0, double X1, double Y0,
           double Y1, double z1);
Part box(Material m, double x0, double x1, double y0, double y1, double z0, double z1);
Part cylinder(Material m, double cx, double cy, double r, double z0, double z1);
Part wheel(Material m, double cx, double cz, double r, double y0, double y1);
Part ellipsoid(Material m, double cx, double cy, double cz, double rx, double ry, double rz);
Part leaves(double cx, double cy, double cz, double rx, double ry, double rz, double density, double cell);
Part leaf_box(double x0, double x1, double y0, double y1, double z0, double z1, double density, double cell);
Part facade_box(Material m, double x0, double x1, double y0, double y1, double z0, double z1, double bay, double floor,
                double first, std::uint16_t style);
Part fence(Material m, double x0, double x1, double y, double z0, double z1, double pitch, double duty);

// A rigid object: parts in its own frame, a position and a heading. `vx, vy` move it during one index period.
struct Object {
  V3 at;
  double c = 1, s = 0;  // heading
  double vx = 0, vy = 0;
  const Part* parts = nullptr;
  std::uint32_t part_count = 0;
  std::uint32_t id = 0;  // seeds leaves, windows and textures
  float lo[3] = {}, hi[3] = {};
  float paint = 0.5F;  // albedo of CarPaint, Cloth and Painted
  Label label = Label::Other;
  ObjectKind kind = ObjectKind::None;
};
// Fills in the bounds from the parts.
void set_bounds(Object& object);

struct Ray {
  V3 origin, direction;
  std::uint64_t luck;  // random bits for the effect of glass and leaves on this beam
};

struct Hit {
  double t = 0;        // distance along the ray; hits beyond this do not count
  double cosine = 1;   // of the angle of incidence
  double albedo = -1;  // < 0: the material's own
  double rough_m = 0;  // added to the material's
  V3 local;            // where, in the frame of the object (or the world for the ground)
  Material material = Material::Nothing;
  Label label = Label::None;
  std::uint32_t id = 0;
};

// Sets `hit` to the nearest hit before `hit.t`; `dt` = seconds since the object's position was set.
void trace_object(const Object& object, const Ray& ray, double dt, Hit& hit);

}  // namespace lidarcodec::sim
