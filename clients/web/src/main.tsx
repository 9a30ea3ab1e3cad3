import { render } from "preact";
import { App } from "./app";
import { begin } from "./state";
import "./style.css";

void begin(); // before anything is drawn: the answer takes its time
const host = document.getElementById("app");
if (host) render(<App />, host);
