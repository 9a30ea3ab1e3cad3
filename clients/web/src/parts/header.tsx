import { rows, session, signOut } from "../state";

export function Header() {
  const all = rows.value ?? [];
  const alive = all.filter((row) => row.alive).length;
  const who = session.value;
  return (
    <header>
      <h1>lidarcodec</h1>
      <span class="quiet">
        {rows.value === null ? "" : `${alive} of ${all.length} ${all.length === 1 ? "stream" : "streams"} alive`}
      </span>
      <span class="grow" />
      <a href="./docs">API</a>
      {who?.token_needed ? (
        <>
          <span class="who">
            signed in as {who.name} <span class="chip">{who.role}</span>
          </span>
          <button type="button" class="small" onClick={() => signOut(null)}>
            Sign out
          </button>
        </>
      ) : (
        <span class="chip" title="There is no token yet: anybody on this machine can change everything">
          open to this machine
        </span>
      )}
    </header>
  );
}
