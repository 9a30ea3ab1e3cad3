// Builds the extension into dist: extension.js, and the archive that Foxglove installs, NAME.foxe, a zip file.
// `--tests` also bundles the tests into dist/test;  `--out FOLDER` takes another folder.
import { readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";
import { zipSync } from "fflate";

const home = dirname(dirname(fileURLToPath(import.meta.url)));
const at = (...parts) => join(home, ...parts);
const words = process.argv.slice(2);
const out = words.includes("--out") ? resolve(words[words.indexOf("--out") + 1]) : at("dist");
const shared = {
  bundle: true,
  absWorkingDir: home,
  target: "es2022",
  legalComments: "none",
  loader: { ".wasm": "binary", ".lcrw": "binary" },
  alias: { zstddec: at("node_modules/zstddec") }, // of the sources in ../typescript, too
};

if (out === at("dist")) rmSync(out, { recursive: true, force: true });
await build({
  ...shared,
  entryPoints: ["src/index.ts"],
  outfile: join(out, "extension.js"),
  format: "cjs", // Foxglove evaluates the file with `module` and `require`
  platform: "browser",
  minify: true,
});

const { name, publisher, version } = JSON.parse(readFileSync(at("package.json"), "utf8"));
const files = {
  "package.json": at("package.json"),
  "README.md": at("README.md"),
  "CHANGELOG.md": at("CHANGELOG.md"),
  LICENSE: at("../../LICENSE"),
  "dist/extension.js": join(out, "extension.js"),
};
const contents = Object.fromEntries(Object.entries(files).map(([file, path]) => [file, readFileSync(path)]));
// One date, so that equal sources give equal archives.
const archive = zipSync(contents, { level: 9, mtime: new Date(2026, 0, 1) });
const foxe = `${publisher}.${name}-${version}.foxe`;
writeFileSync(join(out, foxe), archive);
console.log(`${join(out, foxe)}: ${archive.length.toLocaleString("en")} bytes`);

if (words.includes("--tests")) {
  await build({
    ...shared,
    entryPoints: readdirSync(at("test")).filter((file) => file.endsWith(".test.ts")).map((file) => `test/${file}`),
    outdir: join(out, "test"),
    outExtension: { ".js": ".mjs" },
    format: "esm",
    platform: "node",
    // Bundled CommonJS packages ask for node's own modules.
    banner: { js: 'import { createRequire } from "node:module"; const require = createRequire(import.meta.url);' },
  });
}
