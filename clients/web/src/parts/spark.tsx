import { path, targetLine } from "../model/minute";

const WIDTH = 72;
const HEIGHT = 18;

/** The last minute of a bitrate, with a dashed line at its target. */
export function Spark({ values, target }: { values: readonly (number | null)[]; target: number | null }) {
  return (
    <svg
      class="spark"
      width={WIDTH}
      height={HEIGHT}
      viewBox={`0 0 ${WIDTH} ${HEIGHT}`}
      preserveAspectRatio="none"
      aria-hidden="true"
    >
      {target !== null && (
        <line
          class="target"
          x1="0"
          x2={WIDTH}
          y1={targetLine(values, HEIGHT, target)}
          y2={targetLine(values, HEIGHT, target)}
        />
      )}
      <path d={path(values, WIDTH, HEIGHT, target)} />
    </svg>
  );
}
