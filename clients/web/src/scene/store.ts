/** The browser's stores. They may be full or forbidden: then what the page keeps lasts as long as the page. */

/** What was kept under a name; null if there is nothing. */
export function kept(name: string): string | null {
  return tried(() => localStorage.getItem(name));
}

export function keep(name: string, value: unknown): void {
  tried(() => localStorage.setItem(name, JSON.stringify(value)));
}

/** As `kept`, of the store of this tab. */
export function keptInTab(name: string): string | null {
  return tried(() => sessionStorage.getItem(name));
}

/** Keeps a text until the tab is closed; null removes it. */
export function keepInTab(name: string, text: string | null): void {
  tried(() => (text === null ? sessionStorage.removeItem(name) : sessionStorage.setItem(name, text)));
}

/** What a store answers; null if it is full or forbidden. A browser that forbids it may throw at its very name. */
function tried<T>(ask: () => T): T | null {
  try {
    return ask();
  } catch {
    return null;
  }
}
