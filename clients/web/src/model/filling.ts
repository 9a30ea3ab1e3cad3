/** Whether gaps between the columns that were sent are filled, unless somebody wants it otherwise. */
import type { FleetRow, Stream } from "./wire";

const FOR_PROGRAMS = ["localise", "detect"];

/** Not of recordings, which are looked at for what was measured, and not of streams for programs. */
export function fillsFor(row: Pick<FleetRow, "playback"> | null, stream: Pick<Stream, "settings"> | null): boolean {
  const purpose = stream?.settings?.purpose;
  return (row === null || row.playback === null) && !(typeof purpose === "string" && FOR_PROGRAMS.includes(purpose));
}
