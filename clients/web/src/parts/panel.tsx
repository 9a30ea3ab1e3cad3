import { useSignal } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { useRef } from "preact/hooks";
import { chosen, chosenRow, rows } from "../state";
import { Audit } from "./audit";
import { Recordings } from "./recordings";
import { SettingsForm } from "./settings";

const TABS = ["Settings", "Changes", "Recordings"] as const;
type Tab = (typeof TABS)[number];

/** Next to the view: settings of the chosen stream, their changes, and recordings. */
export function Panel() {
  const open = useSignal<Tab>(remembered);
  const list = useRef<HTMLDivElement>(null);

  function show(tab: Tab) {
    remembered = tab;
    open.value = tab;
  }

  function arrows(event: KeyboardEvent) {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    const next = TABS[(TABS.indexOf(open.value) + step + TABS.length) % TABS.length] as Tab;
    show(next);
    list.current?.querySelector<HTMLElement>(`#tab-${next}`)?.focus();
  }

  return (
    <aside class="panel" aria-label="Settings and recordings" id="settings" tabIndex={-1}>
      <div class="tabs" role="tablist" aria-label="What to show" ref={list} onKeyDown={arrows}>
        {TABS.map((tab) => (
          <button
            key={tab}
            type="button"
            role="tab"
            id={`tab-${tab}`}
            aria-selected={open.value === tab}
            aria-controls="tab-panel"
            tabIndex={open.value === tab ? 0 : -1}
            onClick={() => show(tab)}
          >
            {tab}
          </button>
        ))}
      </div>
      <div id="tab-panel" role="tabpanel" aria-labelledby={`tab-${open.value}`}>
        <Body tab={open.value} />
      </div>
    </aside>
  );
}

let remembered: Tab = "Settings";

function Body({ tab }: { tab: Tab }): ComponentChildren {
  if (tab === "Recordings") return <Recordings />;
  if (chosen.value === null) return <p class="quiet pad">Choose a stream.</p>;
  if (rows.value !== null && chosenRow.value === null)
    return <p class="quiet pad">The server does not know {chosen.value}.</p>;
  return tab === "Settings" ? <SettingsForm name={chosen.value} /> : <Audit name={chosen.value} />;
}
