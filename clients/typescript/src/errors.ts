/** An error in a message. `code` is a word for programs, `message` a sentence for people. */
export type ErrorCode =
  | "header" // no message, or a field of its header beyond the limits
  | "version" // another major version, codec, form or critical flag than this decoder knows
  | "truncated" // it ends before it should
  | "checksum"
  | "section" // a section that contradicts itself or the rest
  | "reference"; // it builds on a message that was not decoded: ask for a key message

/** The only error that decoding throws, for any bytes. */
export class DecodeError extends Error {
  readonly code: ErrorCode;

  constructor(code: ErrorCode, message: string) {
    super(message);
    this.name = "DecodeError";
    this.code = code;
  }
}

export function damaged(message: string): DecodeError {
  return new DecodeError("section", message);
}
