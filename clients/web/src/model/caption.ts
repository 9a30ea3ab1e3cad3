/** What stands below a picture that is saved: without it nobody could tell later what it shows, and how true it is. */
import type { ViewStats } from "../view";
import { count } from "./format";

type Told = Pick<ViewStats, "points" | "madeUp" | "frameIndex">;

/** notice: why the picture is not live; empty if it is. stampMs: of the frame, milliseconds since 1970 */
export function captionOf(stream: string, told: Told, codec: string | null, stampMs: number, notice: string): string {
  const parts = [stream, new Date(stampMs).toISOString().replace("T", " "), `frame ${told.frameIndex ?? "–"}`];
  if (codec) parts.push(codec);
  parts.push(`${count(told.points)} points measured`);
  if (told.madeUp > 0) parts.push(`${count(told.madeUp)} filled in`);
  if (notice) parts.push(notice);
  return parts.join(" · ");
}

/** The name of the file of a saved picture. */
export function pictureName(stream: string, frameIndex: number | null): string {
  return `${stream.replace("/", "_")}_${frameIndex ?? 0}.png`;
}
