// The table of contacts: any number of rows, of which only those in sight are elements.

import {byId, element} from "./dom.js";
import {CALLS, clock, plain} from "./words.js";

const ROW_PX = 24, SPARE = 8; // height of a row, and rows kept above and below what is in sight
const COLUMNS = [
  ["id", "contact", (one) => one.id],
  ["p", "mine", (one) => (one.p === null ? -1 : one.p)],
  ["label", "kind", (one) => one.label],
  ["call", "verdict", (one) => one.call || ""],
  ["time", "time, type, comment", (one) => one.time || 0],
];
const SHOWN = {
  all: () => true,
  likely: (one) => one.likely,
  called: (one) => one.called === true,
  open: (one) => !one.call,
  judged: (one) => Boolean(one.call),
  missed: (one) => one.drawn,
};

export function contactTable(handlers) {
  const box = byId("table");
  const head = element("div", {className: "head", role: "row"});
  const body = element("div", {role: "rowgroup"});
  body.style.position = "relative";
  box.append(head, body);
  let all = [], rows = [], selected = null, sorted = "p", down = true;

  for (const [name, title] of COLUMNS) {
    head.append(element("button", {role: "columnheader", onclick: () => {
      [sorted, down] = [name, sorted === name ? !down : name === "p"];
      arrange();
    }}, title));
  }

  function arrange() {
    const wanted = SHOWN[byId("show").value], words = byId("search").value.toLowerCase().split(/\s+/).filter(Boolean);
    const text = (one) => `${one.id} ${one.label} ${one.call ? CALLS[one.call] : ""} ${one.type} ${one.comment} ${one.by} ${one.structure ? one.structure.id : ""}`.toLowerCase();
    rows = all.filter((one) => wanted(one) && (!words.length || words.every((word) => text(one).includes(word))));
    const value = COLUMNS.find(([name]) => name === sorted)[2], sign = down ? -1 : 1;
    rows.sort((a, b) => {
      const [first, second] = [value(a), value(b)];
      return first < second ? -sign : first > second ? sign : a.id < b.id ? -1 : 1;
    });
    [...head.children].forEach((button, index) => {
      const isSorted = COLUMNS[index][0] === sorted;
      button.setAttribute("aria-sort", isSorted ? (down ? "descending" : "ascending") : "none");
      button.textContent = COLUMNS[index][1] + (isSorted ? (down ? " ▾" : " ▴") : "");
    });
    byId("count").textContent = `${rows.length} of ${all.length}`;
    box.setAttribute("aria-rowcount", rows.length + 1);
    body.style.height = `${rows.length * ROW_PX}px`;
    draw();
    handlers.shown(rows);
  }

  function draw() {
    const top = Math.max(0, Math.floor(box.scrollTop / ROW_PX) - SPARE);
    const stop = Math.min(rows.length, top + Math.ceil(box.clientHeight / ROW_PX) + 2 * SPARE);
    body.replaceChildren(...rows.slice(top, stop).map((one, index) => row(one, top + index)));
  }

  function row(one, index) {
    const kind = one.call === "mine_like" ? "mine" : one.call === "not_mine_like" ? "not" : "soft";
    const made = element("div", {
      className: "row", role: "row", "aria-rowindex": index + 2, "aria-selected": String(one.key === selected),
      onclick: () => handlers.select(one.key),
    },
    cell(one.id, one.drawn ? "missed" : ""), cell(one.percent || "–", one.likely ? "mine" : "soft"),
    cell(one.label + (one.structure ? ` · ${one.structure.id}` : "")), cell(one.call ? CALLS[one.call] : "", kind),
    cell([clock(one.time), plain(one.type), one.comment].filter(Boolean).join("  "), "soft"));
    made.style.top = `${index * ROW_PX}px`;
    return made;
  }

  const cell = (text, className = "") => element("span", {role: "gridcell", className, title: text}, text);

  function reveal() {
    const index = rows.findIndex((one) => one.key === selected);
    if (index < 0) return;
    const top = index * ROW_PX, seen = box.clientHeight - 2 * ROW_PX;
    if (top < box.scrollTop || top > box.scrollTop + seen) box.scrollTop = top - seen / 2;
    draw();
  }

  function step(by) {
    if (!rows.length) return;
    const index = rows.findIndex((one) => one.key === selected);
    handlers.select(rows[Math.min(rows.length - 1, Math.max(0, index < 0 ? 0 : index + by))].key);
  }

  box.addEventListener("scroll", draw);
  new ResizeObserver(draw).observe(box);
  byId("show").addEventListener("change", arrange);
  byId("search").addEventListener("input", arrange);
  box.addEventListener("keydown", (event) => {
    if (event.target.closest("button")) return;
    const page = Math.max(1, Math.floor(box.clientHeight / ROW_PX) - 2);
    const steps = {ArrowDown: 1, ArrowUp: -1, PageDown: page, PageUp: -page, Home: -rows.length, End: rows.length};
    if (!(event.key in steps)) return;
    event.preventDefault();
    step(steps[event.key]);
  });

  return {
    setContacts(contacts) { all = contacts; arrange(); },
    select(key) { selected = key; reveal(); draw(); },
    step,
  };
}
