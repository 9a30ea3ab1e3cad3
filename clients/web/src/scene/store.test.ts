import { afterEach, expect, test, vi } from "vitest";
import { keep, keepInTab, kept, keptInTab } from "./store";

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

test("a token is kept in the tab until it is removed", () => {
  const held = new Map<string, string>();
  vi.stubGlobal("sessionStorage", {
    getItem: (name: string) => held.get(name) ?? null,
    setItem: (name: string, text: string) => held.set(name, text),
    removeItem: (name: string) => held.delete(name),
  });
  keepInTab("token", "abc");
  expect(keptInTab("token")).toBe("abc");
  keepInTab("token", null);
  expect(keptInTab("token")).toBeNull();
});

test("the page's state begins without a token where the browser forbids the very name of its store", async () => {
  const forbidden = {
    get(): never {
      throw new DOMException("The operation is insecure.", "SecurityError");
    },
    configurable: true,
  };
  vi.stubGlobal("location", { hash: "" });
  vi.stubGlobal("window", { addEventListener: () => undefined });
  Object.defineProperty(globalThis, "sessionStorage", forbidden);
  Object.defineProperty(globalThis, "localStorage", forbidden);
  try {
    const state = await import("../state");
    expect(state.token.value).toBeNull();
    keepInTab("token", "abc");
    state.signOut("signed out");
    expect([state.gate.value, keptInTab("token")]).toEqual(["closed", null]);
  } finally {
    Reflect.deleteProperty(globalThis, "sessionStorage");
    Reflect.deleteProperty(globalThis, "localStorage");
  }
});
