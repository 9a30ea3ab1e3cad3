/** What the view says over the picture when it cannot show one. */

export const NO_WEBGL =
  "This browser or machine does not offer WebGL 2, which the live view needs. Settings and recordings work.";
export const TOO_WIDE = "This graphics card cannot show frames with so many columns.";
export const LOST = "The graphics card is not available now. The picture returns when it is.";
export const NO_ORIGINALS =
  "Uncompressed frames of this stream are not available. To compare, run the vehicle on the same machine as the server: lidarcodec demo, or lidarcodec publish --original.";
