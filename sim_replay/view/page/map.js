// The map: north up, metres about the first position of the mission; the sea floor is drawn from the waterfall itself.

import {get} from "./api.js";
import {byId, colour, fitted, perFrame} from "./dom.js";
import {TILE} from "./tiles.js";
import {markColour} from "./waterfall.js";
import {niceStep} from "./words.js";

const EARTH_M = 6371008.8 * Math.PI / 180; // metres in a degree of latitude, mean radius: for drawing alone
const STRIP_ROWS = 64; // rows between two corners that the server gives

export function mapView(tiles, handlers) {
  const box = byId("map-view"), picture = byId("map-picture");
  const view = {east: 0, north: 0, scale: 1};
  const layers = {chart: true, mosaic: true, coverage: false, clearance: false, track: true, contacts: true, plan: true};
  let home = null, grid = null, track = null, files = {}, shown = [], structures = [], selected = null, drag = null, wasFitted = false, wasMoved = false;
  let chart = null;
  let strips = {rows: [], corners: []}, asking = false;
  const mosaic = {canvas: new OffscreenCanvas(1, 1), key: "", view: null, next: 0};

  const redraw = perFrame(draw);
  new ResizeObserver(redraw).observe(box);
  const size = () => box.getBoundingClientRect();
  const east = (longitude) => (((longitude - home.longitude + 540) % 360) - 180) * EARTH_M * home.cosine;
  const north = (latitude) => (latitude - home.latitude) * EARTH_M;
  const toX = (metres, width) => width / 2 + (metres - view.east) * view.scale;
  const toY = (metres, height) => height / 2 - (metres - view.north) * view.scale;
  const place = (longitude, latitude, width, height) => [toX(east(longitude), width), toY(north(latitude), height)];

  function settle() {
    if (home) return;
    const index = track ? track.latitude.findIndex((value) => value !== null) : -1;
    const contact = shown.find((one) => one.latitude !== null);
    const at = index >= 0 ? [track.latitude[index], track.longitude[index]] : contact ? [contact.latitude, contact.longitude] : null;
    if (at) home = {latitude: at[0], longitude: at[1], cosine: Math.cos(at[0] * Math.PI / 180)};
  }

  function draw() {
    const {context, width, height} = fitted(picture);
    context.fillStyle = colour("ground");
    context.fillRect(0, 0, width, height);
    settle();
    if (!home) return;
    if (!wasFitted) fit();
    if (layers.chart && chart) drawChart(context, width, height);
    if (layers.mosaic) showMosaic(context, width, height);
    drawGrid(context, width, height);
    if (layers.coverage) drawCoverage(context, width, height);
    if (layers.clearance && files.clearance) drawClearance(context, width, height);
    if (layers.track && track) drawTrack(context, width, height);
    if (layers.plan && files.waypoints) drawPlan(context, width, height);
    if (layers.contacts) drawStructures(context, width, height);
    if (layers.contacts) drawContacts(context, width, height);
  }

  function drawChart(context, width, height) {
    const [left, top] = place(chart.west, chart.north, width, height), [right, bottom] = place(chart.east, chart.south, width, height);
    context.drawImage(chart.picture, left, top, right - left, bottom - top);
  }

  async function moreStrips() {
    const have = strips.rows.length ? strips.rows[strips.rows.length - 1] : grid.first_row;
    if (asking || !grid.row_m || have + STRIP_ROWS > grid.stop_row) return;
    asking = true;
    const known = strips;
    let isOutdated = false; // the answer, where another picture has come meanwhile
    try {
      const more = await get(`api/strips/${have}/${grid.stop_row}`);
      // The last corner comes again: it lay behind the last ping, by whose pose it was placed.
      isOutdated = strips !== known;
      if (more.row.length && !isOutdated) strips = {rows: [...strips.rows.slice(0, -1), ...more.row], corners: [...strips.corners.slice(0, -1), ...more.corners]};
      if (!wasMoved) fit(); // a mission that grows stays in sight until somebody looks closer
      redraw();
    } finally {
      asking = false;
    }
    if (isOutdated) await moreStrips();
  }

  // The sea floor is drawn apart, not at every frame: until its next turn the last picture is moved and scaled.
  function showMosaic(context, width, height) {
    if (!grid || !grid.columns) return;
    const key = [view.east, view.north, view.scale, width, height, tiles.version, strips.rows.length].join();
    const now = performance.now();
    if (key !== mosaic.key && now >= mosaic.next) {
      const ratio = window.devicePixelRatio || 1;
      mosaic.canvas.width = Math.round(width * ratio), mosaic.canvas.height = Math.round(height * ratio);
      drawMosaic(mosaic.canvas.getContext("2d"), width, height);
      const cost = performance.now() - now;
      Object.assign(mosaic, {key, view: {...view}, next: now + Math.max(60, 4 * cost)});
    } else if (key !== mosaic.key) setTimeout(redraw, mosaic.next - now);
    if (!mosaic.view) return;
    const zoomed = view.scale / mosaic.view.scale;
    const x = toX(mosaic.view.east, width) - zoomed * width / 2, y = toY(mosaic.view.north, height) - zoomed * height / 2;
    context.globalAlpha = document.documentElement.dataset.theme === "night" ? 0.8 : 1;
    context.drawImage(mosaic.canvas, x, y, zoomed * width, zoomed * height);
    context.globalAlpha = 1;
  }

  function drawMosaic(context, width, height) {
    const ratio = window.devicePixelRatio || 1;
    const narrow = Math.ceil(Math.log2(grid.columns / TILE));
    const coarse = Math.floor(Math.log2(1 / (view.scale * grid.column_m)));
    const level = Math.max(0, narrow, Math.min(6, coarse));
    const factor = 2 ** level, columns = grid.columns / factor;
    // Pieces of at least 3 pixels along the track, of one tile each.
    const together = Math.max(1, Math.min(2 ** Math.floor(Math.log2(3 / (STRIP_ROWS * grid.row_m * view.scale))), TILE * factor / STRIP_ROWS));
    const rows = together * STRIP_ROWS / factor;
    for (let index = 0; index + together < strips.rows.length; index += together) {
      const here = strips.corners[index], next = strips.corners[index + together];
      if (here[1][0] === null || next[1][0] === null || here[0][0] === null || here[2][0] === null) continue;
      const [port, middle, starboard] = here.map((corner) => place(...corner, width, height));
      const ahead = place(...next[1], width, height);
      if (Math.max(port[0], starboard[0], ahead[0]) < 0 || Math.min(port[0], starboard[0], ahead[0]) > width) continue;
      if (Math.max(port[1], starboard[1], ahead[1]) < 0 || Math.min(port[1], starboard[1], ahead[1]) > height) continue;
      const first = strips.rows[index] / factor, tileRow = Math.floor(first / TILE), top = first - tileRow * TILE;
      for (const [column, end, sign] of [[0, starboard, 1], [-1, port, -1]]) {
        const tile = tiles.picture(level, tileRow, column);
        if (!tile) continue;
        // In a turn the far end runs ahead of the middle or back: such a piece has no true shape.
        const farther = place(...next[column ? 0 : 2], width, height);
        const run = Math.hypot(farther[0] - end[0], farther[1] - end[1]) / Math.hypot(ahead[0] - middle[0], ahead[1] - middle[1]);
        if (!(run > 0.7 && run < 1.4)) continue;
        const across = [(end[0] - middle[0]) / columns * sign, (end[1] - middle[1]) / columns * sign];
        const along = [(ahead[0] - middle[0]) / rows, (ahead[1] - middle[1]) / rows];
        context.setTransform(ratio * across[0], ratio * across[1], ratio * along[0], ratio * along[1], ratio * middle[0], ratio * middle[1]);
        // As far as the next piece begins at the far end, over which that one is drawn.
        const reach = Math.max(1, rows * (Math.max(run, 1) + 0.06)), tall = Math.max(1, Math.min(reach, TILE - top));
        const used = Math.min(TILE, Math.ceil(columns));
        context.drawImage(tile, sign > 0 ? 0 : TILE - used, top, used, tall, sign > 0 ? 0 : -used, 0, used, reach);
      }
    }
  }

  function drawGrid(context, width, height) {
    const step = niceStep(width / view.scale, 5);
    context.strokeStyle = colour("line");
    context.globalAlpha = 0.5;
    context.lineWidth = 1;
    const [west, south] = [view.east - width / 2 / view.scale, view.north - height / 2 / view.scale];
    context.beginPath();
    for (let at = Math.ceil(west / step) * step; toX(at, width) < width; at += step) context.moveTo(toX(at, width), 0), context.lineTo(toX(at, width), height);
    for (let at = Math.ceil(south / step) * step; toY(at, height) > 0; at += step) context.moveTo(0, toY(at, height)), context.lineTo(width, toY(at, height));
    context.stroke();
    context.globalAlpha = 1;
    const bar = niceStep(width / view.scale, 6), ink = colour("ink");
    context.lineWidth = 3;
    context.strokeStyle = ink;
    context.beginPath();
    context.moveTo(12, height - 12), context.lineTo(12 + bar * view.scale, height - 12);
    context.stroke();
    context.font = `${colour("weight")} 12px system-ui, "DejaVu Sans", sans-serif`;
    outlined(context, bar >= 1000 ? `${bar / 1000} km` : `${bar} m`, 12, height - 18);
    outlined(context, "N ↑", width - 34, 18);
  }

  function outlined(context, text, x, y) {
    context.lineWidth = 3;
    context.strokeStyle = colour("ground");
    context.strokeText(text, x, y);
    context.fillStyle = colour("ink");
    context.fillText(text, x, y);
  }

  function ring(context, points, width, height) {
    points.forEach(([longitude, latitude], index) => context[index ? "lineTo" : "moveTo"](...place(longitude, latitude, width, height)));
    context.closePath();
  }

  const polygons = (geometry) => !geometry ? [] : geometry.type === "Polygon" ? [geometry.coordinates] : geometry.type === "MultiPolygon" ? geometry.coordinates : [];

  function drawCoverage(context, width, height) {
    context.fillStyle = colour("judged");
    context.globalAlpha = 0.25;
    context.beginPath();
    for (const feature of files.coverage ? files.coverage.features : [])
      for (const polygon of polygons(feature.geometry)) for (const points of polygon) ring(context, points, width, height);
    for (const points of files.seen || []) ring(context, points, width, height);
    context.fill("nonzero");
    context.globalAlpha = 1;
  }

  function drawClearance(context, width, height) {
    for (const feature of files.clearance.features) {
      const share = feature.properties.p_mean ?? 0;
      context.fillStyle = `hsl(${Math.round(130 * share)} 75% 45% / 0.45)`;
      context.beginPath();
      for (const polygon of polygons(feature.geometry)) for (const points of polygon) ring(context, points, width, height);
      context.fill();
    }
  }

  function drawTrack(context, width, height) {
    for (const [line, ink] of [[3, colour("ground")], [1.5, colour("accent")]]) {
      context.lineWidth = line;
      context.strokeStyle = ink;
      context.beginPath();
      let down = false;
      track.latitude.forEach((latitude, index) => {
        if (latitude === null) return (down = false);
        context[down ? "lineTo" : "moveTo"](...place(track.longitude[index], latitude, width, height));
        return (down = true);
      });
      context.stroke();
    }
    const last = track.latitude.findLastIndex((latitude) => latitude !== null);
    if (last < 0 || !grid || !grid.live) return;
    const [x, y] = place(track.longitude[last], track.latitude[last], width, height);
    context.fillStyle = colour("accent");
    context.beginPath();
    context.arc(x, y, 6, 0, 7);
    context.fill();
  }

  function drawPlan(context, width, height) {
    context.strokeStyle = context.fillStyle = colour("missed");
    context.lineWidth = 1.5;
    context.setLineDash([6, 4]);
    for (const {geometry} of files.waypoints.features) {
      if (!geometry) continue;
      const lines = geometry.type === "LineString" ? [geometry.coordinates] : geometry.type === "MultiLineString" ? geometry.coordinates : [];
      for (const line of lines) {
        context.beginPath();
        line.forEach(([longitude, latitude], index) => context[index ? "lineTo" : "moveTo"](...place(longitude, latitude, width, height)));
        context.stroke();
      }
    }
    context.setLineDash([]);
  }

  function drawStructures(context, width, height) {
    context.lineWidth = 1.5;
    for (const {id, geometry} of structures) {
      for (const polygon of polygons(geometry)) {
        context.beginPath();
        ring(context, polygon[0], width, height);
        context.strokeStyle = colour("ink");
        context.stroke();
        outlined(context, id, ...place(...polygon[0][0], width, height));
      }
    }
  }

  function drawContacts(context, width, height) {
    let current = null;
    for (const likely of [false, true]) {
      for (const contact of shown) {
        if (contact.latitude === null || (contact.likely || Boolean(contact.call) || contact.drawn) !== likely) continue;
        const [x, y] = place(contact.longitude, contact.latitude, width, height);
        if (contact.key === selected) current = [x, y];
        if (x < -9 || y < -9 || x > width + 9 || y > height + 9) continue;
        context.fillStyle = colour(markColour(contact));
        context.globalAlpha = likely ? 1 : 0.6;
        context.beginPath();
        if (contact.drawn) context.rect(x - 4, y - 4, 8, 8);
        else context.arc(x, y, likely ? 4.5 : 2.2, 0, 7);
        context.fill();
        if (likely) {
          context.lineWidth = 1.5;
          context.strokeStyle = colour("ground");
          context.stroke();
        }
      }
    }
    context.globalAlpha = 1;
    if (!current) return;
    for (const [line, ink] of [[5, colour("ground")], [2.5, colour("ink")]]) {
      context.lineWidth = line;
      context.strokeStyle = ink;
      context.beginPath();
      context.arc(...current, 10, 0, 7);
      context.stroke();
    }
  }

  function fit() {
    if (!home) return;
    const {width, height} = size();
    let [low, high] = [[Infinity, Infinity], [-Infinity, -Infinity]];
    const reach = (longitude, latitude) => {
      if (longitude === null || latitude === null) return;
      const at = [east(longitude), north(latitude)];
      for (const axis of [0, 1]) [low[axis], high[axis]] = [Math.min(low[axis], at[axis]), Math.max(high[axis], at[axis])];
    };
    if (track) track.latitude.forEach((latitude, index) => reach(track.longitude[index], latitude));
    for (const contact of shown) reach(contact.longitude, contact.latitude);
    for (const corners of strips.corners) for (const corner of corners) reach(...corner);
    if (low[0] > high[0]) return;
    view.east = (low[0] + high[0]) / 2, view.north = (low[1] + high[1]) / 2;
    view.scale = Math.min(20, 0.92 * Math.min(width / Math.max(high[0] - low[0], 40), height / Math.max(high[1] - low[1], 40)));
    wasFitted = true;
    redraw();
  }

  function bringIn(contact) {
    if (!home || !contact || contact.latitude === null) return;
    const {width, height} = size(), [x, y] = place(contact.longitude, contact.latitude, width, height);
    if (x < 20 || y < 20 || x > width - 20 || y > height - 20) [view.east, view.north, wasMoved] = [east(contact.longitude), north(contact.latitude), true];
  }

  function zoom(factor, x, y) {
    const {width, height} = size();
    const at = [x ?? width / 2, y ?? height / 2];
    const before = [(at[0] - width / 2) / view.scale, (at[1] - height / 2) / view.scale];
    view.scale = Math.min(100, Math.max(1e-4, view.scale * factor));
    wasMoved = true;
    view.east += before[0] - (at[0] - width / 2) / view.scale;
    view.north -= before[1] - (at[1] - height / 2) / view.scale;
    redraw();
  }

  function nearest(x, y) {
    const {width, height} = size();
    let best = null, closest = 12;
    for (const contact of shown) {
      if (contact.latitude === null) continue;
      const [cx, cy] = place(contact.longitude, contact.latitude, width, height);
      const distance = Math.hypot(cx - x, cy - y) - (contact.likely ? 4 : 0);
      if (distance < closest) [best, closest] = [contact, distance];
    }
    return best;
  }

  box.addEventListener("pointerdown", (event) => {
    box.focus();
    drag = {x: event.clientX, y: event.clientY, moved: false};
    try { box.setPointerCapture(event.pointerId); } catch { /* a pointer that is gone */ }
  });
  box.addEventListener("pointermove", (event) => {
    if (!drag || !(event.buttons & 1)) return;
    const [dx, dy] = [event.clientX - drag.x, event.clientY - drag.y];
    if (!drag.moved && Math.hypot(dx, dy) < 4) return;
    view.east -= dx / view.scale, view.north += dy / view.scale;
    drag = {x: event.clientX, y: event.clientY, moved: true};
    wasMoved = true;
    redraw();
  });
  box.addEventListener("pointerup", (event) => {
    if (drag && !drag.moved && home) {
      const {left, top} = size();
      const contact = nearest(event.clientX - left, event.clientY - top);
      if (contact) handlers.select(contact.key);
    }
    drag = null;
  });
  box.addEventListener("wheel", (event) => {
    event.preventDefault();
    const {left, top} = size();
    zoom(Math.exp(-event.deltaY / 400), event.clientX - left, event.clientY - top);
  }, {passive: false});
  box.addEventListener("keydown", (event) => {
    const moves = {ArrowUp: [0, 40], ArrowDown: [0, -40], ArrowLeft: [-40, 0], ArrowRight: [40, 0]};
    if (event.key in moves) view.east += moves[event.key][0] / view.scale, view.north += moves[event.key][1] / view.scale, redraw();
    else if (event.key === "+" || event.key === "=") zoom(1.4);
    else if (event.key === "-") zoom(1 / 1.4);
    else if (event.key === "0") fit();
    else return;
    event.preventDefault();
    event.stopPropagation();
  });
  byId("map-fit").addEventListener("click", () => { wasMoved = false; fit(); });
  for (const input of document.querySelectorAll("[data-layer]")) {
    input.addEventListener("change", () => {
      layers[input.dataset.layer] = input.checked;
      redraw();
    });
  }

  return {
    redraw, fit,
    setGrid(state) {
      if (grid && grid.provisional && !state.provisional) strips = {rows: [], corners: []};
      grid = state;
      moreStrips();
    },
    setTrack(found) { track = found; redraw(); },
    setLayers(found) { files = found; byId("clearance-layer").hidden = !found.clearance; redraw(); },
    setChart([west, south, east, north]) {
      const picture = new Image();
      picture.addEventListener("load", () => { chart = {picture, west, south, east, north}; byId("chart-layer").hidden = false; redraw(); });
      picture.src = "api/chart";
    },
    setStructures(found) { structures = found; },
    setContacts(contacts) { shown = contacts; redraw(); },
    select(key) { selected = key; bringIn(shown.find((one) => one.key === key)); redraw(); },
  };
}
