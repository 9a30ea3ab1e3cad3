import { span } from "../model/format";
import { awaySince } from "../state";
import { useNow } from "./now";

/** Says that the server does not answer, and since when: the page then shows old data. */
export function Banner() {
  const now = useNow(awaySince.value !== null);
  if (awaySince.value === null) return null;
  const seconds = Math.max(0, (now - awaySince.value) / 1000);
  return (
    <div class="banner" role="alert">
      No answer from the server{seconds >= 2 ? ` for ${span(seconds)}` : ""}. The page shows old data and keeps trying.
    </div>
  );
}
