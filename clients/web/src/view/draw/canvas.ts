/** The canvas of the view. */

/** A canvas that fills its host, can be focused, and is named for those who cannot see it. */
export function canvasIn(host: HTMLElement): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  canvas.className = "lidar-canvas";
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute(
    "aria-label",
    "Point cloud. Arrow keys turn, with shift they move; plus and minus zoom; 0 resets. Measure: click two points.",
  );
  host.append(canvas);
  return canvas;
}

export function contextOf(canvas: HTMLCanvasElement): WebGL2RenderingContext | null {
  return canvas.getContext("webgl2", {
    antialias: false,
    alpha: false,
    depth: true,
    powerPreference: "high-performance",
  });
}

/** Give it the size at which its host is shown, with so many device pixels each. False while that is hidden. */
export function sized(canvas: HTMLCanvasElement, host: HTMLElement, ratio: number): boolean {
  const wide = Math.round(host.clientWidth * ratio);
  const high = Math.round(host.clientHeight * ratio);
  if (wide < 2 || high < 2) return false;
  if (canvas.width !== wide || canvas.height !== high) {
    canvas.width = wide;
    canvas.height = high;
  }
  return true;
}
