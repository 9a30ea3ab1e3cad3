import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { differences } from "../model/draft";
import { moment, plain } from "../model/format";
import { poll } from "../model/poll";
import type { AuditEntry } from "../model/wire";
import { call, nameOf, pathOf } from "../state";

const EVERY_MS = 3000;
const PAGE = 30;

/** Changes of a stream with their authors, newest first. */
export function Audit({ name }: { name: string }) {
  const path = `${pathOf(nameOf(name))}/audit`;
  const entries = useSignal<AuditEntry[] | null>(null);
  const more = useSignal(false);

  useEffect(() => {
    const asking = poll(EVERY_MS, async () => {
      const { body } = await call<AuditEntry[]>("GET", `${path}?limit=${PAGE}`);
      const last = body.at(-1);
      const older = last ? (entries.value ?? []).filter((one) => one.id < last.id) : [];
      if (entries.value === null) more.value = body.length === PAGE;
      entries.value = [...body, ...older];
    });
    return asking.stop;
  }, [path]);

  async function older() {
    const last = entries.value?.at(-1);
    if (!last) return;
    const { body } = await call<AuditEntry[]>("GET", `${path}?limit=${PAGE}&before=${last.id}`);
    entries.value = [...(entries.value ?? []), ...body];
    more.value = body.length === PAGE;
  }

  if (entries.value === null) {
    return (
      <p class="quiet pad" role="status">
        Loading changes …
      </p>
    );
  }
  if (entries.value.length === 0) return <p class="quiet pad">{name} has not been changed yet.</p>;
  return (
    <>
      <ol class="audit" aria-label={`Changes of ${name}, newest first`}>
        {entries.value.map((entry) => (
          <Entry key={entry.id} entry={entry} />
        ))}
      </ol>
      {more.value && (
        <p class="pad">
          <button type="button" onClick={() => void older()}>
            Older
          </button>
        </p>
      )}
    </>
  );
}

function Entry({ entry }: { entry: AuditEntry }) {
  const changed = entry.new ? differences(entry.old, entry.new) : [];
  return (
    <li>
      <p class="line">
        <time dateTime={entry.at}>{moment(entry.at)}</time>
        <b>{entry.who}</b>
        <span class={`chip ${entry.result}`}>{entry.action === "settings" ? entry.result : entry.action}</span>
        {entry.first_frame !== null && <span class="quiet">frame {entry.first_frame}</span>}
      </p>
      <p>
        {changed.length > 0 && entry.old
          ? changed.map(([name, old, value]) => (
              <span class="change" key={name}>
                {name} <s>{plain(old)}</s> {plain(value)}
              </span>
            ))
          : Object.entries(entry.changes).map(([name, value]) => (
              <span class="change" key={name}>
                {name} {plain(value)}
              </span>
            ))}
      </p>
      {entry.reason && <p class="warn">{entry.reason}</p>}
    </li>
  );
}
