import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { captionOf, pictureName } from "../model/caption";
import { count, ms } from "../model/format";
import { noticeOf } from "../model/notice";
import { saveAs } from "../model/saving";
import { titleOf } from "../model/title";
import { Past } from "../past/past";
import { beside, besideKeys, box, mount, wantedStand, watchMounts } from "../scene/state";
import {
  chosen,
  chosenRow,
  fillGaps,
  maps,
  nameOf,
  options,
  optionsInForce,
  rows,
  setFillGaps,
  setOptions,
  stats,
  token,
  watchStream,
} from "../state";
import { createView, type Film, filmType, LONGEST_S, type View, type ViewStats } from "../view";
import { Missed } from "./missed";
import { Playback } from "./playback";
import { SceneTools } from "./scene";
import { ViewTools } from "./tools";

/** The chosen stream, live: the view, its tools and its figures. */
export function Viewer() {
  const host = useRef<HTMLDivElement>(null);
  const view = useRef<View | null>(null);
  const key = chosen.value;
  const known = chosenRow.value !== null;

  useEffect(() => {
    if (!host.current) return;
    const made = createView(host.current, optionsInForce.value);
    made.onstats((told) => {
      stats.value = told;
      document.title = titleOf(told.points);
    });
    view.current = made;
    return () => {
      made.dispose();
      view.current = null;
      stats.value = null;
    };
  }, []);

  useEffect(() => {
    if (key === null) view.current?.close();
    else view.current?.open(nameOf(key), token.value ?? undefined);
  }, [key, token.value]);

  useEffect(() => (key !== null && known ? watchStream(key) : undefined), [key, known]);

  useEffect(() => {
    const scene = { box: box.value, beside: beside.value, mount: mount.value };
    view.current?.set({ ...optionsInForce.value, ...scene });
  }, [optionsInForce.value, box.value, beside.value, mount.value]);

  useEffect(() => {
    if (wantedStand.value) view.current?.goTo(wantedStand.value);
    wantedStand.value = null;
  }, [wantedStand.value]);

  useEffect(() => watchMounts(besideKeys.value), [besideKeys.value]);

  /** What stands below pictures of the stream: as it is when one is made. */
  function caption(stampMs: number): string {
    const told = stats.value;
    if (key === null || told === null) return "";
    const [, notice] = noticeOf(told, key, rows.value, chosenRow.value);
    return captionOf(key, told, chosenRow.value?.codec ?? null, stampMs, notice);
  }

  async function savePicture() {
    const index = stats.value?.frameIndex ?? null;
    const picture = await view.current?.picture(caption);
    if (picture && key !== null) saveAs(picture, pictureName(key, index));
  }

  const filming = useSignal<number | null>(null);
  const film = useRef<Film | null>(null);

  async function makeFilm() {
    if (film.current) {
      film.current.stop();
      return;
    }
    const index = stats.value?.frameIndex ?? null;
    const made = view.current?.film(caption) ?? null;
    if (!made || key === null) return;
    film.current = made;
    filming.value = 0;
    const clock = window.setInterval(() => {
      filming.value = Math.min((filming.value ?? 0) + 1, LONGEST_S);
    }, 1000);
    const clip = await made.done;
    window.clearInterval(clock);
    film.current = filming.value = null;
    if (clip) saveAs(clip, pictureName(key, index, "webm"));
  }

  return (
    <main class="viewer" aria-label="Live view">
      <ViewTools
        options={options.value}
        set={setOptions}
        maps={maps.value}
        fillGaps={fillGaps.value}
        setFillGaps={setFillGaps}
        savePicture={() => void savePicture()}
        filming={filming.value}
        film={filmType() ? () => void makeFilm() : null}
      />
      <SceneTools stand={() => view.current?.stand() ?? null} />
      <Missed />
      <div class="stage">
        <div class="host" ref={host} />
        <Notice told={stats.value} />
      </div>
      {chosenRow.value?.playback && <Playback id={chosenRow.value.playback} />}
      {key !== null && known && !chosenRow.value?.playback && <Past key={key} name={key} />}
      <Footer told={stats.value} />
    </main>
  );
}

/** The notice over a picture that is not live. It is announced once, not every second. */
function Notice({ told }: { told: ViewStats | null }) {
  const [short, long] = noticeOf(told, chosen.value, rows.value, chosenRow.value);
  return (
    <div class={`notice ${short === "" ? "none" : ""} ${told?.points ? "over" : ""}`}>
      <span class="hidden" role="status">
        {short}
      </span>
      <span aria-hidden="true">{long}</span>
    </div>
  );
}

function Footer({ told }: { told: ViewStats | null }) {
  const row = chosenRow.value;
  return (
    <footer>
      <b>{chosen.value ?? ""}</b>
      <span>
        {told?.points ? count(told.points) : "–"} <i>points</i>
      </span>
      {told && told.inBox !== null && (
        <span>
          {count(told.inBox)} <i>of</i> {count(told.allPoints)} <i>in the box</i>
        </span>
      )}
      {told && told.madeUp > 0 && (
        <span>
          {count(told.madeUp)} <i>filled in</i>
        </span>
      )}
      <span>
        {told ? told.fps.toFixed(0) : "–"} <i>frames/s</i>
      </span>
      <span title="Age of the frame when this page drew it, counted from its last packet. In the fleet list the time ends earlier, when the frame is received and decoded; the rest is the way to this page, and drawing.">
        {ms(told?.age_ms)} <i>until drawn</i>
      </span>
      <span>
        <i>frame</i> {told?.frameIndex ?? "–"}
      </span>
      {told?.note && <span role="status">{told.note}</span>}
      <span class="grow" />
      {row?.codec && <span>{row.codec}</span>}
    </footer>
  );
}
