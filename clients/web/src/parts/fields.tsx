import { useSignal } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { label, plain } from "../model/format";
import { type Field, fieldOf, limitsOf, numberIn } from "../model/schema";
import type { Schema, Value } from "../model/wire";
import { Button } from "./button";

interface Props {
  id: string;
  name: string;
  schema: Schema;
  value: Value;
  edited: boolean;
  disabled: boolean;
  /** Why it cannot be set, if it cannot. */
  hindered?: string | undefined;
  problem: string | null;
  set: (value: Value) => void;
  /** Whether it is pinned, or left to the target bitrate; null if a target never changes it. */
  pinned?: boolean | null;
  /** Leaves it to the target bitrate. */
  unset?: (() => void) | undefined;
}

/** A setting with its label, its control, its description, and its error. */
export function SettingField(props: Props) {
  const { id, name, schema, edited, problem, hindered, pinned = null, unset } = props;
  const field = fieldOf(schema);
  const limits = limitsOf(field);
  return (
    <div class={`field ${edited ? "edited" : ""}`}>
      <label for={id}>
        {label(name)}
        {edited && <span class="hidden"> (not sent yet)</span>}
      </label>
      <Control {...props} field={field} disabled={props.disabled || hindered !== undefined} />
      {pinned !== null && hindered === undefined && (
        <p class="pin">
          <span class={`chip ${pinned ? "pinned" : ""}`}>{pinned ? "pinned" : "not set"}</span>
          {pinned && unset && (
            <Button look="link" off={props.disabled} press={unset} label={`Do not set ${label(name)}`}>
              do not set
            </Button>
          )}
        </p>
      )}
      <p id={`${id}-help`} class="help">
        {hindered ?? <Words text={schema.description ?? ""} />}
        {hindered === undefined && limits && <span class="limits"> {limits}</span>}
      </p>
      {problem && (
        <p id={`${id}-problem`} class="problem" role="alert">
          {problem}
        </p>
      )}
    </div>
  );
}

/** Text with code between backticks. */
export function Words({ text }: { text: string }): ComponentChildren {
  return text.split("`").map((part, index) => (index % 2 ? <code key={`${index}`}>{part}</code> : part));
}

type ControlProps = Props & { field: Field };

function Control(props: ControlProps) {
  const { field } = props;
  if (field.kind === "switch") return <Switch {...props} />;
  if (field.kind === "choice") return <Choice {...props} field={field} />;
  if (field.kind === "number") return <NumberInput {...props} field={field} />;
  return <TextInput {...props} field={field} />;
}

function marks({ id, problem }: Props) {
  return {
    id,
    "aria-describedby": problem ? `${id}-problem ${id}-help` : `${id}-help`,
    "aria-invalid": problem !== null,
  };
}

function Switch(props: ControlProps) {
  return (
    <input
      type="checkbox"
      {...marks(props)}
      disabled={props.disabled}
      checked={props.value === true}
      onChange={(event) => props.set(event.currentTarget.checked)}
    />
  );
}

const OTHER = "\u0000other";

function Choice(props: ControlProps & { field: Field & { kind: "choice" } }) {
  const { field, value } = props;
  const known = field.values.some((one) => one === value);
  const writing = useSignal(false);
  const other = field.open && (writing.value || !known);
  return (
    <span class="choice">
      <select
        {...marks(props)}
        disabled={props.disabled}
        value={other ? OTHER : String(value)}
        onChange={(event) => {
          const chosen = event.currentTarget.value;
          writing.value = chosen === OTHER;
          const found = field.values.find((one) => String(one) === chosen);
          if (found !== undefined) props.set(found);
        }}
      >
        {field.values.map((one) => (
          <option key={String(one)} value={String(one)}>
            {props.schema.free !== undefined && one === props.schema.free ? `not set (${plain(one)})` : plain(one)}
          </option>
        ))}
        {!known && !field.open && <option value={String(value)}>{plain(value)}</option>}
        {field.open && <option value={OTHER}>other …</option>}
      </select>
      {other && (
        <input
          type="text"
          aria-label={`${label(props.name)}, other`}
          spellcheck={false}
          disabled={props.disabled}
          value={String(value ?? "")}
          onInput={(event) => props.set(event.currentTarget.value.trim())}
        />
      )}
    </span>
  );
}

function NumberInput(props: ControlProps & { field: Field & { kind: "number" } }) {
  const { field, value, id } = props;
  const text = useSignal<string | null>(null); // the text while the user edits it
  const word = typeof value === "string" && field.words.includes(value);
  const shown = text.value ?? (value === null ? "" : String(value));
  const wrong = text.value !== null && numberIn(text.value, field) === undefined;
  return (
    <span class="number">
      <input
        type="text"
        inputmode={field.whole ? "numeric" : "decimal"}
        autocomplete="off"
        {...marks(props)}
        aria-invalid={props.problem !== null || wrong}
        disabled={props.disabled || word}
        placeholder={field.nullable ? "not set" : ""}
        value={word ? "" : shown}
        onInput={(event) => {
          text.value = event.currentTarget.value;
          const meant = numberIn(event.currentTarget.value, field);
          if (meant !== undefined) props.set(meant);
        }}
        onBlur={() => {
          text.value = null;
        }}
      />
      {field.words.map((one) => (
        <label class="check" key={one} for={`${id}-${one}`}>
          <input
            id={`${id}-${one}`}
            type="checkbox"
            disabled={props.disabled}
            checked={value === one}
            onChange={(event) => {
              text.value = null;
              props.set(event.currentTarget.checked ? one : null);
            }}
          />
          {one}
        </label>
      ))}
    </span>
  );
}

function TextInput(props: ControlProps & { field: Field }) {
  const nullable = props.field.kind === "text" && props.field.nullable;
  return (
    <input
      type="text"
      spellcheck={false}
      autocomplete="off"
      {...marks(props)}
      disabled={props.disabled}
      placeholder={nullable ? "default" : ""}
      value={props.value === null ? "" : String(props.value)}
      onInput={(event) => {
        const given = event.currentTarget.value.trim();
        props.set(given === "" && nullable ? null : given);
      }}
    />
  );
}
