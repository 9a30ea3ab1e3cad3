/** The result of a change, in words. */
import { listOf } from "./format";
import { sentence } from "./missed";
import type { Change, Settings } from "./wire";

export type Outcome =
  | { kind: "none" }
  | { kind: "sending" }
  | { kind: "applied"; first: number | null; change: Settings }
  | { kind: "kept"; change: Settings; warning: string | null }
  | { kind: "refused"; text: string; field: string | null; status: number }
  | { kind: "note"; text: string };

export function outcomeOf(status: number, answer: Change, change: Settings): Outcome {
  if (status === 202 || answer.applied === null) {
    const warning = answer.warnings?.[0];
    return {
      kind: "kept",
      change,
      warning: warning ? `${sentence(warning.message)} ${sentence(warning.remedy)}` : null,
    };
  }
  return { kind: "applied", first: answer.first_frame, change };
}

/** Its sentence; `frame`: index of the newest shown frame. */
export function sentenceOf(outcome: Outcome, frame: number | null): string {
  if (outcome.kind === "sending") return "Sending to the vehicle …";
  if (outcome.kind === "note") return outcome.text;
  if (outcome.kind === "refused") return `Refused: ${outcome.text}`;
  if (outcome.kind === "kept")
    return `Stored: ${listOf(outcome.change)}. The vehicle is not connected and gets the change when it returns.${outcome.warning ? ` ${outcome.warning}` : ""}`;
  if (outcome.kind === "none") return "";
  if (outcome.first === null) return `Applied: ${listOf(outcome.change)}.`;
  const shown = frame !== null && frame >= outcome.first ? " (now shown)" : "";
  return `Applied from frame ${outcome.first} on${shown}: ${listOf(outcome.change)}.`;
}
