// Correct the first bottom return: points over the water column, in stretches between which the line is tracked.

import {colour} from "./dom.js";

const REACH_PX = 9; // around a point that a press takes hold of it

export function bottomEditor(changed) {
  let tracked = {row: [], first_return: []}, stretches = [], current = null, held = null;
  let added = []; // what can be undone: points put in, dragged from where they were, or all cleared

  const spans = (stretch, row) => stretch.length > 1 && stretch[0].row <= row && row <= stretch.at(-1).row;

  function lay(stretch, point) {
    stretch.push(point);
    stretch.sort((a, b) => a.row - b.row);
  }

  // Both sides see the same bottom: a line is drawn to port and to starboard.
  function stroke(context, points, place, ink, wide) {
    for (const side of [-1, 1]) {
      context.beginPath();
      let down = false;
      for (const {row, range} of points) {
        if (range === null) {
          down = false;
          continue;
        }
        const [x, y] = place(row, side * range);
        down ? context.lineTo(x, y) : context.moveTo(x, y);
        down = true;
      }
      for (const [width, style] of [[wide + 2, "#000a"], [wide, ink]]) {
        context.lineWidth = width;
        context.strokeStyle = style;
        context.stroke();
      }
    }
  }

  return {
    // What the server knows; points that are not saved yet stay.
    load(found) {
      tracked = found;
      if (added.length) return;
      stretches = found.stretches.map((stretch) => stretch.map(([row, range]) => ({row, range})));
      current = null;
    },
    draw(context, place, low, high) {
      const {row, first_return} = tracked;
      const first = Math.max(0, row.findIndex((one) => one >= low) - 1), after = row.findIndex((one) => one > high);
      const seen = row.slice(first, after < 0 ? row.length : after + 1);
      stroke(context, seen.map((one, index) => ({row: one, range: first_return[first + index]})), place, colour("accent"), 1);
      for (const stretch of stretches) {
        stroke(context, stretch, place, colour("missed"), 2);
        context.fillStyle = stretch === current ? colour("missed") : colour("ink");
        for (const {row: at, range} of stretch) {
          for (const side of [-1, 1]) {
            const [x, y] = place(at, side * range);
            context.fillRect(x - 3.5, y - 3.5, 7, 7);
          }
        }
      }
    },
    // Take hold of a point that lies within reach; whether there is one.
    press(x, y, place) {
      held = null;
      let closest = REACH_PX;
      for (const stretch of stretches) {
        for (const point of stretch) {
          for (const side of [-1, 1]) {
            const [px, py] = place(point.row, side * point.range), distance = Math.hypot(px - x, py - y);
            if (distance < closest) [held, closest] = [{stretch, point}, distance];
          }
        }
      }
      return held !== null;
    },
    drag({row, across_m}) {
      if (!held.was) added.push(Object.assign(held, {was: {...held.point}}));
      const index = held.stretch.indexOf(held.point), [before, after] = [held.stretch[index - 1], held.stretch[index + 1]];
      if ((!before || row > before.row) && (!after || row < after.row)) held.point.row = row;
      held.point.range = Math.max(0.05, Math.abs(across_m));
      changed();
    },
    release() { held = null; },
    click({row, across_m}) {
      const point = {row, range: Math.max(0.05, Math.abs(across_m))};
      const stretch = stretches.find((one) => spans(one, row)) || current || [];
      if (!stretches.includes(stretch)) stretches.push(stretch);
      lay(stretch, point);
      current = stretch;
      added.push({stretch, point});
      changed();
    },
    undo() {
      const last = added.pop();
      if (last && last.was) {
        Object.assign(last.point, last.was);
      } else if (last && last.cleared) {
        stretches = last.cleared;
      } else if (last) {
        last.stretch.splice(last.stretch.indexOf(last.point), 1);
        stretches = stretches.filter((one) => one.length);
        if (!stretches.includes(current)) current = null;
      }
      changed();
    },
    next() { current = null; changed(); },
    clear() {
      added.push({cleared: stretches});
      stretches = [];
      current = null;
      changed();
    },
    reset() { added = []; stretches = []; current = null; changed(); },
    // The first return that was tracked, m of slant range, nearest to a row.
    returnAt(row) {
      const index = tracked.row.findIndex((one) => one >= row);
      return tracked.first_return[index < 0 ? tracked.row.length - 1 : index];
    },
    saved() { added = []; current = null; changed(); },
    get stretches() { return stretches.map((stretch) => stretch.map(({row, range}) => [row, range])); },
    get isChanged() { return added.length > 0; },
  };
}
