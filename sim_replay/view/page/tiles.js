// Fetch picture tiles when they are drawn, the last asked for first, and keep a bounded number of them.

import {getTile} from "./api.js";

export const TILE = 256; // rows and columns
const KEPT = 300; // tiles: 100 MB with their pictures
const AT_ONCE = 6; // requests, as many as browsers send to one host

// kind: "tile" over ground range, "slant" over slant range.
export function tileStore(kind, onArrival) {
  const kept = new Map();
  let wanted = [], running = 0, version = 0, colours = new Uint32Array(256), look = 0;

  function paint(tile) {
    const context = tile.canvas.getContext("2d");
    const picture = context.createImageData(TILE, TILE), words = new Uint32Array(picture.data.buffer);
    for (let index = 0; index < words.length; index++) words[index] = colours[tile.codes[index]];
    context.putImageData(picture, 0, 0);
    tile.look = look;
  }

  async function work() {
    if (running >= AT_ONCE || !wanted.length) return;
    const tile = wanted.pop();
    running++;
    try {
      const {codes, final} = await getTile(kind, tile.level, tile.row, tile.column);
      Object.assign(tile, {codes, final, stale: false, look: -1});
      version++;
      onArrival();
    } catch {
      tile.retry = performance.now() + 2000; // the server is away: ask again later
    } finally {
      tile.asked = false;
      running--;
      work();
    }
  }

  return {
    // The picture of a tile, first row at the top; null while it is on its way.
    picture(level, row, column) {
      const key = `${level}/${row}/${column}`;
      let tile = kept.get(key);
      if (tile) kept.delete(key);
      else tile = {level, row, column, codes: null, final: false, stale: true, asked: false, retry: 0, look: -1};
      kept.set(key, tile);
      while (kept.size > KEPT) kept.delete(kept.keys().next().value);
      if (tile.stale && !tile.asked && performance.now() > tile.retry) {
        tile.asked = true;
        wanted.push(tile);
        if (wanted.length > 80) wanted.splice(0, wanted.length - 80).forEach((left) => (left.asked = false));
        work();
      }
      if (!tile.codes) return null;
      if (tile.look !== look) {
        tile.canvas ||= new OffscreenCanvas(TILE, TILE);
        paint(tile);
      }
      return tile.canvas;
    },
    // The picture if it is at hand; nothing is fetched.
    peek(level, row, column) {
      const tile = kept.get(`${level}/${row}/${column}`);
      return tile && tile.codes && tile.look === look ? tile.canvas : null;
    },
    recolour(words) {
      colours = words;
      look++;
      version++;
    },
    // New rows have come: tiles that were not complete are fetched again when they are drawn.
    outdate() {
      for (const tile of kept.values()) if (!tile.final) tile.stale = true;
    },
    get busy() {
      return running > 0 || wanted.length > 0;
    },
    get version() {
      return version;
    },
    get size() {
      return kept.size;
    },
  };
}
