/** Files that are built into the extension. */
declare module "*.wasm" {
  const bytes: Uint8Array<ArrayBuffer>;
  export default bytes;
}
declare module "*.lcrw" {
  const bytes: Uint8Array<ArrayBuffer>;
  export default bytes;
}
