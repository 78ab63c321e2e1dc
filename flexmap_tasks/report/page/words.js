// Elements, numbers and words. Text from maps only ever becomes a text node.

/** An element with attributes, listeners (onclick: ...) and children; strings become text nodes. */
function el(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") node.addEventListener(key.slice(2), value);
    else if (key === "class") node.className = value;
    else node.setAttribute(key, value === true ? "" : value);
  }
  for (const child of children.flat()) {
    if (child !== null && child !== undefined && child !== false) node.append(child);
  }
  return node;
}

/** Text of unknown origin, kept apart from the direction of the text around it. */
function foreign(value, attributes = {}) {
  return el("bdi", { class: "foreign", ...attributes }, value);
}

function number(value, digits = 2) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  return value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

function percent(value) {
  return value === null || value === undefined ? "–" : `${number(100 * value, value >= 1 || value <= 0 ? 0 : 1)} %`;
}

function withUnit(value, unit) {
  if (value === null || value === undefined) return "–";
  if (unit === "count") return number(value, 0);
  if (unit === "1") return number(value, 4);
  return `${number(value, 3)} ${unit === "deg" ? "°" : unit}`;
}

const words = {
  set: "set", keep: "kept", review: "review", split: "cut", remove: "removed",
  match: "matched", none: "no match", agree: "agree", differ: "differ", unknown: "unknown", unmatched: "unmatched",
  open: "open", accept: "accepted", reject: "rejected", new: "not saved", saved: "saved", holds: "holds", gone: "no longer holds", ok: "ok",
  cached: "cached", computed: "computed", change: "OSM change",
  error: "error", warning: "warning", info: "info",
};

function badge(kind) {
  return el("span", { class: `badge is-${/^[a-z]+$/.test(kind) ? kind : "other"}` }, words[kind] ?? kind);
}

function swatch(kind) {
  return el("i", { class: `swatch s-${kind}`, "aria-hidden": "true" });
}

function readable(name) {
  const text = name.replaceAll("_", " ");
  return text.charAt(0).toUpperCase() + text.slice(1);
}

const measures = new Map(data.quality.map((measure) => [measure.name, measure.value]));

/** How often each value of a column stands there. */
function counted(values) {
  const out = new Map();
  for (const value of values) out.set(value, (out.get(value) ?? 0) + 1);
  return out;
}
