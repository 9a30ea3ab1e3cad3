/** Whether gaps between sent columns are filled by default. */
import type { FleetRow, Stream } from "./wire";

const FOR_PROGRAMS = ["localise", "detect"];

/** Not for recordings, where users want to see measured points, and not for streams for programs. */
export function fillsFor(row: Pick<FleetRow, "playback"> | null, stream: Pick<Stream, "settings"> | null): boolean {
  const purpose = stream?.settings?.purpose;
  return (row === null || row.playback === null) && !(typeof purpose === "string" && FOR_PROGRAMS.includes(purpose));
}
