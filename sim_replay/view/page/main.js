// Put the page together: what the server knows, three views of it, and what people do.

import {get, post} from "./api.js";
import {bottomEditor} from "./bottom.js";
import {contactCard} from "./card.js";
import {ask, byId, element, message} from "./dom.js";
import {mapView} from "./map.js";
import {NAMES, OF_THEME, table as colourTable} from "./palettes.js";
import {contactTable} from "./table.js";
import {tileStore} from "./tiles.js";
import {waterfallView} from "./waterfall.js";
import {clock, metres, position} from "./words.js";

const POLL_MS = 1000, FIRST_POLL_MS = 50, FIRST_S = 10; // oftener until there is a first picture, at first
const ALONE_MS = 1500; // from the start of the page: until then nothing else is asked for before the first picture
const THEMES = ["day", "dusk", "night"];
const CLOSE_SCALE = 25; // pixels per metre at which a chosen contact is shown: an object of 2 m is 50 pixels

let state = {}, contacts = [], selected = null, details = null, follows = false, wasFitted = false;
let wanted = null; // the chosen contact, as long as its pings are not made yet

let mapWaits = 0;
const tiles = tileStore("tile", () => {
  waterfall.redraw();
  mapWaits ||= setTimeout(() => { // with all that has come within a quarter of a second
    mapWaits = 0;
    map.redraw();
  }, 250);
});
const slant = tileStore("slant", () => waterfall.redraw());
const bottom = bottomEditor(() => waterfall.redrawMarks());
const waterfall = waterfallView(tiles, slant, bottom, {select, measure, draw: drawMissed, cursor: showCursor, moved: () => setFollow(false)});
const map = mapView(tiles, {select});
const list = contactTable({select, shown: (rows) => { waterfall.setContacts(rows); map.setContacts(rows); }});
const card = contactCard({judge, goTo, close: () => select(null)});

function look() {
  const theme = document.documentElement.dataset.theme;
  const colours = colourTable(byId("palette").value, Number(byId("gain").value), Number(byId("contrast").value), theme);
  tiles.recolour(colours);
  slant.recolour(colours);
  waterfall.redraw();
  map.redraw();
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  byId("theme").value = name;
  byId("palette").value = OF_THEME[name];
  localStorage.setItem("theme", name);
  look();
}

function setFollow(on) {
  follows = on;
  byId("follow").checked = on;
  if (on) waterfall.toNewest();
}

async function poll() {
  try {
    const now = await get("api/state"), before = state;
    if (before.generation !== undefined && now.generation !== before.generation) return location.reload();
    state = now;
    byId("replay-again").hidden = !now.replay_again;
    byId("name").textContent = document.title = now.name;
    byId("live").hidden = !now.live;
    byId("live").textContent = now.silent ? "no news: its service does not run, or hangs" : "live";
    const made = now.stop_row * now.row_m;
    byId("progress").textContent = now.done ? `${now.pings} pings, ${metres(made, 0)}` : now.live
      ? `${now.pings} pings, ${metres(made, 0)} so far` : `waterfall ${Math.floor(100 * now.fraction)} %`;
    const searched = now.replay === null ? "" : now.replay_problem ? ` · no contacts: ${now.replay_problem}`
      : now.replay_done ? ` · ${contacts.length} contacts` : ` · looking for contacts: ${Math.floor(100 * now.replay)} %`;
    byId("progress").textContent += searched + (now.provisional ? " · provisional picture of the first pings" : "");
    showNote();
    if (!now.stop_row && !now.done && performance.now() < ALONE_MS) {
      state = before;
      setTimeout(poll, FIRST_POLL_MS);
      return undefined;
    }
    byId("judged").textContent = now.judged;
    byId("judged").hidden = !now.verdicts;
    if (now.stop_row !== before.stop_row || now.columns !== before.columns || now.provisional !== before.provisional) {
      tiles.outdate();
      slant.outdate();
      waterfall.setGrid(now);
      map.setGrid(now);
      if (now.columns && !wasFitted) {
        wasFitted = true;
        waterfall.fit();
        if (now.live) setFollow(true);
      }
      if (follows) waterfall.toNewest();
      waterfall.redraw(); // asks for tiles before anything else is waited for
      const track = await get("api/track");
      waterfall.setTimes(track);
      map.setTrack(track);
      if (waterfall.mode === "bottom") bottom.load(await get("api/bottom"));
      waterfall.redraw();
    }
    if (now.chart && !before.chart) map.setChart(now.chart);
    if (now.done && !before.done && !now.stop_row) map.setTrack(await get("api/track"));
    if (now.done !== before.done || now.live !== before.live || (now.live && now.stop_row !== before.stop_row)) map.setLayers(await get("api/layers"));
    if (now.contacts_version !== before.contacts_version || now.verdicts_version !== before.verdicts_version
      || now.stop_row !== before.stop_row) await loadContacts();
    byId("message").hidden ||= byId("message").dataset.lost === "yes";
    byId("message").dataset.lost = "";
  } catch (error) {
    byId("message").dataset.lost = "yes";
    message(new Error(`the server does not answer: ${error.message}`));
  }
  setTimeout(poll, state.stop_row || state.done || performance.now() > 1000 * FIRST_S ? POLL_MS : FIRST_POLL_MS);
  return undefined;
}

// What stands over the waterfall: why there is none, or that the chosen contact is not in what is shown.
function showNote() {
  const note = byId("waterfall-note"), now = state, contact = wanted && find(wanted);
  const absent = !contact ? "" : now.done ? `${contact.id} is not in this waterfall`
    : `${contact.id} is not made yet: ${Math.floor(100 * now.fraction)} %. It is shown when it is there`;
  note.textContent = now.problem || absent || (now.stop_row ? "" : now.live ? "waiting for pings" : "the waterfall is being made");
  note.hidden = !note.textContent;
}

// The chosen contact, shown where it lies; as soon as it is there, if that is later.
function seek(key) {
  const contact = key && find(key);
  wanted = contact && (contact.row === null || contact.across === null) && !contact.drawn ? key : null;
  if (contact && !wanted) goTo(contact.row, contact.across);
  showNote();
}

async function loadContacts() {
  const found = await get("api/contacts");
  const none = {call: "", type: "", comment: "", by: "", object: "", length_m: null, width_m: null, height_m: null, shadow_length_m: null};
  const structures = Object.fromEntries(found.structures.map((one) => [one.id, one]));
  contacts = found.id.map((id, index) => ({
    key: id, id, drawn: false, latitude: found.latitude[index], longitude: found.longitude[index], p: found.p[index],
    percent: found.percent[index], label: found.label[index], called: found.called[index], time: found.time[index], row: found.row[index], across: found.across[index],
    likely: found.p[index] >= state.mine_like_p, structure: structures[found.structure[index]] || null,
    ...none, ...judgedPart(found.verdicts[id]),
  }));
  contacts.push(...found.drawn.map((one) => ({
    key: one.object, id: one.object, drawn: true, latitude: one.latitude, longitude: one.longitude, p: null, percent: "",
    label: one.drawn ? "drawn" : "judged before", called: null, time: null, row: one.row, across: one.across, structure: null,
    likely: one.call === "mine_like", ...none, ...judgedPart(one), time_judged: one.time,
  })));
  map.setStructures(found.structures);
  list.setContacts(contacts);
  if (wanted && find(wanted) && find(wanted).row !== null) seek(wanted);
  if (selected) showCard();
  else takeDraft();
}

// What was not saved when the page was loaded again, as after a replay, goes to what lies at the same place now.
let isDraftAsked = false;
async function takeDraft() {
  const draft = JSON.parse(sessionStorage.getItem("draft") || "null");
  if (!draft || isDraftAsked) return;
  const north = Math.PI * 6371000 / 180, east = north * Math.cos(draft.latitude * Math.PI / 180);
  const away = (one) => Math.hypot((one.latitude - draft.latitude) * north, (one.longitude - draft.longitude) * east);
  const near = contacts.filter((one) => away(one) <= state.near_m).sort((a, b) => away(a) - away(b))[0];
  if (near) {
    sessionStorage.removeItem("draft");
    select(near.key);
    card.take(draft);
  } else if (state.replay_done) {
    isDraftAsked = true;
    if (await ask(`This was not saved, and no contact lies there any more: ${draft.type} ${draft.comment}. Forget it?`)) sessionStorage.removeItem("draft");
  }
}
addEventListener("pagehide", () => { if (card.draft) sessionStorage.setItem("draft", JSON.stringify(card.draft)); });

const judgedPart = (verdict) => (verdict ? {
  call: verdict.call, type: verdict.type, comment: verdict.comment, by: verdict.by, object: verdict.object,
  length_m: verdict.length_m, width_m: verdict.width_m, height_m: verdict.height_m, shadow_length_m: verdict.shadow_length_m,
} : {});

const find = (key) => contacts.find((one) => one.key === key);

async function select(key) {
  selected = key;
  details = null;
  waterfall.select(key);
  map.select(key);
  list.select(key);
  const contact = key && find(key);
  showCard();
  if (contact && matchMedia("(max-width: 900px)").matches) byId("card").scrollIntoView();
  seek(key);
  if (!contact) return;
  await loadDetails(key);
}

async function loadDetails(key) {
  const contact = find(key);
  if (!contact || contact.drawn) return;
  try {
    const found = await get(`api/contacts/${encodeURIComponent(key)}`);
    if (selected !== key) return;
    details = found;
    showCard();
  } catch (error) {
    message(error);
  }
}

function showCard() {
  const contact = selected && find(selected);
  card.show(contact || null, details, state);
  waterfall.redraw();
}

function goTo(row, across) {
  if (row === null || across === null) return;
  setFollow(false);
  waterfall.goTo(row, across, CLOSE_SCALE);
}

async function judge(judgement) {
  const chosen = selected;
  try {
    if (wanted && judgement.contact_id === wanted && !await ask(`The waterfall does not show ${wanted} yet. Judge it all the same?`)) return;
    const verdict = await post("api/verdicts", {...judgement, generation: state.generation});
    await loadContacts();
    if (selected !== chosen) return; // another one was chosen meanwhile: it stays so
    if (!judgement.contact_id && !verdict.withdrawn) await select(find(verdict.object) ? verdict.object : selected);
    else if (!find(selected)) await select(null);
    else await loadDetails(selected);
  } catch (error) {
    message(error);
  }
}

async function measure(mode, ends, drawn) {
  try {
    const chosen = card.current, key = chosen && !chosen.drawn ? chosen.id : "";
    const found = await post("api/measure", {quantity: mode, ends: ends.map((end) => [end.row, end.across_m]), contact_id: key});
    const size = mode === "shadow" ? {shadow_length_m: found.length_m, height_m: found.height_m} : {[`${mode}_m`]: found.length_m};
    const says = mode === "shadow" ? `shadow ${metres(found.length_m, 2)}, height ${metres(found.height_m, 2)}` : `${mode} ${metres(found.length_m, 2)}`;
    waterfall.addResult({mode, ends: drawn, text: says});
    if (found.length_m === null || (mode === "shadow" && !(found.height_m > 0))) return message("no size: click the object's far side, then the shadow's end, on one side of the track");
    if (key && !(found.distance_m <= state.near_m)) {
      const where = found.distance_m === null ? `the waterfall does not show ${key} yet` : `this was measured ${metres(found.distance_m, 0)} from ${key}`;
      if (!await ask(`${where[0].toUpperCase()}${where.slice(1)}. Keep it with ${key} all the same?`)) return undefined;
    }
    if (chosen && card.current && card.current.key === chosen.key) card.addMeasured(size);
    else message("measured; choose a contact to keep it with a verdict");
  } catch (error) {
    message(error);
  }
  return undefined;
}

async function saveBottom() {
  try {
    const {files} = await post("api/bottom", {stretches: bottom.stretches});
    bottom.saved();
    bottom.load(await get("api/bottom"));
    const again = state.replay_again ? "press 'replay again' to use it" : "the next replay uses it";
    message(files.length ? `kept in ${files.join(", ")}; ${again}` : "nothing to keep");
  } catch (error) {
    message(error);
  }
}

async function replayAgain() {
  try {
    if (bottom.isChanged && !await ask("Points of the bottom line are not saved. Replay without them?")) return;
    await post("api/replay", {});
    location.reload();
  } catch (error) {
    message(error);
  }
}

async function drawMissed(point) {
  setMode("look");
  await judge({row: point.row, across_m: point.across_m, call: "mine_like"});
}

function setMode(mode) {
  for (const button of document.querySelectorAll("[data-mode]")) button.setAttribute("aria-pressed", String(button.dataset.mode === mode));
  waterfall.setMode(mode);
  byId("bottom-tools").hidden = mode !== "bottom";
  if (mode !== "look") byId("waterfall-view").focus();
  if (mode === "bottom") get("api/bottom").then((found) => { bottom.load(found); waterfall.redraw(); }, message);
}

let cursorAsked = null, cursorBusy = false;
async function showCursor(point) {
  cursorAsked = point;
  if (cursorBusy) return;
  cursorBusy = true;
  while (cursorAsked) {
    const asked = cursorAsked;
    cursorAsked = null;
    if (waterfall.mode === "bottom") {
      byId("cursor").textContent = `slant range ${metres(Math.abs(asked.across_m), 2)} ${asked.across_m < 0 ? "port" : "starboard"}`;
      continue;
    }
    try {
      const found = await post("api/place", {points: [[asked.row, asked.across_m]]});
      const range = `${metres(Math.abs(asked.across_m))} ${asked.across_m < 0 ? "port" : "starboard"}`;
      byId("cursor").textContent = `${position(found.latitude_deg[0], found.longitude_deg[0])}   range ${range} (slant ${metres(found.slant_range_m[0])})   `
        + `depth ${metres(found.depth_m[0])}   altitude ${metres(found.altitude_m[0])}   ${clock(found.time_s[0])}${found.stale[0] ? "   position doubtful" : ""}`;
    } catch { /* the next poll says that the server is away */ }
  }
  cursorBusy = false;
}

document.addEventListener("keydown", (event) => {
  const typing = event.target.closest("input:not([type=range]):not([type=checkbox]), textarea, select");
  if (event.key === "Escape") {
    if (typing) event.target.blur();
    else if (document.querySelector('[data-mode="look"]').getAttribute("aria-pressed") === "false") setMode("look");
    else if (!byId("help").open && !byId("ask").open) select(null);
    return;
  }
  if (typing || byId("help").open || byId("ask").open || event.ctrlKey || event.altKey || event.metaKey) return;
  const keys = {
    j: () => list.step(1), k: () => list.step(-1),
    m: () => card.judge("mine_like"), n: () => card.judge("not_mine_like"), u: () => card.judge("undecided"),
    c: () => byId("comment") && byId("comment").focus(),
    l: () => setMode("length"), w: () => setMode("width"), s: () => setMode("shadow"), d: () => setMode("draw"), b: () => setMode("bottom"),
    "/": () => byId("search").focus(), f: () => setFollow(!follows), "?": () => byId("help").showModal(),
    t: () => setTheme(THEMES[(THEMES.indexOf(document.documentElement.dataset.theme) + 1) % THEMES.length]),
    0: () => waterfall.fit(), "+": () => waterfall.zoom(1.4), "-": () => waterfall.zoom(1 / 1.4),
  };
  if (!(event.key in keys)) return;
  event.preventDefault();
  keys[event.key]();
});

byId("palette").append(...NAMES.map((name) => element("option", {value: name}, name)));
for (const id of ["gain", "contrast", "palette"]) byId(id).addEventListener("input", look);
byId("theme").addEventListener("change", () => setTheme(byId("theme").value));
byId("marks").addEventListener("change", () => waterfall.setMarks(byId("marks").checked));
byId("follow").addEventListener("change", () => setFollow(byId("follow").checked));
byId("zoom-in").addEventListener("click", () => waterfall.zoom(1.4));
byId("zoom-out").addEventListener("click", () => waterfall.zoom(1 / 1.4));
byId("fit").addEventListener("click", () => waterfall.fit());
byId("report").addEventListener("click", async () => {
  try {
    const drawn = await post("api/report", {});
    message(new Error(`drawn with ${drawn.verdicts} verdicts: ${drawn.path}`));
  } catch (error) {
    message(error);
  }
});
byId("bottom-save").addEventListener("click", saveBottom);
byId("bottom-undo").addEventListener("click", () => bottom.undo());
byId("bottom-next").addEventListener("click", () => bottom.next());
byId("bottom-clear").addEventListener("click", () => bottom.clear());
byId("replay-again").addEventListener("click", replayAgain);
byId("help-button").addEventListener("click", () => byId("help").showModal());
for (const button of document.querySelectorAll("[data-mode]")) button.addEventListener("click", () => setMode(button.dataset.mode));
setTheme(THEMES.includes(localStorage.getItem("theme")) ? localStorage.getItem("theme") : "dusk");
poll();

// What a test asks of the page.
window.bench = {
  get state() { return state; }, get contacts() { return contacts; }, get selected() { return selected; },
  get busy() { return tiles.busy || slant.busy; }, tiles, bottom, redraw: waterfall.redraw, screenOf: waterfall.screenOf, view: waterfall.view,
};
