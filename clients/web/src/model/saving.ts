/** How long a browser may take to begin to save. */
const KEPT_MS = 60_000;

/** Have the browser save a file under a name, as its user has it save downloads. */
export function saveAs(file: Blob, name: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), KEPT_MS);
}
