import { Banner } from "./parts/banner";
import { FleetList } from "./parts/fleet";
import { Header } from "./parts/header";
import { Panel } from "./parts/panel";
import { SignIn } from "./parts/signin";
import { Viewer } from "./parts/viewer";
import { awaySince, chosen, gate } from "./state";

export function App() {
  if (gate.value === "closed") return <SignIn />;
  if (gate.value === "asking") {
    return (
      <main class="alone" aria-busy={awaySince.value === null}>
        <p role="status">
          {awaySince.value === null ? "Connecting to the server …" : "The server does not answer. Trying again …"}
        </p>
      </main>
    );
  }
  return (
    <div class="app">
      <button type="button" class="skip" onClick={() => document.getElementById("settings")?.focus()}>
        Skip to settings
      </button>
      <Header />
      <Banner />
      <div class="columns">
        <FleetList />
        <Viewer />
        <Panel key={chosen.value} />
      </div>
    </div>
  );
}
