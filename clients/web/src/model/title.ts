/** The document's title: `lidarcodec — 118234 points` once points have come. */
export function titleOf(points: number): string {
  return points > 0 ? `lidarcodec — ${points} points` : "lidarcodec";
}
