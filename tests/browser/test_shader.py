"""The points that a graphics card makes of a range image are those of `Frame.cloud`, to a millimetre."""

from __future__ import annotations

import base64
import re
from dataclasses import replace

import numpy as np
import pytest

from lidarcodec import read_frames
from lidarcodec_server.live.cloud_format import sensor_facts
from tests.conftest import ROOT
from tests.sweeps import sampled

VIEW = ROOT / "clients" / "web" / "src" / "view"

RUN = """
([vertex, fragment, width, arrays, step, ros]) => {
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const gl = document.createElement("canvas").getContext("webgl2");
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.transformFeedbackVaryings(program, ["v_point"], gl.SEPARATE_ATTRIBS);
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  const at = (name) => gl.getUniformLocation(program, name);
  const texture = (unit, name, internal, format, type, wide, high, data) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, wide, high, 0, format, type, data);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.uniform1i(at(name), unit);
  };
  const range = new Uint16Array(bytes(arrays.range));
  texture(0, "u_range", gl.R16UI, gl.RED_INTEGER, gl.UNSIGNED_SHORT, width, 64, range);
  texture(1, "u_original", gl.R16UI, gl.RED_INTEGER, gl.UNSIGNED_SHORT, width, 64, range);
  const azimuth = new Uint16Array(bytes(arrays.azimuth));
  texture(2, "u_azimuth", gl.R16UI, gl.RED_INTEGER, gl.UNSIGNED_SHORT, width, 2, azimuth);
  texture(3, "u_sensor", gl.RGBA32F, gl.RGBA, gl.FLOAT, 3, 64, new Float32Array(bytes(arrays.sensor)));
  texture(4, "u_turn", gl.RG32F, gl.RG, gl.FLOAT, 256, 141, new Float32Array(bytes(arrays.turn)));
  texture(5, "u_intensity", gl.R8UI, gl.RED_INTEGER, gl.UNSIGNED_BYTE, 1, 1, new Uint8Array(1));
  texture(6, "u_maps", gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, 1, 1, new Uint8Array(4));
  const still = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  gl.uniformMatrix4fv(at("u_place"), false, still);
  gl.uniformMatrix4fv(at("u_view"), false, still);
  gl.uniform1f(at("u_step"), step);
  gl.uniform1i(at("u_ros"), ros);
  gl.uniform1i(at("u_rings"), 64);
  const count = 64 * width;
  gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, gl.createBuffer());
  gl.bufferData(gl.TRANSFORM_FEEDBACK_BUFFER, 12 * count, gl.STATIC_READ);
  gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, gl.getParameter(gl.TRANSFORM_FEEDBACK_BUFFER_BINDING));
  gl.enable(gl.RASTERIZER_DISCARD);
  gl.beginTransformFeedback(gl.POINTS);
  gl.drawArrays(gl.POINTS, 0, count);
  gl.endTransformFeedback();
  const out = new Uint8Array(12 * count);
  gl.getBufferSubData(gl.TRANSFORM_FEEDBACK_BUFFER, 0, out);
  let text = "";
  for (let from = 0; from < out.length; from += 8192) text += String.fromCharCode(...out.subarray(from, from + 8192));
  return btoa(text);
}
"""


def shader(name: str) -> str:
    """A shader as the page hands it to the card."""
    texts = dict(re.findall(r"const (\w+) = `(.*?)`;", (VIEW / "draw" / "shaders.ts").read_text(), flags=re.DOTALL))
    return re.sub(r"\$\{(\w+)\}", lambda found: texts[found[1]], texts[name])


def sensor_table(facts) -> np.ndarray:
    """(64, 3, 4) float32: what `sensor.ts` makes of the socket's event `sensor`."""
    of = {name: np.array(values) for name, values in facts.items() if isinstance(values, list)}
    turn, up, far = of["rot_correction_rad"], of["vert_correction_rad"], of["dist_correction_m"]
    along = (of["dist_correction_y_m"] - far) / (25.04 - 1.93)
    across = (of["dist_correction_x_m"] - far) / (25.04 - 2.4)
    rows = [np.cos(turn), np.sin(turn), np.cos(up), np.sin(up)]
    rows += [far, of["vert_offset_m"], of["horiz_offset_m"], of["block"], along, across, turn, up]
    return np.stack(rows, axis=1).astype("<f4").reshape(64, 3, 4)


@pytest.mark.parametrize("convention", sampled(["ros", "veloview"], ["veloview"]))
def test_a_vertex_lies_where_the_library_says_its_return_is(page_of, convention):
    frame = next(read_frames("sim:city?frames=1"))
    rng = np.random.default_rng(5)
    model = frame.sensor
    values = {name: model.calibration[name] for name in ("rot_correction_rad", "vert_correction_rad", "vert_offset_m")}
    values["horiz_offset_m"] = rng.uniform(-0.03, 0.03, 64)
    for name in ("dist_correction_m", "dist_correction_x_m", "dist_correction_y_m"):
        values[name] = rng.uniform(0.9, 1.4, 64)
    sensor = replace(model, calibration=type(model.calibration).from_values(values), convention=convention)
    frame = frame.with_(sensor=sensor)
    turn = np.zeros((141 * 256, 2), "<f4")
    angles = np.arange(36000) * 2 * np.pi / 36000
    turn[:36000] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    arrays = {
        "range": frame.range.astype("<u2"),
        "azimuth": frame.azimuth.astype("<u2"),
        "sensor": sensor_table(sensor_facts(sensor)),
        "turn": turn,
    }
    packed = {name: base64.b64encode(array.tobytes()).decode() for name, array in arrays.items()}
    page = page_of("about:blank")
    drawn = page.evaluate(
        RUN,
        [
            shader("POINTS_VERTEX"), shader("POINTS_FRAGMENT"), frame.width, packed,
            sensor.range_step_m, convention == "ros",
        ],
    )  # fmt: skip
    points = np.frombuffer(base64.b64decode(drawn), "<f4").reshape(frame.width, 64, 3)[frame.valid.T]
    cloud = frame.cloud()
    wanted = np.stack([cloud[axis] for axis in "xyz"], axis=1)
    assert len(wanted) > 50_000
    assert np.abs(points - wanted).max() < 0.001
