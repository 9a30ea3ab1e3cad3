import { CAMERAS, COLOURS } from "../scene/views";
import type { Camera, Colour, ViewOptions } from "../view";
import { Button } from "./button";

/** The options of the view. */
export function ViewTools({
  options,
  set,
  maps,
  fillGaps,
  setFillGaps,
  savePicture,
  filming,
  film,
}: {
  options: ViewOptions;
  maps: string[];
  set: (changed: Partial<ViewOptions>) => void;
  fillGaps: boolean;
  setFillGaps: (on: boolean) => void;
  savePicture: () => void;
  /** Seconds of the clip that is recorded now; null without one. */
  filming: number | null;
  /** Begin or end a clip; null where the browser makes none. */
  film: (() => void) | null;
}) {
  return (
    <fieldset class="tools" aria-label="View options">
      <label>
        Colour
        <select value={options.colour} onChange={(event) => set({ colour: event.currentTarget.value as Colour })}>
          {COLOURS.map((one) => (
            <option key={one}>{one}</option>
          ))}
        </select>
      </label>
      <label>
        Camera
        <select value={options.camera} onChange={(event) => set({ camera: event.currentTarget.value as Camera })}>
          {CAMERAS.map((one) => (
            <option key={one}>{one}</option>
          ))}
        </select>
      </label>
      <label>
        Size
        <input
          type="range"
          min="0.5"
          max="5"
          step="0.5"
          value={options.pointSize}
          onInput={(event) => set({ pointSize: event.currentTarget.valueAsNumber })}
        />
      </label>
      <label>
        Trail
        <input
          type="range"
          min="0"
          max="10"
          step="1"
          value={options.trail}
          onInput={(event) => set({ trail: event.currentTarget.valueAsNumber })}
        />
      </label>
      {maps.length > 0 && (
        <label>
          Map
          <select value={options.map ?? ""} onChange={(event) => set({ map: event.currentTarget.value || null })}>
            <option value="">none</option>
            {maps.map((one) => (
              <option key={one}>{one}</option>
            ))}
          </select>
        </label>
      )}
      <Check text="Range image" on={options.rangeImage} set={(on) => set({ rangeImage: on })} />
      <Check text="Fill gaps" on={fillGaps} set={setFillGaps} />
      <Check text="Compare" on={options.compare} set={(on) => set({ compare: on })} />
      <Check text="Measure" on={options.measure} set={(on) => set({ measure: on })} />
      <Check text="Decode here" on={options.decodeInBrowser} set={(on) => set({ decodeInBrowser: on })} />
      <Button look="small" press={savePicture}>
        Save picture
      </Button>
      {film && (
        <Button look={`small ${filming === null ? "" : "on"}`} pressed={filming !== null} press={film}>
          {filming === null ? "Record clip" : `Save clip (${filming} s)`}
        </Button>
      )}
    </fieldset>
  );
}

function Check({ text, on, set }: { text: string; on: boolean; set: (on: boolean) => void }) {
  return (
    <label class="check">
      <input type="checkbox" checked={on} onChange={(event) => set(event.currentTarget.checked)} />
      {text}
    </label>
  );
}
