/** A small generator of numbers (xorshift), the same each time. */
export function numbers(seed: number): (below: number) => number {
  let state = seed;
  return (below) => {
    state ^= state << 13;
    state ^= state >>> 17;
    state ^= state << 5;
    return (state >>> 0) % below;
  };
}

/** How many damaged messages a test tries: an eighth, unless LIDARCODEC_EXAMPLES is `all`, as in `make sweeps`. */
export const examples = (count: number): number => (process.env.LIDARCODEC_EXAMPLES === "all" ? count : Math.ceil(count / 8));
