// Layers, views, filter, search, charts and tables.

// --- layers, views, filter -------------------------------------------------------------------------

const legends = {
  gnss: () => gnss.seen.map((q) => [`gnss-${QUALITIES[q][0]}`, QUALITIES[q][1]]).concat(gaps.cells.size ? [["gnss-gap", "jump or outage"]] : []),
  links: () => CONFIDENCES.map((limit, i) => [`confidence-${i}`, i === 0 ? "below 0.50" : i === 4 ? "0.90 and over" : `${CONFIDENCES[i - 1].toFixed(2)} to ${limit.toFixed(2)}`]),
  lanes: () => VERDICTS.map((verdict) => [`lanes-${verdict}`, words[verdict]]),
  changed: () => ["1 decision", "2 decisions", "3 and more"].map((text, i) => [`changed-${i}`, text]),
  sheet: () => [["sheet", "aligned"], ["sheet-before", "rigid start"]],
  sigma: () => SIGMAS.map((limit, i) => [`sigma-${i}`, i === SIGMAS.length - 1 ? `over ${SIGMAS[i - 1]} m` : `up to ${limit} m`]),
  ties: () => [["ties", "fix to aligned antenna"]],
  corrections: () => [["corrections", "from the rigid start to the aligned place"]],
  changes: () => [["changes", "changed"], ["changes-gone", "gone"], ["changes-new", "new"]],
  points: () => [["point", "used"], ["point-unused", "not used"]],
  background: () => [["background", data.tiles.attribution || new URL(data.tiles.url).host]],
  review: () => [["review", "open"], ["decided", "decided"]],
  findings: () => ["error", "warning", "info"].map((s) => [`finding-${s}`, s]),
};

function drawLegend() {
  const parts = layers.filter((l) => l.on && legends[l.id]).map((l) => el("div", {}, el("b", {}, l.name),
    legends[l.id]().map(([kind, text]) => el("span", {}, swatch(kind), text))));
  $("legend").replaceChildren(...parts);
  $("legend").hidden = !parts.length;
}

function setLayer(id, on) {
  layer(id).on = on;
  const box = $(`layer-${id}`);
  if (box) box.checked = on;
  for (const button of $("views").children) {
    const wanted = VIEWS[Number(button.dataset.view)][1].filter((name) => layer(name));
    button.setAttribute("aria-pressed", String(layers.every((l) => l.on === wanted.includes(l.id))));
  }
  drawLegend();
  scene.redraw();
}

function setView(index) {
  const view = VIEWS[index];
  if (view) for (const l of layers) setLayer(l.id, view[1].includes(l.id));
}

for (const group of ["Maps", "Conflation", "Drive"]) {
  const members = layers.filter((l) => l.group === group);
  if (!members.length) continue;
  $("layers").append(el("section", { class: "group" }, el("h2", {}, group), members.map((l) =>
    el("label", { class: "layer" }, el("input", { type: "checkbox", id: `layer-${l.id}`, onchange: (event) => setLayer(l.id, event.target.checked) }),
      swatch(l.swatch), el("span", {}, l.name), el("small", { id: `count-${l.id}` }, number(l.count, 0))))));
}
VIEWS.forEach(([name, wanted], i) => {
  if (wanted.some((id) => layer(id) && !["after", "roads"].includes(id))) {
    $("views").append(el("button", { type: "button", "data-view": i, title: `Key ${i + 1}`, onclick: () => setView(i) }, name));
  }
});

function refilter() {
  lazy.changed = undefined;
  const rows = data.transfers.lanelet.map((_, i) => i).filter(passes);
  const lanelets = new Set(rows.map((i) => data.transfers.lanelet[i])).size;
  $("filter-count").textContent = `${number(rows.length, 0)} decisions on ${number(lanelets, 0)} lanelets`;
  $("count-changed").textContent = number(lanelets, 0);
  tables.transfers?.refresh();
  scene.redraw();
}

function buildFilter() {
  $("decisions").hidden = false;
  const keys = [...counted(data.transfers.key)].filter(([key]) => key !== "").sort((a, b) => b[1] - a[1]);
  $("filter-key").append(el("option", { value: "" }, "all"), ...keys.map(([key, n]) => el("option", { value: key }, `${key.slice(0, 60)} (${n})`)));
  $("filter-key").addEventListener("change", (event) => { filter.key = event.target.value; if (!layer("changed").on) setLayer("changed", true); refilter(); });
  const counts = counted(data.transfers.action);
  for (const action of ACTIONS) {
    if (!counts.has(action)) continue;
    $("filter-actions").append(el("button", { type: "button", "data-action": action, "aria-pressed": String(filter.actions.has(action)), onclick: (event) => {
      if (!filter.actions.delete(action)) filter.actions.add(action);
      event.currentTarget.setAttribute("aria-pressed", String(filter.actions.has(action)));
      if (!layer("changed").on) setLayer("changed", true);
      refilter();
    } }, swatch(action), `${words[action]} `, el("small", {}, number(counts.get(action), 0))));
  }
}

// --- search ----------------------------------------------------------------------------------------

/** Up to `most` lanelets and ways whose id begins with the text, then those with a value that contains it. */
function find(text, most = 12) {
  const needle = text.trim().toLowerCase(), hits = [], seen = new Set();
  const hit = (kind, id, why) => {
    if (hits.length < most && !seen.has(kind + id)) { seen.add(kind + id); hits.push({ kind, id, why }); }
  };
  if (!needle) return hits;
  const things = [["lanelet", after?.lanelets], ["way", roads]].filter(([, t]) => t);
  for (const exact of [true, false]) {
    for (const [kind, thing] of things) for (const id of thing.id) if (exact ? id === needle : id.startsWith(needle)) hit(kind, id, "");
  }
  for (const [kind, thing] of things) {
    for (let row = 0; row < thing.id.length && hits.length < most; row++) {
      for (let i = thing.tags.offset[row]; i < thing.tags.offset[row + 1]; i++) {
        if (thing.tags.value[i].toLowerCase().includes(needle)) { hit(kind, thing.id[row], `${thing.tags.key[i]}=${thing.tags.value[i]}`); break; }
      }
    }
  }
  return hits;
}

function showFound() {
  const hits = find($("search").value), list = $("found");
  list.hidden = !$("search").value.trim();
  list.replaceChildren(...hits.map(({ kind, id, why }) => el("li", {}, el("button", { type: "button", onclick: () => choose(kind, id) },
    el("small", {}, kind), el("b", {}, id), foreign(why.slice(0, 80))))), ...(hits.length ? [] : [el("li", { class: "hint" }, "Nothing found")]));
}

function choose(kind, id) {
  $("found").hidden = true;
  $("search").blur();
  select(kind, id, true);
}

$("search").addEventListener("input", showFound);
$("search").addEventListener("keydown", (event) => {
  if (event.key === "Enter") { const [first] = find($("search").value, 1); if (first) choose(first.kind, first.id); }
  if (event.key === "Escape") { $("search").value = ""; showFound(); $("search").blur(); }
});

// --- charts and tables -----------------------------------------------------------------------------

const tables = {};
const TABS = [
  ["deviation", "Deviation", drawCharts, true],
  ["reliability", "Reliability", drawReliability, Boolean(data.calibration || data.matches)],
  ["quality", "Quality", qualityTable, true],
  ["transfers", "Attributes", transferTable, Boolean(data.transfers)],
  ["review", "Review", reviewTable, data.review.row.length > 0],
  ["decisions", "Decisions", decisionTable, data.review.row.length + decided.size > 0],
  ["lanes", "Lane check", laneTable, Boolean(data.lane_check)],
  ["points", "Control points", pointTable, Boolean(points)],
  ["changes", "OSM changes", changeTable, Boolean(data.changes?.way.length)],
  ["stages", "Stages", stageTable, Boolean(data.stages)],
  ["findings", "Findings", findingTable, Boolean(findings?.id.length)],
].filter(([, , , there]) => there);
const CHART_TABS = new Set(["deviation", "reliability"]);
let openTab = "deviation";

function showTab(id) {
  openTab = id;
  for (const button of $("tabs").children) button.setAttribute("aria-selected", String(button.dataset.tab === id));
  const make = TABS.find(([name]) => name === id)[2], drawn = CHART_TABS.has(id);
  for (const name of ["table-filter", "export"]) $(name).hidden = drawn;
  if (drawn) return make($("panel"));
  charts.splice(0).forEach((chart) => chart.destroy());
  tables[id] ??= make();
  $("panel").replaceChildren(tables[id].node);
  $("table-filter").value = tables[id].needle;
  return tables[id].fill(true);
}

function fold(folded) {
  $("main").classList.toggle("folded", folded);
  $("fold").setAttribute("aria-expanded", String(!folded));
  $("fold").textContent = folded ? "▴" : "▾";
  map.invalidateSize({ pan: false });
  if (!folded) showTab(openTab);
}

for (const [id, name] of TABS) {
  $("tabs").append(el("button", { type: "button", role: "tab", "data-tab": id, onclick: () => { openTab = id; fold(false); } }, name));
}
$("fold").addEventListener("click", () => fold(!$("main").classList.contains("folded")));
$("table-filter").addEventListener("input", (event) => { tables[openTab].needle = event.target.value; tables[openTab].refresh(); });
$("export").addEventListener("click", () => download(`${openTab}.csv`, tables[openTab].csv()));
