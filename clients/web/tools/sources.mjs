// Says which sources the committed build was made from: `node tools/sources.mjs write|check`.
//
// sources.json beside the build holds the SHA-256 of every source that goes into it (the list `sources` of package.json;
// tests are left out) and of every file that came out. tests/web/test_build.py compares both without node.
import { createHash } from "node:crypto";
import { existsSync, readdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { dirname, join, posix, relative, sep } from "node:path";
import { fileURLToPath } from "node:url";

const web = dirname(dirname(fileURLToPath(import.meta.url)));
const root = dirname(dirname(web));
const built = join(root, "server", "lidarcodec_server", "web");
const manifest = join(built, "sources.json");

function files(path) {
  if (!existsSync(path)) return [];
  if (!statSync(path).isDirectory()) return [path];
  return readdirSync(path).flatMap((name) => files(join(path, name)));
}

function hashes(paths) {
  const named = paths.map((path) => [relative(root, path).split(sep).join(posix.sep), path]);
  const rows = named.map(([name, path]) => [name, createHash("sha256").update(readFileSync(path)).digest("hex")]);
  return Object.fromEntries(rows.sort(([a], [b]) => (a < b ? -1 : 1)));
}

const listed = JSON.parse(readFileSync(join(web, "package.json"), "utf8")).sources;
const sources = listed.flatMap((name) => files(join(web, name))).filter((name) => !/\.test\.tsx?$/.test(name));
const now = {
  sources: hashes(sources),
  built: hashes(files(built).filter((name) => name !== manifest)),
};
const text = `${JSON.stringify(now, null, 1)}\n`;

if (process.argv[2] === "write") {
  writeFileSync(manifest, text);
} else if (!existsSync(manifest) || readFileSync(manifest, "utf8") !== text) {
  console.error("the committed page is not what the sources give: make web");
  process.exit(1);
}
