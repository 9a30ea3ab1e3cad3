import { defineConfig } from "vitest/config";

// `npm run dev` shows the page with the data of a server that runs here: LIDARCODEC_SERVER=http://127.0.0.1:8080.
// The Host header stays the page's own, because the server refuses changes by pages of another origin.
const server = process.env.LIDARCODEC_SERVER ?? "http://127.0.0.1:8080";

export default defineConfig({
  base: "./", // works below any path that a proxy puts in front
  build: {
    outDir: "../../server/lidarcodec_server/web",
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0, // the page's policy allows nothing inline
    chunkSizeWarningLimit: 900,
    modulePreload: { polyfill: false },
  },
  worker: { format: "es" },
  resolve: { dedupe: ["zstddec"] }, // of the sources in ../typescript, too
  server: { proxy: { "/api": { target: server, ws: true } } },
  test: { environment: "node", include: ["src/**/*.test.ts", "src/**/*.test.tsx"] },
});
