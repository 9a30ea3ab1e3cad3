import { afterEach, expect, test, vi } from "vitest";
import { keep, kept } from "./store";

afterEach(() => vi.unstubAllGlobals());

test("what is kept is found again", () => {
  const held = new Map<string, string>();
  vi.stubGlobal("localStorage", {
    getItem: (name: string) => held.get(name) ?? null,
    setItem: (name: string, text: string) => held.set(name, text),
  });
  keep("a", { trail: 2 });
  expect([kept("a"), kept("b")]).toEqual(['{"trail":2}', null]);
});

test("a store that is full or forbidden stops nothing", () => {
  const refuse = () => {
    throw new Error("QuotaExceededError");
  };
  vi.stubGlobal("localStorage", { getItem: refuse, setItem: refuse });
  keep("a", 1);
  expect(kept("a")).toBeNull();
});
