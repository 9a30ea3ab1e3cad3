/** What the server answers, as far as the page uses it (docs/openapi.json). */
import type { Mount } from "../view";

export type Role = "viewer" | "operator";

export interface Session {
  name: string | null;
  role: Role | null;
  token_needed: boolean;
  version: string;
  archive: boolean;
}

export interface FleetRow {
  vehicle: string;
  sensor: string;
  alive: boolean;
  ended: boolean;
  silent_s: number | null;
  codec: string | null;
  reduction: string | null;
  kbps: number | null;
  fps: number | null;
  target: number | "auto" | null;
  target_kbps: number | null;
  reached: boolean | null;
  latency_ms: number | null;
  replaced: number | null;
  left_out: number;
  recording: string | null;
  playback: string | null;
  minute: (number | null)[] | null;
}

export type Value = string | number | boolean | null | { [name: string]: Value } | Value[];
export type Settings = Record<string, Value>;

/** What a path carries, in kbit/s; null while it is not known. */
export interface PathStatus {
  /** As single messages show it. */
  capacity_kbps?: number | null;
  /** For long, where the path lets bursts through. */
  sustained_kbps?: number | null;
}

export interface RateStatus {
  auto?: boolean;
  target_kbps?: number | null;
  reachable_kbps?: [number, number] | null;
  limited_by?: string | null;
  reached?: boolean | null;
  max_error_m?: number;
  quality?: number;
  intensity?: string;
  step?: number;
}

/** Why a target bitrate is not kept, and what to do: in sentences, and for programs. */
export interface TargetWarning {
  code: string;
  message: string;
  remedy: string;
  /** Settings that are in the way; a codec's own as `codec_settings.NAME`. */
  settings: string[];
}

export interface Stream {
  vehicle: string;
  sensor: string;
  alive: boolean;
  settings: Settings | null;
  /** Where the sensor sits on its vehicle; null if the stream does not say. */
  mount: Mount | null;
  warnings: TargetWarning[];
  status: {
    /** In force; another one than in the settings where those say `auto`, and why it is that one. */
    codec?: string;
    codec_choice?: { because?: string } | null;
    rate?: RateStatus | null;
    path?: PathStatus;
    left_out?: number;
    reduction?: { returns?: number | null; kept?: number | null; note?: string | null } | null;
    sensor_model?: { model?: string; note?: string | null };
    preparing?: string | null;
    /** What the vehicle keeps; null if it keeps nothing. */
    past?: object | null;
    errors?: Record<string, number>;
  } | null;
}

export interface SettingsState {
  applied: Settings | null;
  desired: Settings | null;
  operator: Settings;
  refused: string | null;
}

export interface Change {
  applied: Settings | null;
  desired: Settings | null;
  first_frame: number | null;
  warnings?: TargetWarning[];
}

export interface Schema {
  type?: string;
  title?: string;
  description?: string;
  default?: Value;
  enum?: Value[];
  const?: Value;
  examples?: Value[];
  minimum?: number;
  maximum?: number;
  exclusiveMinimum?: number;
  anyOf?: Schema[];
  properties?: Record<string, Schema>;
  /** Names of reductions that take a budget; stands beside `examples`. */
  budgeted?: string[];
  /** The value with which a setting is not set, and left to the target bitrate; only where it can be. */
  free?: Value;
  /** Whether few people change the setting. */
  more?: boolean;
}

/** A preset for streams over such a link: nothing but these settings. */
export interface Link {
  name: string;
  label: string;
  settings: Settings;
}

export interface Codec {
  name: string;
  bound: boolean;
  target: boolean;
  /** Whether it takes point clouds that a driver made. */
  clouds: boolean;
  settings_schema: Schema;
  reach: { setting: string; range_kbps: [number, number] } | null;
}

export interface AuditEntry {
  id: number;
  at: string;
  who: string;
  action: string;
  changes: Settings;
  old: Settings | null;
  new: Settings | null;
  result: string;
  reason: string | null;
  first_frame: number | null;
}

export interface Playing {
  vehicle: string;
  sensor: string;
  rate: number;
  loop: boolean;
  frames: number;
  paused: boolean;
  position_s: number;
  duration_s: number;
}

export interface Recording {
  id: string;
  vehicle: string;
  sensor: string;
  started: string;
  ended: string | null;
  state: "recording" | "complete" | "failed" | "interrupted";
  reason: string | null;
  by: string | null;
  size_bytes: number;
  frames: number | null;
  playing: Playing | null;
}

export interface Segment {
  segment: string;
  vehicle: string;
  sensor: string;
  begin: string;
  end: string;
  frames: number;
  bytes: number;
  codec: string;
  bound_m: number | null;
}

/** lost: segments of the whole archive that no search finds */
export interface Segments {
  segments: Segment[];
  next: string | null;
  lost: number;
}
