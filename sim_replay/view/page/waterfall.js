// The scrolling waterfall: metres along the track go up, ground range to port is left of the middle.

import {byId, colour, fitted, perFrame} from "./dom.js";
import {TILE} from "./tiles.js";
import {clock, niceStep} from "./words.js";

const MIN_SCALE = 0.002, MAX_SCALE = 200; // pixels of the screen per metre
const NEAR_PX = 14; // around a mark or a cross that a click belongs to
const SHOWN = "sea floor shown"; // the name of that moment in the browser's list of them

export function waterfallView(ground, slant, bottom, handlers) {
  const box = byId("waterfall-view"), picture = byId("waterfall-picture"), marks = byId("waterfall-marks");
  const view = {along: 0, across: 0, scale: 8};
  let grid = null, shown = [], selected = null, mode = "look", first = null, pointer = null, results = [];
  let times = null, showMarks = true, drag = null, wasFitted = false, isShown = false, tiles = ground;

  const redraw = perFrame(draw);
  const redrawMarks = perFrame(drawMarks);
  new ResizeObserver(redraw).observe(box);

  const size = () => box.getBoundingClientRect();
  const toX = (across, width) => width / 2 + (across - view.across) * view.scale;
  const toY = (along, height) => height / 2 - (along - view.along) * view.scale;
  function pointAt(x, y) {
    const {width, height} = size();
    return {
      along: view.along - (y - height / 2) / view.scale,
      across: view.across + (x - width / 2) / view.scale,
    };
  }
  const placed = (width, height) => (row, across) => [toX(across, width), toY(row * grid.row_m, height)];
  const asked = (point) => ({row: point.along / grid.row_m, across_m: point.across});

  function draw() {
    const {context, width, height} = fitted(picture);
    context.fillStyle = colour("ground");
    context.fillRect(0, 0, width, height);
    if (grid && grid.row_m && drawTiles(context, width, height) && !isShown) {
      isShown = true;
      requestAnimationFrame(() => performance.mark(SHOWN)); // the frame with it is on the screen
    }
    drawMarks();
  }

  function drawTiles(context, width, height) {
    const fine = 1 / (view.scale * grid.column_m);
    const level = Math.max(0, Math.min(12, Math.floor(Math.log2(fine) + 1e-9)));
    const rowM = grid.row_m * 2 ** level, columnM = grid.column_m * 2 ** level;
    const low = pointAt(0, height), high = pointAt(width, 0);
    const start = Math.max(0, Math.floor(low.along / rowM / TILE));
    const stop = Math.min(Math.ceil(high.along / rowM / TILE), Math.ceil(grid.stop_row / 2 ** level / TILE));
    const reach = Math.ceil(grid.columns / 2 ** level / TILE);
    const left = Math.max(-reach, Math.floor(low.across / columnM / TILE));
    const right = Math.min(reach, Math.ceil(high.across / columnM / TILE));
    context.imageSmoothingEnabled = columnM * view.scale < 3;
    const ratio = window.devicePixelRatio || 1;
    const snap = (value) => Math.round(value * ratio) / ratio;
    let nDrawn = 0;
    for (let row = start; row < stop; row++) {
      for (let column = left; column < right; column++) {
        const found = tiles.picture(level, row, column) && {tile: tiles.picture(level, row, column), part: null};
        const use = found || coarser(level, row, column);
        if (!use) continue;
        const x = snap(toX(column * TILE * columnM, width)), x2 = snap(toX((column + 1) * TILE * columnM, width));
        const y = snap(toY((row + 1) * TILE * rowM, height)), y2 = snap(toY(row * TILE * rowM, height));
        context.save();
        context.translate(x, y2);
        context.scale(1, -1); // the first row of a tile is the lowest
        const [sx, sy, side] = use.part || [0, 0, TILE];
        context.drawImage(use.tile, sx, sy, side, side, 0, 0, x2 - x, y2 - y);
        context.restore();
        nDrawn++;
      }
    }
    return nDrawn;
  }

  // A part of a coarser picture stands in until the right one has come.
  function coarser(level, row, column) {
    for (let up = 1; up <= 3; up++) {
      const factor = 2 ** up, above = [Math.floor(row / factor), Math.floor(column / factor)];
      const tile = tiles.peek(level + up, ...above);
      if (tile) {
        const side = TILE / factor;
        return {tile, part: [(column - above[1] * factor) * side, (row - above[0] * factor) * side, side]};
      }
    }
    return null;
  }

  function drawMarks() {
    const {context, width, height} = fitted(marks);
    context.clearRect(0, 0, width, height);
    if (!grid || !grid.row_m) return;
    context.font = `${colour("weight")} 12px system-ui, "DejaVu Sans", sans-serif`;
    drawScale(context, width, height);
    if (mode === "bottom") {
      const [low, high] = [pointAt(0, height), pointAt(0, 0)].map((point) => point.along / grid.row_m);
      bottom.draw(context, placed(width, height), low, high);
    } else if (showMarks) drawContacts(context, width, height);
    for (const result of results) drawLine(context, width, height, result.ends, result.text, colour("missed"));
    if (first) drawLine(context, width, height, [first, pointer || first], "", colour("missed"));
    if (mode !== "look") drawCross(context, width, height, pointer || {along: view.along, across: view.across});
  }

  function drawScale(context, width, height) {
    const ink = colour("ink"), ground = colour("ground");
    context.lineWidth = 1;
    const label = (text, x, y) => {
      context.lineWidth = 3;
      context.strokeStyle = ground;
      context.strokeText(text, x, y);
      context.fillStyle = ink;
      context.fillText(text, x, y);
      context.lineWidth = 1;
    };
    const step = niceStep(width / view.scale, 6), far = grid.columns * grid.column_m;
    for (let at = -Math.floor(far / step) * step; at <= far; at += step) {
      const x = toX(at, width);
      if (x < 0 || x > width - 20) continue;
      context.fillStyle = ink;
      context.fillRect(x, 0, 1, 6);
      label(at === 0 ? "0 m" : `${Math.abs(at)}`, x + 3, 14);
    }
    const rowStep = niceStep(height / view.scale, 6);
    const low = pointAt(0, height).along, high = pointAt(0, 0).along;
    for (let at = Math.ceil(Math.max(low, 0) / rowStep) * rowStep; at <= Math.min(high, grid.stop_row * grid.row_m); at += rowStep) {
      const y = toY(at, height);
      if (y < 24 || y > height - 4) continue;
      context.fillStyle = ink;
      context.fillRect(0, y, 6, 1);
      label(`${Math.round(at * 10) / 10} m ${timeAt(at / grid.row_m)}`, 9, y + 4);
    }
  }

  function timeAt(row) {
    if (!times || !times.row.length) return "";
    const index = Math.min(times.row.length - 1, Math.max(0, Math.round(row / (times.row[1] - times.row[0] || 1))));
    return clock(times.time[index]);
  }

  function drawContacts(context, width, height) {
    const low = pointAt(0, height), high = pointAt(width, 0);
    const busy = shown.length > 400 && view.scale < 4;
    for (const contact of shown) {
      if (contact.row === null || contact.across === null) continue;
      const along = contact.row * grid.row_m;
      if (along < low.along || along > high.along || contact.across < low.across || contact.across > high.across) continue;
      const isSelected = selected === contact.key;
      if (busy && !isSelected && !contact.likely && !contact.called && !contact.call) continue;
      const x = toX(contact.across, width), y = toY(along, height);
      const half = Math.max(7, 1.6 * view.scale);
      context.strokeStyle = "#000a";
      context.lineWidth = isSelected ? 5 : 3;
      context.strokeRect(x - half, y - half, 2 * half, 2 * half);
      context.strokeStyle = colour(markColour(contact));
      context.lineWidth = isSelected ? 3 : contact.likely ? 2 : 1;
      context.setLineDash(contact.drawn ? [5, 3] : []);
      context.strokeRect(x - half, y - half, 2 * half, 2 * half);
      context.setLineDash([]);
      if (isSelected || ((contact.likely || contact.called) && view.scale > 1.5)) {
        const text = contact.call ? `${contact.id} ${contact.call === "mine_like" ? "✔" : contact.call === "undecided" ? "?" : "✘"}` : contact.id;
        context.lineWidth = 3;
        context.strokeStyle = "#000c";
        context.strokeText(text, x + half + 3, y + 4);
        context.fillStyle = colour(markColour(contact));
        context.fillText(text, x + half + 3, y + 4);
      }
    }
  }

  function drawLine(context, width, height, ends, text, ink) {
    const [a, b] = ends.map((end) => [toX(end.across, width), toY(end.along, height)]);
    for (const [line, style] of [[4, "#000b"], [2, ink]]) {
      context.lineWidth = line;
      context.strokeStyle = style;
      context.beginPath();
      context.moveTo(...a);
      context.lineTo(...b);
      context.stroke();
      for (const [x, y] of [a, b]) context.strokeRect(x - 2.5, y - 2.5, 5, 5);
    }
    if (!text) return;
    const [x, y] = [Math.min(a[0], b[0]), Math.min(a[1], b[1]) - 10];
    context.lineWidth = 4;
    context.strokeStyle = "#000c";
    context.strokeText(text, x, y);
    context.fillStyle = colour("label");
    context.fillText(text, x, y);
  }

  function drawCross(context, width, height, point) {
    const x = toX(point.across, width), y = toY(point.along, height);
    context.lineWidth = 1;
    context.strokeStyle = colour("missed");
    context.beginPath();
    context.moveTo(x - 12, y), context.lineTo(x + 12, y), context.moveTo(x, y - 12), context.lineTo(x, y + 12);
    context.stroke();
  }

  function limit() {
    if (!grid || !grid.row_m) return;
    const far = grid.columns * grid.column_m;
    view.scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, view.scale));
    view.along = Math.min(grid.stop_row * grid.row_m, Math.max(grid.first_row * grid.row_m, view.along));
    view.across = Math.min(far, Math.max(-far, view.across));
  }

  function zoom(factor, x, y) {
    const {width, height} = size();
    const before = pointAt(x ?? width / 2, y ?? height / 2);
    view.scale *= factor;
    limit();
    const after = pointAt(x ?? width / 2, y ?? height / 2);
    view.along += before.along - after.along;
    view.across += before.across - after.across;
    limit();
    redraw();
  }

  function move(along, across) {
    view.along += along / view.scale;
    view.across += across / view.scale;
    limit();
    redraw();
  }

  function fit() {
    if (!grid || !grid.columns) return;
    const {width, height} = size();
    view.scale = (0.98 * width) / (2 * grid.columns * grid.column_m);
    view.across = 0;
    const length = (grid.stop_row - grid.first_row) * grid.row_m;
    if (length * view.scale < height) view.along = grid.first_row * grid.row_m + length / 2;
    else if (!wasFitted) view.along = grid.first_row * grid.row_m + (0.98 * height) / 2 / view.scale;
    wasFitted = true;
    limit();
    redraw();
  }

  function nearest(x, y) {
    const {width, height} = size();
    let best = null, closest = NEAR_PX;
    for (const contact of shown) {
      if (contact.row === null || contact.across === null) continue;
      const distance = Math.hypot(toX(contact.across, width) - x, toY(contact.row * grid.row_m, height) - y);
      const reach = Math.max(closest, 0);
      if (distance <= Math.max(reach, best ? 0 : 1.6 * view.scale) && (!best || distance < closest)) [best, closest] = [contact, distance];
    }
    return best;
  }

  async function click(point, x, y) {
    if (mode === "bottom") bottom.click(asked(point));
    else if (mode === "look") {
      const contact = showMarks ? nearest(x, y) : null;
      if (contact) handlers.select(contact.key);
    } else if (mode === "draw") {
      handlers.draw(asked(point));
    } else if (!first) {
      first = point;
      redrawMarks();
    } else {
      const ends = [first, point];
      first = null;
      handlers.measure(mode, ends.map(asked), ends);
    }
  }

  box.addEventListener("pointerdown", (event) => {
    box.focus();
    if (event.button !== 0) return;
    const {width, height} = size();
    const holds = mode === "bottom" && grid && grid.row_m && bottom.press(event.offsetX, event.offsetY, placed(width, height));
    drag = {x: event.offsetX, y: event.offsetY, moved: false, holds};
    try { box.setPointerCapture(event.pointerId); } catch { /* a pointer that is gone */ }
  });
  box.addEventListener("pointermove", (event) => {
    const {left, top} = size();
    const x = event.clientX - left, y = event.clientY - top;
    if (drag && (event.buttons & 1)) {
      const [dx, dy] = [x - drag.x, y - drag.y];
      if (drag.moved || Math.hypot(dx, dy) > 4) {
        drag.moved = true;
        if (drag.holds) bottom.drag(asked(pointAt(x, y)));
        else {
          handlers.moved();
          move(dy, -dx);
          [drag.x, drag.y] = [x, y];
        }
      }
    }
    pointer = pointAt(x, y);
    handlers.cursor(grid && grid.row_m ? asked(pointer) : null);
    if (mode !== "look") redrawMarks();
  });
  box.addEventListener("pointerup", (event) => {
    const {left, top} = size();
    const x = event.clientX - left, y = event.clientY - top;
    if (drag && !drag.moved && !drag.holds && grid && grid.row_m) click(pointAt(x, y), x, y);
    if (drag && drag.holds) bottom.release();
    drag = null;
  });
  box.addEventListener("pointerleave", () => {
    pointer = null;
    handlers.cursor(null);
  });
  box.addEventListener("wheel", (event) => {
    event.preventDefault();
    const {left, top} = size();
    if (event.shiftKey) {
      handlers.moved();
      move(-event.deltaY, 0);
    } else zoom(Math.exp(-event.deltaY / 400), event.clientX - left, event.clientY - top);
  }, {passive: false});
  box.addEventListener("keydown", (event) => {
    const {width, height} = size();
    const step = mode === "look" ? 60 : event.shiftKey ? 20 : 1;
    const moves = {
      ArrowUp: [step, 0], ArrowDown: [-step, 0], ArrowLeft: [0, -step], ArrowRight: [0, step],
      PageUp: [0.8 * height, 0], PageDown: [-0.8 * height, 0],
    };
    if (event.key in moves) {
      if (mode === "look" || event.key.startsWith("Page")) {
        handlers.moved();
        move(...moves[event.key]);
      } else { // arrows move the cross
        pointer ||= {along: view.along, across: view.across};
        pointer = {along: pointer.along + moves[event.key][0] / view.scale, across: pointer.across + moves[event.key][1] / view.scale};
        handlers.cursor(asked(pointer));
        redrawMarks();
      }
    } else if (event.key === "+" || event.key === "=") zoom(1.4);
    else if (event.key === "-") zoom(1 / 1.4);
    else if (event.key === "0") fit();
    else if (event.key === "Enter" && mode !== "look") click(pointer || {along: view.along, across: view.across}, width / 2, height / 2);
    else return;
    event.preventDefault();
    event.stopPropagation();
  });

  return {
    redraw, redrawMarks, zoom, fit,
    setGrid(state) { grid = state; limit(); },
    setTimes(track) { times = track; },
    setContacts(contacts) { shown = contacts; redrawMarks(); },
    select(key) { selected = key; results = []; redrawMarks(); },
    setMarks(on) { showMarks = on; redrawMarks(); },
    setMode(name) {
      mode = name;
      first = null;
      tiles = name === "bottom" ? slant : ground;
      box.classList.toggle("measuring", name !== "look");
      redraw();
    },
    addResult(result) { results = [...results.filter((held) => held.mode !== result.mode), result]; redrawMarks(); },
    goTo(row, across, scale) {
      view.along = row * grid.row_m;
      view.across = across;
      view.scale = Math.max(view.scale, scale);
      limit();
      redraw();
    },
    toNewest() {
      if (!grid || !grid.row_m) return;
      view.along = grid.stop_row * grid.row_m - (0.5 * size().height) / view.scale + 4;
      redraw();
    },
    get mode() { return mode; },
    view, // for tests
    screenOf: (row, across) => {
      const {left, top, width, height} = size();
      return {x: left + toX(across, width), y: top + toY(row * grid.row_m, height)};
    },
  };
}

export const markColour = (contact) =>
  contact.drawn ? "missed" : contact.call === "mine_like" ? "mine" : contact.call === "not_mine_like" ? "judged"
    : contact.likely ? "mine" : "clutter";
