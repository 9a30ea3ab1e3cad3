/** What the page says to the decoder's thread: first where weights are and how they are asked for, then messages. */
export type Asked =
  | { readonly weights: string; readonly headers: Record<string, string> }
  | { readonly id: number; readonly message: ArrayBuffer };
