/** Prints what a live stream sees: `node print_points.js ws://127.0.0.1:8080/api/v1/streams/car/lidar/frames`.
 *
 * Messages come as the vehicle sent them and are decoded here (docs/live-sockets.md). Node 20 and 21 want the option
 * `--experimental-websocket` before the file. A second argument ends it after so many frames; the environment's
 * LIDARCODEC_TOKEN is sent where the server wants one. */

import { Decoder, DecodeError, isImageFrame, pointsOf } from "../src/index.js";

const [url, count] = process.argv.slice(2);
if (url === undefined) {
  console.error("usage: node print_points.js ws://HOST:PORT/api/v1/streams/VEHICLE/SENSOR/frames [FRAMES]");
  process.exit(2);
}
const token = process.env.LIDARCODEC_TOKEN;
const decoder = await Decoder.create();
const socket = new WebSocket(url, token ? ["lidarcodec", `lidarcodec.token.${token}`] : ["lidarcodec"]);
socket.binaryType = "arraybuffer";
let left = count === undefined ? Infinity : Number(count);

socket.onmessage = ({ data }: MessageEvent<string | ArrayBuffer>) => {
  if (typeof data === "string") {
    const { event, vehicle, sensor } = JSON.parse(data) as Record<string, unknown>;
    console.log(event === "hello" ? `${vehicle}/${sensor}` : `${event}`);
    return;
  }
  try {
    const frame = decoder.decode(new Uint8Array(data));
    if (isImageFrame(frame)) {
      const planes = frame.planes.map(({ name }) => name).join(", ");
      console.log(`frame ${frame.index} of a ${frame.sensor.name}: ${frame.returns} returns, planes ${planes}`);
    } else {
      const { xyz, count: points } = pointsOf(frame);
      const metres = Array.from(xyz.subarray(0, 3), (value) => value.toFixed(2)).join(", ");
      console.log(`frame ${frame.index}: ${points} points${points ? `, the first at ${metres} m` : ""}`);
    }
    left--;
  } catch (error) {
    if (!(error instanceof DecodeError)) throw error;
    console.error(`${error.code}: ${error.message}`);
  }
  socket.send("ack"); // and the next one comes
  if (left <= 0) socket.close();
};
socket.onclose = ({ code, reason }) => {
  if (left > 0) console.error(`closed: ${code} ${reason}`);
  process.exitCode = left > 0 ? 1 : 0;
};
