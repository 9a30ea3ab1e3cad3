/** The browser's local store. It may be full or forbidden: then what the page keeps lasts as long as the page. */

/** What was kept under a name; null if there is nothing. */
export function kept(name: string): string | null {
  try {
    return localStorage.getItem(name);
  } catch {
    return null;
  }
}

export function keep(name: string, value: unknown): void {
  try {
    localStorage.setItem(name, JSON.stringify(value));
  } catch {
    // full or forbidden
  }
}
