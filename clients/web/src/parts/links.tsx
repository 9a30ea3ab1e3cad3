import { label, listOf } from "../model/format";
import { same } from "../model/schema";
import type { Settings, Value } from "../model/wire";
import { links, schema } from "../state";
import { Button } from "./button";

interface Props {
  /** The value of a setting in the form. */
  wanted: (name: string) => Value;
  take: (settings: Settings) => void;
  disabled: boolean;
}

/** Presets for links: each sets a few settings of the form, and says which. */
export function Links({ wanted, take, disabled }: Props) {
  if (links.value.length === 0) return null;
  const chosen = links.value.find(({ settings }) =>
    Object.entries(settings).every(([name, value]) => same(wanted(name), value)),
  );
  const pinned = Object.entries(schema.value?.properties ?? {})
    .filter(([name, { free }]) => free !== undefined && !same(wanted(name), free))
    .map(([name]) => label(name));
  return (
    <fieldset class="links">
      <legend>Link</legend>
      {links.value.map((one) => (
        <Button
          key={one.name}
          look="small"
          off={disabled}
          pressed={one === chosen}
          title={listOf(one.settings)}
          press={() => take(one.settings)}
        >
          {one.label}
        </Button>
      ))}
      <p class="help">
        {chosen ? (
          <>
            Sets only <code>{listOf(chosen.settings)}</code>.
          </>
        ) : (
          "A link sets only purpose, codec and target bitrate."
        )}
        {chosen && pinned.length > 0 && ` Unchanged: ${pinned.join(", ")}.`}
      </p>
    </fieldset>
  );
}
