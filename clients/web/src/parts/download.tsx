import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { fetchFile, Problem } from "../model/api";
import { bytes } from "../model/format";
import { saveAs } from "../model/saving";
import { token } from "../state";
import { Button } from "./button";

interface Props {
  path: string;
  /** Name of the file. */
  file: string;
  /** Its bytes, where they are known before. */
  size?: number;
  off?: boolean;
  label: string;
}

/** Saves a recording as a file. It says how much is here, and can be ended. */
export function Download({ path, file, size, off = false, label }: Props) {
  const here = useSignal<number | null>(null);
  const problem = useSignal<string | null>(null);
  const ending = useRef<AbortController | null>(null);
  useEffect(() => () => ending.current?.abort(), []);

  async function save() {
    const stop = new AbortController();
    ending.current = stop;
    problem.value = null;
    here.value = 0;
    try {
      const tell = (bytes: number) => {
        here.value = bytes;
      };
      saveAs(await fetchFile(path, token.value, tell, stop.signal), file);
    } catch (error) {
      if (!stop.signal.aborted) problem.value = error instanceof Problem ? error.detail : String(error);
    } finally {
      here.value = null;
    }
  }

  if (here.value !== null) {
    return (
      <Button look="small" press={() => ending.current?.abort()}>
        Stop ({bytes(here.value)}
        {size !== undefined && ` of ${bytes(size)}`})
      </Button>
    );
  }
  return (
    <>
      <Button look="small" off={off} label={label} press={() => void save()}>
        Download
      </Button>
      {problem.value !== null && (
        <span class="problem" role="alert">
          {problem.value}
        </span>
      )}
    </>
  );
}
