/** What runs on the graphics card. The range image becomes points here, cell by cell, in the vertex shader. */

const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
`;

/** A return of ring and column as a point in metres, by the formula of docs/live-sockets.md.
 *
 * Sines of graphics cards may be wrong by a centimetre at 100 m, so azimuths are looked up (36,000 pairs, made on the
 * processor) and the rotation correction is added by the addition theorem. */
const POINT = `
uniform usampler2D u_azimuth;
uniform sampler2D u_sensor;
uniform sampler2D u_turn;
uniform float u_step;
uniform bool u_ros;

vec2 turned(int ring, int column) {
  int block = texelFetch(u_sensor, ivec2(1, ring), 0).w > 0.5 ? 1 : 0;
  int azimuth = int(texelFetch(u_azimuth, ivec2(column, block), 0).r) % 36000;
  return texelFetch(u_turn, ivec2(azimuth & 255, azimuth >> 8), 0).rg;
}

vec3 pointOf(uint range, int ring, int column) {
  vec4 angle = texelFetch(u_sensor, ivec2(0, ring), 0);
  vec4 shift = texelFetch(u_sensor, ivec2(1, ring), 0);
  vec2 a = turned(ring, column);
  float c = a.x * angle.x + a.y * angle.y;
  float s = a.y * angle.x - a.x * angle.y;
  float d = float(range) * u_step + shift.x;
  float flat_ = d * angle.z - (u_ros ? shift.y * angle.w : 0.0);
  vec3 p = vec3(flat_ * c + shift.z * s, shift.z * c - flat_ * s, d * angle.w + shift.y * (u_ros ? angle.z : 1.0));
  if (u_ros) {
    vec2 near = texelFetch(u_sensor, ivec2(2, ring), 0).xy * max(25.04 - abs(p.xy), 0.0);
    p += vec3(near.x * angle.z * c, -near.y * angle.z * s, near.x * angle.w);
  }
  return p;
}
`;

/** The colour of a return. u_mode: a row of the maps; error is in the fifth. */
const COLOUR = `
uniform usampler2D u_intensity;
uniform sampler2D u_maps;
uniform int u_mode;
uniform int u_rings;
uniform float u_ground;
uniform vec2 u_height;
uniform float u_far;
uniform float u_errorScale;
uniform bool u_hasIntensity;
uniform usampler2D u_filled;
uniform bool u_hasFilled;
/* How far the colour of a made-up return goes towards the ground on which it is drawn: less in the range image, where
   those that were sent would stand as stripes. */
const float FAINT = 0.45;
const float FAINT_IN_IMAGE = 0.2;

/** Whether a return was made up between columns that were sent: it is drawn fainter. */
bool madeUp(int ring, int column) {
  return u_hasFilled && texelFetch(u_filled, ivec2(column, ring), 0).r != 0u;
}

vec3 mapped(float t, int row) {
  return texture(u_maps, vec2((clamp(t, 0.0, 1.0) * 255.0 + 0.5) / 256.0, (float(row) + 0.5) / 5.0)).rgb;
}

/** How high a point is in the span that the colours of heights cover, 0 to 1. */
float colourHeight(vec3 p) {
  return clamp((p.z - u_ground - u_height.x) / (u_height.y - u_height.x), 0.0, 1.0);
}

vec3 colourOf(vec3 p, uint range, int ring, int column, float error) {
  float t = 0.0;
  if (u_mode == 0) t = (p.z - u_ground - u_height.x) / (u_height.y - u_height.x);
  else if (u_mode == 1) {
    float i = u_hasIntensity ? float(texelFetch(u_intensity, ivec2(column, ring), 0).r) : 0.0;
    t = pow(i / 255.0, 0.6);
  } else if (u_mode == 2) t = sqrt(float(range) * u_step / u_far);
  else if (u_mode == 3) t = float(ring) / float(max(u_rings - 1, 1));
  else t = error * u_errorScale;
  return mapped(t, u_mode);
}
`;

/** One vertex a cell of the range image; those without a return are put outside. */
export const POINTS_VERTEX = `${HEAD}
uniform usampler2D u_range;
uniform usampler2D u_original;
uniform mat4 u_place;
uniform mat4 u_view;
uniform float u_size;
uniform bool u_compare;
uniform vec3 u_dropped;
uniform vec3 u_invented;
uniform vec3 u_paper;
uniform float u_fade;
uniform bool u_boxed;
uniform vec3 u_least;
uniform vec3 u_greatest;
uniform bool u_tinted;
uniform vec3 u_tint;
${POINT}
${COLOUR}
out vec3 v_colour;
out vec3 v_point;

void main() {
  int column = gl_VertexID / u_rings;
  int ring = gl_VertexID - column * u_rings;
  uint range = texelFetch(u_range, ivec2(column, ring), 0).r;
  uint shown = range;
  float error = 0.0;
  bool dropped = false;
  bool invented = false;
  if (u_compare) {
    uint original = texelFetch(u_original, ivec2(column, ring), 0).r;
    dropped = range == 0u && original != 0u;
    invented = range != 0u && original == 0u;
    error = abs(float(range) - float(original)) * u_step;
    shown = dropped ? original : range;
  }
  v_point = vec3(0.0);
  v_colour = vec3(0.0);
  if (shown == 0u) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = 1.0;
    return;
  }
  v_point = pointOf(shown, ring, column);
  vec4 placed = u_place * vec4(v_point, 1.0);
  vec3 above = placed.xyz - vec3(0.0, 0.0, u_ground);
  if (u_boxed && (any(lessThan(above, u_least)) || any(greaterThan(above, u_greatest)))) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = 1.0;
    return;
  }
  gl_Position = u_view * placed;
  float near = clamp(24.0 / max(gl_Position.w, 0.1), 0.8, 3.0);
  bool faint = madeUp(ring, column);
  gl_PointSize = max(1.0, u_size * near * (dropped || faint ? 0.75 : 1.0));
  vec3 colour = dropped ? u_dropped : invented ? u_invented
    : u_tinted ? u_tint * (0.6 + 0.4 * sqrt(colourHeight(placed.xyz))) : colourOf(placed.xyz, shown, ring, column, error);
  v_colour = mix(mix(colour, u_paper, faint ? FAINT : 0.0), u_paper, u_fade);
}
`;

export const POINTS_FRAGMENT = `${HEAD}
in vec3 v_colour;
in vec3 v_point;
out vec4 o_colour;
void main() {
  o_colour = vec4(v_colour, 1.0);
}
`;

/** A triangle that covers everything; gl_VertexID 0..2. */
export const COVER_VERTEX = `${HEAD}
out vec2 v_at;
void main() {
  v_at = vec2(float((gl_VertexID << 1) & 2), float(gl_VertexID & 2));
  gl_Position = vec4(v_at * 2.0 - 1.0, 0.0, 1.0);
}
`;

/** Shade where the depth falls off around a point (eye-dome lighting): edges stand out without a normal. */
export const SHADE_FRAGMENT = `${HEAD}
uniform sampler2D u_colour;
uniform sampler2D u_depth;
uniform vec2 u_planes;
uniform float u_reach;
uniform float u_strength;
in vec2 v_at;
out vec4 o_colour;

float log2Distance(ivec2 at) {
  float depth = texelFetch(u_depth, at, 0).r;
  if (depth == 1.0) return 0.0;
  float z = depth * 2.0 - 1.0;
  return log2(2.0 * u_planes.x * u_planes.y / (u_planes.y + u_planes.x - z * (u_planes.y - u_planes.x)));
}

void main() {
  ivec2 size = textureSize(u_colour, 0);
  ivec2 at = ivec2(v_at * vec2(size));
  vec4 colour = texelFetch(u_colour, at, 0);
  float here = log2Distance(at);
  if (here != 0.0) {
    float fall = 0.0;
    int reach = int(u_reach);
    for (int i = 0; i < 4; i++) {
      ivec2 way = i == 0 ? ivec2(reach, 0) : i == 1 ? ivec2(-reach, 0) : i == 2 ? ivec2(0, reach) : ivec2(0, -reach);
      float there = log2Distance(clamp(at + way, ivec2(0), size - 1));
      if (there != 0.0) fall += max(0.0, here - there);
    }
    colour.rgb *= max(exp(-u_strength * fall), 0.45);
  }
  o_colour = colour;
}
`;

/** The ground: a grid of 10 m that stands still in the world, range rings, and the vehicle. */
export const GROUND_VERTEX = `${HEAD}
uniform mat4 u_view;
uniform float u_ground;
uniform float u_reach;
out vec2 v_at;
void main() {
  vec2 corner = vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1)) * 2.0 - 1.0;
  v_at = corner * u_reach;
  gl_Position = u_view * vec4(v_at, u_ground, 1.0);
}
`;

export const GROUND_FRAGMENT = `${HEAD}
uniform vec4 u_world;
uniform vec2 u_worldAt;
uniform float u_reach;
uniform vec3 u_ink;
uniform vec3 u_accent;
in vec2 v_at;
out vec4 o_colour;

float line(float value, float each, float width) {
  float wide = fwidth(value);
  float off = abs(fract(value / each + 0.5) - 0.5) * each;
  return (1.0 - smoothstep(0.0, width * wide, off)) * clamp(1.0 - 3.0 * wide / each, 0.0, 1.0);
}

float ring(float r, float radius, float width) {
  float wide = fwidth(r);
  return 1.0 - smoothstep(0.0, width * wide, abs(r - radius));
}

float box(vec2 p, vec2 half_, float round_) {
  vec2 d = abs(p) - half_ + round_;
  return length(max(d, 0.0)) + min(max(d.x, d.y), 0.0) - round_;
}

void main() {
  float r = length(v_at);
  vec2 world = mat2(u_world.xy, u_world.zw) * v_at + u_worldAt;
  float grid = max(line(world.x, 10.0, 1.2), line(world.y, 10.0, 1.2)) * 0.16;
  float rings = 0.0;
  for (int i = 0; i < 6; i++) {
    float radius = i < 1 ? 10.0 : float(i) * 20.0;
    rings = max(rings, ring(r, radius, 1.4) * 0.42);
  }
  float fade = 1.0 - smoothstep(0.55 * u_reach, u_reach, r);
  vec4 colour = vec4(u_ink, max(grid, rings) * fade);
  float wide = fwidth(r);
  float car = box(v_at + vec2(0.3, 0.0), vec2(2.2, 0.9), 0.35);
  float edge = 1.0 - smoothstep(0.0, 1.5 * wide + 0.03, abs(car) - 0.04);
  float inside = car < 0.0 ? 0.22 : 0.0;
  vec2 tip = v_at - vec2(1.55, 0.0);
  float arrow = max(tip.x, max(abs(tip.y) * 0.87 + tip.x * 0.5, -tip.x - 0.9)) < 0.0 ? 0.9 : 0.0;
  float mark = max(edge * 0.9, max(inside, arrow));
  colour = mix(colour, vec4(u_accent, 1.0), mark);
  colour.a = max(colour.a, mark);
  o_colour = vec4(colour.rgb * colour.a, colour.a);
}
`;

/** Texts on the ground, a fixed size on the screen. */
export const LABEL_VERTEX = `${HEAD}
uniform mat4 u_view;
uniform vec3 u_at;
uniform vec2 u_half;
uniform vec4 u_part;
out vec2 v_at;
void main() {
  vec2 corner = vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1));
  vec4 p = u_view * vec4(u_at, 1.0);
  v_at = u_part.xy + vec2(corner.x, 1.0 - corner.y) * u_part.zw;
  gl_Position = p + vec4((corner * 2.0 - 1.0) * u_half * p.w, 0.0, 0.0);
}
`;

export const LABEL_FRAGMENT = `${HEAD}
uniform sampler2D u_text;
uniform vec3 u_ink;
in vec2 v_at;
out vec4 o_colour;
void main() {
  float a = texture(u_text, v_at).a * 0.85;
  o_colour = vec4(u_ink * a, a);
}
`;

/** The range image as it would be seen all around: ahead in the middle, left on the left.
 *
 * Lasers of one column look up to 18 degrees apart, so each row is moved by its rotation correction. */
export const IMAGE_FRAGMENT = `${HEAD}
uniform usampler2D u_range;
uniform usampler2D u_original;
uniform int u_columns;
uniform float u_coverage;
uniform bool u_compare;
uniform vec3 u_none;
uniform vec3 u_dropped;
uniform vec3 u_invented;
${POINT}
${COLOUR}
in vec2 v_at;
out vec4 o_colour;

const float TURN = 6.283185307179586;

void main() {
  int ring = clamp(int((1.0 - v_at.y) * float(u_rings)), 0, u_rings - 1);
  float first = float(texelFetch(u_azimuth, ivec2(0, 0), 0).r) / 36000.0;
  float correction = texelFetch(u_sensor, ivec2(2, ring), 0).z / TURN;
  // a column later is coverage / columns of a turn further to the right
  float turn = fract(v_at.x - 0.5 + correction - first + 2.0) / u_coverage;
  if (turn > 1.0) discard;  // not in this part of a turn
  int column = min(int(turn * float(u_columns)), u_columns - 1);
  vec3 colour = u_none;
  for (int i = 0; i < 2; i++) {  // two columns share a pixel of most screens: one with a return is shown
    int at = min(column + i, u_columns - 1);
    uint range = texelFetch(u_range, ivec2(at, ring), 0).r;
    uint original = u_compare ? texelFetch(u_original, ivec2(at, ring), 0).r : range;
    if (range != 0u && original != 0u) {
      float error = abs(float(range) - float(original)) * u_step;
      colour = colourOf(pointOf(range, ring, at), range, ring, at, error);
      if (madeUp(ring, at)) {  // a measured one beside it comes first
        colour = mix(colour, u_none, FAINT_IN_IMAGE);
        continue;
      }
      break;
    }
    if (range != 0u) { colour = mix(u_invented, u_none, madeUp(ring, at) ? FAINT_IN_IMAGE : 0.0); break; }
    if (original != 0u) { colour = u_dropped; break; }
  }
  o_colour = vec4(colour, 1.0);
}
`;
