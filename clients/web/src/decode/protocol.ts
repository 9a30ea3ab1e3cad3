/** What the page says to the decoder's thread: first where weights are and how they are asked for, and whether gaps are
 * filled; then messages. */
export type Asked =
  | { readonly weights: string; readonly headers: Record<string, string>; readonly fill: boolean }
  | { readonly id: number; readonly message: ArrayBuffer };
