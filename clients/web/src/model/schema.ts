/** Forms from JSON schemas: the control for a setting, and the value of its text. */
import type { Codec, Schema, Stream, Value } from "./wire";

export type Field =
  | { kind: "switch" }
  | { kind: "choice"; values: Value[]; open: boolean }
  | {
      kind: "number";
      whole: boolean;
      minimum: number | null;
      maximum: number | null;
      words: string[];
      nullable: boolean;
    }
  | { kind: "text"; nullable: boolean };

/** The control for a setting. `words`: texts that are allowed instead of a number, such as `auto`. */
export function fieldOf(schema: Schema): Field {
  const options = schema.anyOf ?? [schema];
  const nullable = options.some((one) => one.type === "null");
  const number = options.find((one) => one.type === "number" || one.type === "integer");
  const values = schema.enum ?? options.find((one) => one.enum)?.enum;
  if (values) return { kind: "choice", values, open: false };
  if (number) {
    return {
      kind: "number",
      whole: number.type === "integer",
      minimum: number.minimum ?? number.exclusiveMinimum ?? null,
      maximum: number.maximum ?? null,
      words: options.flatMap((one) => (typeof one.const === "string" ? [one.const] : [])),
      nullable,
    };
  }
  if (options.some((one) => one.type === "boolean")) return { kind: "switch" };
  if (schema.examples) return { kind: "choice", values: schema.examples, open: true };
  return { kind: "text", nullable };
}

/**
 * Names of the settings in the main part of a form, and of those that few people change. The codec and its own settings
 * have separate parts.
 */
export function fieldsOf(schema: Schema | null): { first: string[]; more: string[] } {
  const all = Object.entries(schema?.properties ?? {}).filter(
    ([name]) => name !== "codec" && name !== "codec_settings",
  );
  return {
    first: all.filter(([, about]) => !about.more).map(([name]) => name),
    more: all.filter(([, about]) => about.more).map(([name]) => name),
  };
}

/** The value of the text in a number's control; undefined if it is not a number. */
export function numberIn(text: string, field: Field & { kind: "number" }): Value | undefined {
  const trimmed = text.trim().replace(",", ".");
  if (trimmed === "") return field.nullable ? null : undefined;
  if (field.words.includes(trimmed)) return trimmed;
  const value = Number(trimmed);
  return Number.isFinite(value) ? value : undefined;
}

/** The allowed numbers, for people: `1 to 12`, `0 or more`. */
export function limitsOf(field: Field): string {
  if (field.kind !== "number") return "";
  const { minimum, maximum } = field;
  if (minimum !== null && maximum !== null) return `${minimum} to ${maximum.toLocaleString("en")}`;
  if (minimum !== null) return `${minimum} or more`;
  return maximum !== null ? `up to ${maximum.toLocaleString("en")}` : "";
}

export function same(a: Value | undefined, b: Value | undefined): boolean {
  if (a === b) return true;
  if (typeof a !== "object" || typeof b !== "object" || a === null || b === null) return false;
  const names = new Set([...Object.keys(a), ...Object.keys(b)]);
  const [left, right] = [a as Record<string, Value>, b as Record<string, Value>];
  return [...names].every((name) => name in left && name in right && same(left[name], right[name]));
}

const AUTO = "auto";
/** Settings that a vehicle refuses for streams of point clouds, and why. */
const HINDRANCES: Record<string, string> = {
  target_kbps: "A point cloud cannot keep a target bitrate. A larger max error sends less.",
  reduction: "All points of a point cloud are sent.",
  intensity: "The fields of a point cloud travel as they are.",
  base_error_m: "A point cloud has no layers.",
};

/** Whether a stream is of point clouds that a driver made. */
export function isCloud(stream: Stream | null): boolean {
  return stream?.status?.sensor_model?.model === "pointcloud2";
}

/** Why the vehicle would refuse another value; undefined if it takes some. A value that it refuses can be changed. */
export function hindranceOfCloud(field: string, value: Value, schema: Schema | undefined): string | undefined {
  return value === null || same(value, schema?.free) ? HINDRANCES[field] : undefined;
}

/** The schema of the setting `codec` with the codecs that take point clouds. */
export function codecsOfClouds(schema: Schema, codecs: Codec[]): Schema {
  const takes = (name: Value) => name === AUTO || codecs.some((one) => one.name === name && one.clouds);
  const { enum: names, examples } = schema;
  return {
    ...schema,
    ...(names && { enum: names.filter(takes) }),
    ...(examples && { examples: examples.filter(takes) }),
  };
}
