// The card of one contact: what the chain found, and what people say about it.

import {byId, element} from "./dom.js";
import {CALLS, metres, plain, position} from "./words.js";

const TYPES = ["mine", "cylinder", "sphere", "truncated cone", "wedge", "rock", "tyre", "debris", "wreck", "trap", "natural"];
const SIZES = {length_m: "length", width_m: "width", height_m: "height", shadow_length_m: "shadow"};

export function contactCard(handlers) {
  const box = byId("card");
  let shown = null, measured = {};  // what was measured by hand since the card opened: a list for each size
  let drawn = "", isPressed = false, waiting = null;

  // A button that is replaced between press and release is not clicked: the card is drawn anew after it.
  box.addEventListener("pointerdown", () => { isPressed = true; });
  const release = () => setTimeout(() => { // after the click
    isPressed = false;
    const last = waiting;
    waiting = null;
    if (last) show(...last);
  });
  window.addEventListener("pointerup", release);
  window.addEventListener("pointercancel", release);

  const text = (value) => (value === null || value === undefined ? "?" : String(value));
  const row = (name, value) => [element("dt", {}, name), element("dd", {}, value)];
  const withError = (size, sigma) => metres(size, 2) + (sigma ? ` ± ${sigma.toFixed(2)}` : "");

  function statistics(details, contact) {
    const rows = [];
    if (contact.structure) {
      const {id, length_m, width_m, n_contacts, n_called} = contact.structure;
      rows.push(...row("part of", `structure ${id}: ${metres(length_m)} × ${metres(width_m)}, ${n_contacts} contacts, ${n_called} called`));
    }
    if (details) {
      const low = details.false_alarms_95_per_km2 || [];
      rows.push(
        ...row("p_mine", text(details.p_mine)),
        ...row("error", `${metres(details.sigma_m, 1)} (1 σ)`),
        ...row("size found", [["length_m", "length_sigma_m"], ["width_m", "width_sigma_m"], ["height_m", "height_sigma_m"]]
          .map(([size, sigma]) => withError(details[size], details[sigma])).join(" × ")),
        ...row("seen", `${text(details.side)} ${metres(details.ground_range_m)} · looking towards ${(details.aspects_deg || []).map((aspect) => `${Math.round(aspect) % 360}°`).join(", ")}`),
        ...row("called", details.called === null || details.called === undefined ? "not decided" : details.called ? "yes" : "no"),
        ...row("false alarms", details.false_alarms_per_km2 === null || details.false_alarms_per_km2 === undefined ? "?"
          : `${Math.round(details.false_alarms_per_km2)} per km² expected to look as mine-like${low.length === 2 && low[0] !== null ? ` (${Math.round(low[0])} to ${Math.round(low[1])})` : ""}`),
      );
    }
    return [element("dl", {}, ...rows), ...(details ? [element("h3", {}, "belief"), beliefs(details), ...evidence(details)] : [])];
  }

  function beliefs(details) {
    const open = details.said.open_share, belief = {...details.belief};
    const parts = Object.entries(belief).map(([name, share]) => [plain(name), name === "unknown" ? share - open : share]);
    parts.push(["mine, kind open", open]);
    return element("dl", {}, ...parts.filter(([, share]) => share >= 0.005).sort((a, b) => b[1] - a[1]).flatMap(([name, share]) => [
      element("dt", {}, `${name} ${Math.round(100 * share)} %`), element("dd", {}, bar(share)),
    ]));
  }

  function bar(share) {
    const filled = element("span");
    filled.style.width = `${100 * share}%`;
    return element("div", {className: "bar"}, filled);
  }

  function evidence(details) {
    return [
      element("h3", {}, "evidence of each view"),
      element("ul", {}, ...(details.views || []).map((view, index) => element("li", {},
        element("button", {onclick: () => handlers.goTo(details.view_rows[index], view.side === "port" ? -view.ground_range_m : view.ground_range_m)}, `view ${index + 1}`),
        ` ${text(view.side)}, ${metres(view.ground_range_m)}, p ${text(view.p_mine)}: ${(view.reasons || []).map(plain).join(", ")}`))),
    ];
  }

  // What a watch officer reads: a sentence, how likely, one reason for and one against, and where it is.
  function front(details, contact) {
    const said = details && details.said;
    const reason = (name, words) => (words ? element("li", {className: name}, element("b", {}, `${name}: `), words) : null);
    return element("div", {},
      said ? element("p", {id: "says"}, said.sentence) : null,
      said && contact.p !== null ? bar(contact.p) : null,
      said ? element("ul", {className: "reasons"}, reason("for", said.reason_for), reason("against", said.reason_against)) : null,
      element("p", {className: "where"}, position(contact.latitude, contact.longitude) + (details && details.depth_m !== null ? `, ${metres(details.depth_m)} deep` : "")),
      ...history(details, contact));
  }

  function history(details, contact) {
    const lines = (details ? details.history : null) || (contact.by ? [contact] : []);
    if (!lines.length) return [];
    return [element("h3", {}, "verdicts"), element("ul", {}, ...lines.slice().reverse().map((verdict) => element("li", {},
      `${verdict.time_judged || verdict.time} ${verdict.by}: ${verdict.withdrawn ? "withdrawn" : CALLS[verdict.call]}${verdict.type ? `, ${plain(verdict.type)}` : ""}`
      + Object.entries(SIZES).map(([key, name]) => (verdict[key] ? `, ${name} ${metres(verdict[key], 2)}` : "")).join("")
      + (verdict.comment ? ` – ${verdict.comment}` : ""))))];
  }

  function form(contact, {max_comment: max, by}) {
    const list = element("datalist", {id: "types"}, ...TYPES.map((name) => element("option", {value: name})));
    const type = element("input", {type: "text", id: "type", maxLength: 64, placeholder: "type", value: plain(contact.type), "aria-label": "type"});
    type.setAttribute("list", "types");
    const comment = element("textarea", {id: "comment", maxLength: max, placeholder: "comment", value: contact.comment, "aria-label": "comment"});
    const button = (call, key) => element("button", {
      "aria-pressed": String(contact.call === call), onclick: () => save({call}), id: `call-${call}`,
    }, `${CALLS[call]} `, element("kbd", {}, key));
    return [
      element("div", {className: "judge"}, button("mine_like", "m"), button("not_mine_like", "n"), button("undecided", "u"), type, list,
        element("button", {id: "save", onclick: () => save({})}, "save"),
        contact.call && contact.by === by ? element("button", {id: "withdraw", onclick: () => save({withdrawn: true})}, "withdraw") : null),
      comment,
      element("p", {id: "sizes", className: "soft"}),
    ];
  }

  function drawSizes() {
    const line = byId("sizes");
    if (!line) return;
    const parts = Object.entries(SIZES).filter(([key]) => sizes()[key] !== null).map(([key, name]) => `${name} ${metres(sizes()[key], 2)}${spread(measured[key])}`);
    line.textContent = parts.length ? `measured: ${parts.join(", ")}` : "nothing measured by hand yet";
    if (Object.keys(measured).length) line.append(" ", element("button", {id: "forget", onclick: () => { measured = {}; drawSizes(); }}, "forget"));
  }

  function median(values) {
    const sorted = values.slice().sort((a, b) => a - b), middle = sorted.length >> 1;
    return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
  }

  const spread = (values) => (values && values.length > 1 ? ` (median of ${values.length}, ${Math.min(...values).toFixed(2)} to ${Math.max(...values).toFixed(2)})` : "");

  const rounded = (size) => Math.round(1000 * size) / 1000;
  const sizes = () => Object.fromEntries(Object.keys(SIZES).map((key) => [key, measured[key] ? rounded(median(measured[key])) : shown.contact[key] ?? null]));

  function save(change) {
    const {contact} = shown;
    handlers.judge({
      ...(contact.drawn ? {object: contact.object} : {contact_id: contact.id}),
      call: contact.call || "undecided",
      type: byId("type").value.trim(),
      comment: byId("comment").value.trim(),
      ...sizes(),
      ...change,
    });
  }

  // Both what the list has and what the results say; details come a moment later, or never for a drawn object.
  function show(contact, details, state) {
    if (isPressed) {
      waiting = [contact, details, state];
      return;
    }
    const isSame = shown && contact && shown.contact.key === contact.key;
    if (!isSame) measured = {};
    shown = contact ? {contact, details} : null;
    box.hidden = !contact;
    byId("card").parentElement.classList.toggle("has-card", Boolean(contact));
    const next = JSON.stringify([contact, details]);
    if (next === drawn) return;
    drawn = next;
    if (!contact) {
      box.replaceChildren();
      return;
    }
    const kept = isSame ? edited() : null, wasOpen = Boolean(byId("statistics") && byId("statistics").open);
    const kind = contact.drawn ? "drawn by hand" : `${contact.label}${contact.percent ? `, ${contact.percent}` : ""}`;
    const image = contact.drawn ? null : element("img", {src: `api/snippets/${contact.id}`, alt: `picture of ${contact.id}`, onerror: (event) => event.target.remove()});
    const more = element("details", {id: "statistics", open: isSame && wasOpen}, element("summary", {}, "statistics"), ...statistics(details, contact));
    box.replaceChildren(
      element("div", {className: "top"}, element("h2", {}, contact.id), element("span", {className: contact.likely ? "mine" : "soft"}, kind),
        element("span", {className: "space"}), element("button", {onclick: () => handlers.close()}, "close ", element("kbd", {}, "Esc"))),
      element("div", {className: "columns"}, image, front(details, contact)),
      ...form(contact, state),
      ...(contact.drawn ? [] : [more]),
    );
    if (kept) restore(kept);
    drawSizes();
  }

  // What somebody is writing stays, and so does the cursor in it.
  function edited() {
    const fields = ["type", "comment"].map(byId).filter(Boolean).map((field) => [field.id, field.value, field.selectionStart, field.selectionEnd]);
    return {fields, focus: box.contains(document.activeElement) ? document.activeElement.id : ""};
  }

  function restore({fields, focus}) {
    for (const [id, value, start, end] of fields) {
      byId(id).value = value;
      byId(id).setSelectionRange(start, end);
    }
    if (focus && byId(focus)) byId(focus).focus();
  }

  return {
    show,
    addMeasured(found) {
      for (const [key, size] of Object.entries(found)) measured[key] = [...(measured[key] || []), size];
      drawSizes();
    },
    judge(call) { if (shown) save({call}); },
    // What is written or measured and not saved, and where; null for nothing.
    get draft() {
      if (!shown) return null;
      const {latitude, longitude, type, comment} = shown.contact, typed = byId("type").value, written = byId("comment").value;
      if (typed === plain(type) && written === comment && !Object.keys(measured).length) return null;
      return {latitude, longitude, type: typed, comment: written, measured};
    },
    take(draft) {
      byId("type").value = draft.type;
      byId("comment").value = draft.comment;
      measured = draft.measured;
      drawSizes();
    },
    get current() { return shown && shown.contact; },
  };
}
