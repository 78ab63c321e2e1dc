// Decisions on what is up for review: made and undone here, saved as the file that the next run carries out.

const COLUMNS = ["kind", "lanelet_id", "way_id", "s_from_m", "s_to_m", "key", "old", "new", "decision", "value", "note", "who", "when"];
const COUNT_KEYS = new Set(["lanes", "bus_lane", "bicycle_lane", "road_shoulder", ""]);

/** Decisions by the ground they stand on; those of the file first, `holds` false where a run could not use one. */
let decided = new Map();
const undone = [], redone = [];
let kept = "", pick = null;

function ground(d) {
  return JSON.stringify([d.kind, d.lanelet_id, d.way_id, d.kind === "match" ? d.s_from_m : d.key, d.old, d.new]);
}

for (const d of data.decisions ?? []) decided.set(ground(d), d);
kept = stateOfDecisions();

function stateOfDecisions() {
  return JSON.stringify([...decided]);
}

/** What a decision on item i of the review would be about. */
function asked(i) {
  const kind = data.review.kind[i], row = data.review.row[i], plain = { s_from_m: "", s_to_m: "" };
  if (kind === "match") return askedOfPiece(row);
  if (kind === "lanes") {
    const c = data.lane_check;
    return { kind, lanelet_id: c.lanelet[row], way_id: c.way[row], ...plain, key: "lanes", old: String(c.lanes_map[row]), new: String(c.lanes_osm[row]) };
  }
  if (kind === "change") {
    const c = data.changes;
    return { kind, lanelet_id: "0", way_id: c.way[row], ...plain, key: c.key[row], old: c.old[row], new: c.new[row] };
  }
  const t = data.transfers;
  return { kind, lanelet_id: t.lanelet[row], way_id: t.way[row], ...plain, key: t.key[row], old: t.old[row], new: t.new[row] };
}

/** The same for a piece of a lanelet, whether matching was certain of it or not. */
function askedOfPiece(row) {
  const m = data.matches;
  return { kind: "match", lanelet_id: m.lanelet[row], way_id: m.way[row], s_from_m: m.s_from_m[row].toFixed(3), s_to_m: m.s_to_m[row].toFixed(3), key: "", old: "", new: "" };
}

const decisionOf = (about) => decided.get(ground(about));
const isOpen = (i) => !decisionOf(asked(i));

/** Change the decisions in a way that can be undone. */
function changeDecisions(make) {
  undone.push(stateOfDecisions());
  redone.length = 0;
  make();
  showDecided();
}

function travelDecisions(from, to) {
  if (!from.length) return;
  to.push(stateOfDecisions());
  decided = new Map(JSON.parse(from.pop()));
  showDecided();
  if (state.item >= 0) stepTo(state.item);
  else showDetails(state.kind, state.id);
}

/** Note a decision, or take it back when it was made before; then go on to the next open item. */
function decide(about, decision, value = "", note = "") {
  const now = decisionOf(about), same = now?.decision === decision && now.value === value && now.note === note;
  changeDecisions(() => {
    if (same) decided.delete(ground(about));
    else decided.set(ground(about), { ...about, decision, value, note, who: "", when: "" });
  });
  pick = null;
  if (state.item < 0) showDetails(state.kind, state.id);
  else if (same || !nextOpen()) stepTo(state.item);
}

/** Go to the next item nobody has decided on; false when there is none. */
function nextOpen() {
  const total = data.review.row.length;
  for (let k = 1; k <= total; k++) {
    const i = (state.item + k) % total;
    if (isOpen(i)) { stepTo(i); return true; }
  }
  return false;
}

const VERBS = {
  value: ["Accept", "Reject"], match: ["Accept this way", "No way"], lanes: ["OSM is right", "Map is right"],
  fragment: ["Take it out", "Keep it"], count: ["OSM is right", "Map is right"], cut: ["Seen", null],
  change: ["Seen, it is right", "OSM is wrong"],
};

/** The buttons for one thing to be decided on. */
function decisionButtons(about) {
  const now = decisionOf(about), offered = about.kind === "value" && !COUNT_KEYS.has(about.key);
  const verbs = VERBS[about.kind !== "value" || offered ? about.kind : about.key === "" ? "cut" : "count"];
  const value = offered ? el("input", { type: "text", class: "value", value: now?.value || about.new, "aria-label": "value to set", maxlength: 255 })
    : about.kind === "lanes" ? el("input", { type: "number", class: "value", min: 0, max: 99, value: now?.value ?? "", placeholder: "number of lanes", "aria-label": "number of lanes" }) : null;
  const note = el("input", { type: "text", class: "note", value: now?.note ?? "", placeholder: "note", "aria-label": "note", maxlength: 500 });
  const other = () => (value && value.value.trim() !== about.new ? value.value.trim() : "");
  const button = (decision, text, key) => text && el("button", {
    type: "button", "data-decision": decision, title: `Key ${key}`, "aria-pressed": String(now?.decision === decision && !(about.kind === "match" && now.value)),
    onclick: () => decide(about, decision, decision === "accept" || about.kind === "lanes" ? other() : "", note.value.trim()),
  }, text);
  const parts = [value, about.kind === "match" && about.way_id === "0" ? null : button("accept", verbs[0], "y"), button("reject", verbs[1], "x")];
  if (about.kind === "match") {
    parts.push(el("button", { type: "button", "data-decision": "choose", title: "Click it on the map (key c)", "aria-pressed": String(Boolean(now?.value)),
      onclick: () => choosing({ about, note: () => note.value.trim() }) }, now?.value ? `Way ${now.value}` : "Another way…"));
  }
  return el("div", { class: "decide" }, parts, note, now ? el("p", { class: "hint" }, saidOf(now)) : null);
}

/** "accepted, by ann on 2026-01-02" */
function saidOf(d) {
  const by = [d.who && ` by ${d.who}`, d.when && ` on ${d.when.slice(0, 10)}`].filter(Boolean).join("");
  const what = d.value ? `decided: ${d.value}` : d.decision === "accept" ? "accepted" : "rejected";
  return el("span", {}, foreign(what), foreign(by || ", not saved yet"), d.holds === false ? el("b", {}, "; it no longer holds: its ground has changed") : null);
}

/** Wait for a click on the way that a piece follows; null ends it. */
function choosing(wanted) {
  pick = wanted;
  if (pick && !layer("roads").on) setLayer("roads", true);
  $("stage").classList.toggle("picking", Boolean(pick));
  tell(pick ? "Click the way that this piece follows. Esc: leave it as it is." : "");
  state.hover = null;
  scene.redraw();
}

function choosePicked(x, y) {
  const way = roadAt(x, y, 14 / map.getZoomScale(map.getZoom(), 0));
  if (!way) return tell("No way there; click nearer to one. Esc: leave it as it is.");
  const { about, note } = pick;
  choosing(null);
  return decide(about, "accept", way === about.way_id ? "" : way, note());
}

/** The same by key, for the item that is shown. */
function decideShown(decision) {
  if (state.item >= 0) document.querySelector(`#inspector .question .decide [data-decision=${decision}]`)?.click();
}

/** A word to the person, below the map; with a button when there is something to do about it. */
function tell(text, bad = false, action = null) {
  $("said").hidden = !text;
  $("said").classList.toggle("bad", bad);
  $("said").replaceChildren(foreign(text), ...(action ? [" ", el("button", { type: "button", class: "link", onclick: action[1] }, action[0])] : []));
}

const unsaved = () => stateOfDecisions() !== kept;

function showDecided() {
  const before = new Map(JSON.parse(kept));
  let changes = [...before.keys()].filter((key) => !decided.has(key)).length;
  for (const [key, d] of decided) if (JSON.stringify(d) !== JSON.stringify(before.get(key))) changes++;
  $("undo").hidden = $("redo").hidden = !undone.length && !redone.length;
  $("undo").disabled = !undone.length;
  $("redo").disabled = !redone.length;
  $("decided").hidden = changes === 0;
  $("decided").textContent = `Save ${changes} decision${changes === 1 ? "" : "s"}`;
  document.title = `${changes ? "• " : ""}${data.map} · FlexMap ${data.editor ? "review" : "report"}`;
  headline();
  delete tables.decisions;
  tables.review?.fill(true);
  if (openTab === "decisions" && !$("main").classList.contains("folded")) showTab("decisions");
  scene.redraw();
}

function decisionsCsv() {
  const when = new Date().toISOString().replace(/\.\d+Z$/, "Z");
  const line = (d) => COLUMNS.map((name) => csvCell(name === "when" ? d.when || when : d[name])).join(",");
  return `${[COLUMNS.join(","), ...[...decided.values()].map(line)].join("\r\n")}\r\n`;
}

async function saveDecisions() {
  if (!data.editor) {
    download("review_decisions.csv", decisionsCsv());
    kept = stateOfDecisions();
    showDecided();
    return tell("Saved as review_decisions.csv: name it in the configuration as conflation.review_file.");
  }
  const sent = stateOfDecisions(), rows = [...decided.values()].map((d) => Object.fromEntries(COLUMNS.map((name) => [name, d[name]])));
  const told = await askServer("decide", { base: data.editor.base, decisions: rows });
  if (told.error) return tell(told.error, true);
  const saved = new Map(told.decisions.map((d) => [ground(d), { ...d, holds: decided.get(ground(d))?.holds }]));
  // What was decided while the answer was on its way stays, and waits to be saved.
  if (stateOfDecisions() === sent) decided = saved;
  kept = JSON.stringify([...saved]);
  data.editor.base = told.base;
  undone.length = redone.length = 0;
  showDecided();
  return tell(told.said, false, ["Show what they do", () => {
    tell("Making the map with them…");
    location.reload();
  }]);
}

/** Ask the editor's server; the address of the page holds the token. */
async function askServer(what, body) {
  const reply = await fetch(what, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) }).catch(() => null);
  if (!reply) return { error: "the server does not answer; is flexmap edit still running?" };
  const told = await reply.json().catch(() => ({ error: `the server answered ${reply.status}` }));
  return reply.ok || told.error ? told : { error: `the server answered ${reply.status}` };
}

function decisionTable() {
  const rows = [...decided.values()], words_ = { accept: "accepted", reject: "rejected" };
  const state_ = (d) => (d.when === "" ? "new" : d.holds === undefined ? "saved" : d.holds ? "holds" : "gone");
  return new Table("decisions", rows.length, [
    { name: "kind", width: 96, get: (i) => KINDS[rows[i].kind] ?? rows[i].kind },
    { name: "lanelet", width: 118, get: (i) => rows[i].lanelet_id },
    { name: "about", width: 130, get: (i) => rows[i].key || (rows[i].kind === "match" ? `${rows[i].s_from_m}–${rows[i].s_to_m} m` : "cut") },
    { name: "map had", width: 110, get: (i) => rows[i].old },
    { name: "OSM said", width: 130, get: (i) => rows[i].new || (rows[i].kind === "match" ? rows[i].way_id : "") },
    { name: "decision", width: 90, get: (i) => words_[rows[i].decision] },
    { name: "instead", width: 110, get: (i) => rows[i].value },
    { name: "state", width: 120, get: (i) => words[state_(rows[i])], show: (i) => badge(state_(rows[i])) },
    { name: "who", width: 80, get: (i) => rows[i].who },
    { name: "when, UTC", width: 150, get: (i) => rows[i].when, show: (i) => rows[i].when.replace("T", " ").replace("Z", "") },
    { name: "note", get: (i) => rows[i].note },
    { name: "", width: 44, get: () => "", show: (i) => el("button", { type: "button", class: "close", title: "Take the decision back", onclick: (event) => {
      event.stopPropagation();
      changeDecisions(() => decided.delete(ground(rows[i])));
    } }, "×") },
  ], { open: (i) => (rows[i].lanelet_id === "0" ? select("way", rows[i].way_id, true) : select("lanelet", rows[i].lanelet_id, true)) });
}

addEventListener("beforeunload", (event) => { if (unsaved()) event.preventDefault(); });
