import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { request } from "./api";
import { titleOf } from "./title";
import { createView, DEFAULT_OPTIONS, type StreamName, type View } from "./view";

export function App() {
  const host = useRef<HTMLDivElement>(null);
  const view = useRef<View | null>(null);
  const streams = useSignal<StreamName[]>([]);

  useEffect(() => {
    if (!host.current) return;
    const made = createView(host.current, DEFAULT_OPTIONS);
    made.onstats(({ points }) => {
      document.title = titleOf(points);
    });
    view.current = made;
    return () => made.dispose();
  }, []);

  useEffect(() => {
    const ask = async () => {
      const { body } = await request<StreamName[]>("GET", "api/v1/streams", null);
      const first = body[0];
      if (streams.value.length === 0 && first) view.current?.open(first);
      streams.value = body;
    };
    void ask();
    const timer = window.setInterval(ask, 1000);
    return () => window.clearInterval(timer);
  }, []);

  return (
    <main>
      <h1>lidarcodec</h1>
      <ul>
        {streams.value.map((one) => (
          <li key={`${one.vehicle}/${one.sensor}`}>
            <button type="button" onClick={() => view.current?.open(one)}>
              {one.vehicle}/{one.sensor}
            </button>
          </li>
        ))}
      </ul>
      <div ref={host} />
    </main>
  );
}
