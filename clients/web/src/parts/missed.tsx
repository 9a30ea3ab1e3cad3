import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { Problem } from "../model/api";
import { freed, headOf, sentence, TWO } from "../model/missed";
import { call, chosen, mayChange, missed, nameOf, pathOf, refreshStream, schema, stream } from "../state";
import { Button } from "./button";

/** A red notice over the picture while the target bitrate is missed, or two publishers have one name: why, and what to
 * do. */
export function Missed() {
  const told = missed.value;
  const trouble = useSignal<string | null>(null);
  const sending = useSignal(false);
  useEffect(() => {
    trouble.value = null;
  }, [told?.code, chosen.value]);
  if (told === null) return null;
  const settings = stream.value?.settings ?? {};

  async function setBack() {
    if (chosen.value === null || told === null) return;
    sending.value = true;
    try {
      await call("PATCH", `${pathOf(nameOf(chosen.value))}/settings`, freed(told.settings, settings, schema.value));
      trouble.value = null;
    } catch (error) {
      trouble.value = error instanceof Problem ? error.detail : String(error);
    }
    sending.value = false;
    refreshStream();
  }

  return (
    <section class="target-missed" aria-label={told.code === TWO ? "Two publishers" : "Target bitrate"}>
      <div>
        <b role="alert">{headOf(told)}</b>
        <p>{sentence(told.message)}</p>
        <p>{sentence(told.remedy)}</p>
        {trouble.value && <p role="alert">Not changed: {trouble.value}</p>}
      </div>
      {told.settings.length > 0 && mayChange.value && (
        <Button
          off={sending.value}
          press={setBack}
          title={`Let the target bitrate decide on ${told.settings.join(", ")}`}
        >
          Set back
        </Button>
      )}
    </section>
  );
}
