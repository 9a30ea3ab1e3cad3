import { useSignal } from "@preact/signals";
import { keyOf } from "../model/minute";
import { addressOf, besideKeys, box, forget, keep, setBeside, show, viewNow, views } from "../scene/state";
import { LONGEST_NAME, type SavedView } from "../scene/views";
import { chosen, rows } from "../state";
import { type Box, MOST_STREAMS, type Stand, THINNEST_M, WIDEST } from "../view";
import { Button } from "./button";
import "./scene.css";

const AXES = ["forward", "left", "up"] as const;
/** What a box begins as: a lane ahead. */
const FIRST: Box = { least: [-20, -10, -1], greatest: [40, 10, 5] };

/** What is in the picture: other streams, the box, and saved views. stand: where the camera is */
export function SceneTools({ stand }: { stand: () => Stand | null }) {
  const others = besideKeys.value.filter((key) => key !== chosen.value).length;
  return (
    <div class="scene">
      <details name="scene">
        <summary>Streams{others > 0 && ` (${others + 1})`}</summary>
        <Streams />
      </details>
      <details name="scene">
        <summary>Box{box.value && " (on)"}</summary>
        <BoxSliders />
      </details>
      <details name="scene">
        <summary>Views{views.value.length > 0 && ` (${views.value.length})`}</summary>
        <Views stand={stand} />
      </details>
    </div>
  );
}

function Streams() {
  const all = (rows.value ?? []).map(keyOf).filter((key) => key !== chosen.value);
  const full = besideKeys.value.length >= MOST_STREAMS - 1;
  if (all.length === 0) return <p class="quiet">There is no other stream.</p>;
  return (
    <fieldset class="choices">
      <legend class="hidden">Other streams in the picture</legend>
      {all.map((key) => {
        const on = besideKeys.value.includes(key);
        return (
          <label class="check" key={key}>
            <input
              type="checkbox"
              checked={on}
              disabled={full && !on}
              onChange={(event) => setBeside(key, event.currentTarget.checked)}
            />
            {key}
          </label>
        );
      })}
      {full && <p class="quiet">At most {MOST_STREAMS} streams are shown together.</p>}
    </fieldset>
  );
}

function BoxSliders() {
  const now = box.value;
  const set = (end: keyof Box, axis: number, value: number) => {
    const next: Box = { least: [...(now ?? FIRST).least], greatest: [...(now ?? FIRST).greatest] };
    next[end][axis] = value;
    if (end === "least") next.greatest[axis] = Math.max(next.greatest[axis] as number, value + THINNEST_M);
    else next.least[axis] = Math.min(next.least[axis] as number, value - THINNEST_M);
    box.value = next;
  };
  return (
    <fieldset class="choices box">
      <legend class="hidden">Box</legend>
      <label class="check">
        <input
          type="checkbox"
          checked={now !== null}
          onChange={(event) => {
            box.value = event.currentTarget.checked ? FIRST : null;
          }}
        />
        Draw only what is in the box
      </label>
      {now &&
        AXES.flatMap((name, axis) =>
          (["least", "greatest"] as const).map((end) => {
            const least = WIDEST.least[axis] as number;
            const most = WIDEST.greatest[axis] as number;
            const value = now[end][axis] as number;
            return (
              <label class="slider" key={`${name} ${end}`}>
                <span>
                  {name}, {end === "least" ? "from" : "to"}
                </span>
                <input
                  type="range"
                  min={end === "least" ? least : least + THINNEST_M}
                  max={end === "least" ? most - THINNEST_M : most}
                  step={THINNEST_M}
                  value={value}
                  onInput={(event) => set(end, axis, event.currentTarget.valueAsNumber)}
                />
                <output>{value} m</output>
              </label>
            );
          }),
        )}
      {now && <p class="quiet">Seen from the sensor; up counts from the road.</p>}
    </fieldset>
  );
}

function Views({ stand }: { stand: () => Stand | null }) {
  const name = useSignal("");
  const link = useSignal<{ of: string; text: string } | null>(null);

  function save() {
    const at = stand();
    const view = at && viewNow(name.value.trim(), at);
    if (!view?.name) return;
    keep(view);
    name.value = "";
  }

  async function share(view: SavedView) {
    const address = addressOf(view);
    link.value = { of: view.name, text: address ?? "This view is too long for a link." };
    // without a secure connection there is no clipboard: the address stands there to be copied
    if (address) await navigator.clipboard?.writeText(address).catch(() => {});
  }

  return (
    <div class="choices">
      <form
        class="line"
        onSubmit={(event) => {
          event.preventDefault();
          save();
        }}
      >
        <input
          aria-label="Name of the view"
          placeholder="Name of this view"
          maxLength={LONGEST_NAME}
          value={name.value}
          onInput={(event) => {
            name.value = event.currentTarget.value;
          }}
        />
        <Button look="small" off={name.value.trim() === ""}>
          Save view
        </Button>
      </form>
      <ul>
        {views.value.map((view) => (
          <li key={view.name} class="line">
            <Button look="small" press={() => show(view)} title={[view.stream, ...view.beside].join(", ")}>
              {view.name}
            </Button>
            <span class="grow" />
            <Button look="small" label={`Share ${view.name}`} press={() => void share(view)}>
              Share
            </Button>
            <Button look="small" label={`Delete ${view.name}`} press={() => forget(view.name)}>
              Delete
            </Button>
          </li>
        ))}
      </ul>
      {link.value && (
        <label class="share">
          Link to {link.value.of}
          <input readOnly value={link.value.text} onFocus={(event) => event.currentTarget.select()} />
        </label>
      )}
    </div>
  );
}
