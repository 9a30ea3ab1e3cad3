import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { Problem } from "../model/api";
import { gateReason, signIn } from "../state";

/** Asks for a token. It stays in this tab's session storage until the tab is closed. */
export function SignIn() {
  const problem = useSignal<string | null>(gateReason.value);
  const busy = useSignal(false);
  const input = useRef<HTMLInputElement>(null);
  useEffect(() => {
    document.title = "lidarcodec";
    input.current?.focus();
  }, []);

  async function submit(event: Event) {
    event.preventDefault();
    const given = input.current?.value.trim() ?? "";
    if (given === "" || busy.value) return;
    busy.value = true;
    problem.value = null;
    try {
      await signIn(given);
    } catch (error) {
      problem.value = error instanceof Problem && error.status !== 401 ? error.detail : "This token is not valid.";
      busy.value = false;
      input.current?.focus();
      input.current?.select();
    }
  }

  return (
    <main class="alone">
      <form class="signin" onSubmit={submit} aria-labelledby="signin-title">
        <h1 id="signin-title">lidarcodec</h1>
        <label for="token">Token</label>
        <input
          id="token"
          ref={input}
          type="password"
          autocomplete="off"
          spellcheck={false}
          required
          placeholder="lct_…"
          aria-invalid={problem.value !== null}
          aria-describedby="signin-help signin-problem"
        />
        <button type="submit" class="primary" disabled={busy.value}>
          {busy.value ? "Signing in …" : "Sign in"}
        </button>
        <p id="signin-problem" class="problem" role="alert">
          {problem.value}
        </p>
        <p id="signin-help" class="quiet">
          This server needs a token. Its administrator can create one:{" "}
          <code>lidarcodec token create NAME --role viewer</code>
        </p>
      </form>
    </main>
  );
}
