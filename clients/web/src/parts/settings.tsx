import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { Problem } from "../model/api";
import {
  baseOf,
  budgeted,
  changeOf,
  edited,
  editedOwn,
  ownSet,
  ownSettings,
  pinnedIn,
  preset,
  settled,
  shown,
} from "../model/draft";
import { type Outcome, outcomeOf, sentenceOf } from "../model/outcome";
import { type Poller, poll } from "../model/poll";
import { codecsOfClouds, fieldsOf, hindranceOfCloud, isCloud } from "../model/schema";
import type { Change, Codec, Settings, SettingsState, Value } from "../model/wire";
import {
  call,
  codecs,
  mayChange,
  nameOf,
  pathOf,
  refreshFleet,
  refreshStream,
  schema,
  session,
  stats,
  stream,
} from "../state";
import { Button } from "./button";
import { SettingField } from "./fields";
import { InForce } from "./inforce";
import { Links } from "./links";

const STATE_MS = 5000;

/** The settings of a stream: the ones in force, and a form, made from the schemas, to change them. */
export function SettingsForm({ name }: { name: string }) {
  const path = pathOf(nameOf(name));
  const state = useSignal<SettingsState | null>(null);
  const edits = useSignal<Settings>({});
  const outcome = useSignal<Outcome>({ kind: "none" });
  const asking = useRef<Poller | null>(null);

  useEffect(() => {
    const settings = poll(STATE_MS, async () => {
      state.value = (await call<SettingsState>("GET", `${path}/settings`)).body;
      edits.value = settled(baseOf(state.value, null), edits.value);
    });
    asking.current = settings;
    return () => settings.stop();
  }, [path]);

  const alive = stream.value?.alive;
  useEffect(() => {
    if (alive !== undefined) asking.current?.now();
  }, [alive]);

  const base = baseOf(state.value, stream.value?.settings ?? null);
  const common = schema.value?.properties;
  if (!common || Object.keys(base).length === 0) {
    return (
      <p class="quiet pad" role="status">
        {stream.value && !stream.value.alive ? "The vehicle has not reported its settings yet." : "Loading settings …"}
      </p>
    );
  }

  const codec = codecs.value.find((one) => one.name === shown(base, edits.value, "codec"));
  const own = ownSettings(base, edits.value, codec?.settings_schema);
  const sending = outcome.value.kind === "sending";
  const changed = Object.keys(edits.value).length > 0;

  function set(field: string, value: Value) {
    edits.value = edited(base, edits.value, field, value, codecs.value, schema.value);
    if (outcome.value.kind !== "sending") outcome.value = { kind: "none" };
  }

  function take(wanted: Settings) {
    edits.value = preset(base, edits.value, wanted, codecs.value, schema.value);
    if (outcome.value.kind !== "sending") outcome.value = { kind: "none" };
  }

  function setOwn(field: string, value: Value | undefined) {
    edits.value = editedOwn(base, edits.value, field, value);
    if (outcome.value.kind !== "sending") outcome.value = { kind: "none" };
  }

  function undo() {
    edits.value = {};
    outcome.value = { kind: "none" };
  }

  async function submit(event: Event) {
    event.preventDefault();
    if (!changed || sending) return;
    const change = changeOf(base, edits.value);
    outcome.value = { kind: "sending" };
    try {
      const { status, body } = await call<Change>("PATCH", `${path}/settings`, change);
      outcome.value = outcomeOf(status, body, change);
      edits.value = {};
      state.value = {
        applied: body.applied,
        desired: body.desired,
        operator: state.value?.operator ?? {},
        refused: null,
      };
      refreshFleet();
      refreshStream();
    } catch (error) {
      outcome.value = refusal(error);
      if (outcome.value.kind === "refused" && outcome.value.field) {
        document.getElementById(idOf(outcome.value.field))?.focus();
      }
    }
    asking.current?.now();
  }

  async function once(
    method: string,
    tail: string,
    done: (body: { first_frame?: number | null; merged?: boolean }) => string,
  ) {
    outcome.value = { kind: "sending" };
    try {
      const { body } = await call<{ first_frame?: number | null; merged?: boolean }>(method, `${path}/${tail}`);
      outcome.value = { kind: "note", text: done(body) };
    } catch (error) {
      outcome.value = refusal(error);
    }
    asking.current?.now();
  }

  const problemAt = (field: string) =>
    outcome.value.kind === "refused" && outcome.value.field === field ? outcome.value.text : null;
  const cloud = isCloud(stream.value);
  const fieldFor = (field: string) => {
    const found = common[field];
    const about = found && cloud && field === "codec" ? codecsOfClouds(found, codecs.value) : found;
    const budget = field === "keep_points" || field === "keep_fraction";
    const value = shown(base, edits.value, field);
    const free = about?.free;
    if (!about || (budget && !budgeted(schema.value, shown(base, edits.value, "reduction")))) return null;
    return (
      <SettingField
        key={field}
        id={idOf(field)}
        name={field}
        schema={about}
        value={value}
        pinned={pinnedIn(schema.value, field, value)}
        unset={free === undefined ? undefined : () => set(field, free)}
        edited={field in edits.value}
        disabled={!mayChange.value}
        hindered={(cloud ? hindranceOfCloud(field, value, about) : undefined) ?? hindranceOf(field, codec)}
        problem={problemAt(field)}
        set={(value) => set(field, value)}
      />
    );
  };
  const fields = fieldsOf(schema.value);
  const ownFields = Object.entries(codec?.settings_schema.properties ?? {});

  return (
    <form class="settings" onSubmit={submit} aria-label={`Settings of ${name}`} noValidate>
      <InForce state={state.value} stream={stream.value} />
      {!mayChange.value && (
        <p class="quiet pad">
          {session.value?.name} is a viewer. To change settings, sign in with an operator's token.
        </p>
      )}
      {!cloud && <Links wanted={(name) => shown(base, edits.value, name)} take={take} disabled={!mayChange.value} />}
      {fieldFor("codec")}
      {codec?.reach && (
        <p class="help reach">
          Ranges of an HDL-64E take {Math.round(codec.reach.range_kbps[0]).toLocaleString("en")} to{" "}
          {Math.round(codec.reach.range_kbps[1]).toLocaleString("en")} kbit/s, depending on{" "}
          <code>{codec.reach.setting}</code>. Mask and intensity are added to that.
        </p>
      )}
      {ownFields.length > 0 && (
        <fieldset>
          <legend>Settings of {codec?.name}</legend>
          {ownFields.map(([field, about]) => (
            <SettingField
              key={`${codec?.name}.${field}`}
              id={idOf(`codec_settings.${field}`)}
              name={field}
              schema={about}
              value={own[field] ?? null}
              pinned={codec?.reach?.setting === field ? ownSet(base, edits.value, field) : null}
              unset={() => setOwn(field, undefined)}
              edited={field in ((edits.value.codec_settings ?? {}) as Settings)}
              disabled={!mayChange.value}
              problem={problemAt(`codec_settings.${field}`)}
              set={(value) => setOwn(field, value)}
            />
          ))}
        </fieldset>
      )}
      {fields.first.map(fieldFor)}
      <details>
        <summary>More settings</summary>
        {fields.more.map(fieldFor)}
      </details>
      <div class="actions">
        <Button look="primary" off={!changed || sending || !mayChange.value}>
          {sending ? "Sending …" : "Apply"}
        </Button>
        <Button off={!changed || sending} press={undo}>
          Undo
        </Button>
        <span class="grow" />
        <Button
          off={sending || !mayChange.value || !stream.value?.alive}
          title="Send the next frame as a key frame"
          press={() =>
            once("POST", "keyframe", ({ first_frame }) => `A key frame will be sent: frame ${first_frame} or later.`)
          }
        >
          Key frame
        </Button>
      </div>
      <p class={`outcome ${outcome.value.kind}`} role="status">
        {sentenceOf(outcome.value, stats.value?.frameIndex ?? null)}
      </p>
      {Object.keys(state.value?.operator ?? {}).length > 0 && (
        <p class="help pad">
          Set by operators, and sent to the vehicle each time it starts:{" "}
          {Object.keys(state.value?.operator ?? {}).join(", ")}.{" "}
          <Button
            look="link"
            off={sending || !mayChange.value}
            press={() =>
              once("DELETE", "settings", (answer) =>
                answer.first_frame == null
                  ? "Removed. The vehicle returns to its own settings when it is back."
                  : `Removed. The vehicle's own settings are in force from frame ${answer.first_frame} on.`,
              )
            }
          >
            Return to the vehicle's own
          </Button>
        </p>
      )}
    </form>
  );
}

function idOf(field: string): string {
  return `setting-${field.replace(".", "-")}`;
}

function refusal(error: unknown): Outcome {
  const problem = error instanceof Problem ? error : new Problem(0, String(error), "");
  return { kind: "refused", text: problem.detail, field: problem.field, status: problem.status };
}

/** Why a setting has no effect with the chosen codec; undefined if it has an effect. */
function hindranceOf(field: string, codec: Codec | undefined): string | undefined {
  if (field === "max_error_m" && codec && !codec.bound) return `${codec.name} cannot keep an error bound.`;
  if (field === "target_kbps" && codec && !codec.target) return `${codec.name} cannot keep a target bitrate.`;
  return undefined;
}
