// The editor's page: map, picking, dragging, the list, saving.

const $ = (id) => document.getElementById(id);
$("title").append(foreign(data.map));

const map = L.map("map", {
  crs: L.CRS.Simple, zoomControl: false, attributionControl: false, minZoom: -8, maxZoom: 8, zoomSnap: 0, zoomDelta: 0.75,
  wheelPxPerZoomLevel: 90, doubleClickZoom: false,
});
L.control.zoom({ position: "topright" }).addTo(map);
L.control.scale({ imperial: false, maxWidth: 140 }).addTo(map);
const box = boxOf(Array.from(slam.after));
map.fitBounds(L.latLngBounds(L.latLng(box[1], box[0]), L.latLng(box[3], box[2])).pad(0.05), { animate: false });

const shown = layers.filter((l) => l.id !== "points");
for (const l of shown) l.on = ["gnss", "slam_before", "slam_after", "before"].includes(l.id);
/** Lanes that would change much, where the rigid start has them. */
const bent = {
  on: true,
  draw(view) {
    const lanes = answer?.lanes?.lanelets;
    if (lanes && before) made("bent", () => { const paths = new Paths(); for (const [id] of lanes) if (before.rowOf.has(id)) paths.add(before.rings[before.rowOf.get(id)], true); return paths; }).fill(view, inks.get("lanes-differ"));
  },
};
const scene = new Scene([...shown, bent, handles]);
scene.addTo(map);
$("layers").append(el("section", { class: "group" }, el("h2", {}, "Layers"), shown.map((l) => el("label", { class: "layer" },
  el("input", { type: "checkbox", id: `layer-${l.id}`, checked: l.on, onchange: (event) => { l.on = event.target.checked; scene.redraw(); } }),
  swatch(l.swatch), el("span", {}, l.name)))));

const px = () => 1 / map.getZoomScale(map.getZoom(), 0);

/** The handle near a place: [row, "source" or "target"], the nearest first; null when there is none. */
function handleAt(x, y) {
  let best = null, least = 9 * px();
  pairs.forEach((pair, i) => {
    for (const side of ["target", "source"]) {
      const distance = Math.hypot(pair[side][0] - x, pair[side][1] - y);
      if (distance < least) { least = distance; best = [i, side]; }
    }
  });
  return best;
}

/** A place, pulled onto the track of its side when it is near; not with Alt held down. */
function snapped(side, x, y, event) {
  if (event.altKey) return [x, y];
  return onTrack(side === "source" ? slam.before : gnss.xy, x, y, 18 * px()) ?? [x, y];
}

function adding(on) {
  half = on ? half : null;
  $("add").setAttribute("aria-pressed", String(on));
  say();
  scene.redraw();
}

const isAdding = () => $("add").getAttribute("aria-pressed") === "true";

function say() {
  const text = !isAdding() ? "Drag a handle to move it; click one to choose it. Alt: no snapping."
    : half ? "Now click its partner on the GNSS track, or press Enter to take the suggested one."
      : "Click a place on the SLAM track (rigid start).";
  $("legend").replaceChildren(el("div", {}, text));
}

function finish(target) {
  const { source } = half;
  half = null;
  change(() => { pairs.push({ label: freeName(), source, target, sigma: 0.1, used: true }); chosen = pairs.length - 1; });
  adding(true);
}

map.on("click", (event) => {
  const { lng: x, lat: y } = event.latlng;
  if (isAdding()) {
    if (half) return finish(snapped("target", x, y, event.originalEvent));
    const source = snapped("source", x, y, event.originalEvent);
    half = { source, target: suggested(source) };
    say();
    return scene.redraw();
  }
  const hit = handleAt(x, y);
  chosen = hit ? hit[0] : -1;
  return show();
});
map.on("mousedown", (event) => {
  const hit = isAdding() ? null : handleAt(event.latlng.lng, event.latlng.lat);
  if (!hit) return;
  map.dragging.disable();
  drag = { row: hit[0], side: hit[1], before: JSON.stringify(pairs), moved: false };
  chosen = hit[0];
});
map.on("mousemove", (event) => {
  const { lng: x, lat: y } = event.latlng, [lon, lat] = lonLat(x, y);
  $("readout").textContent = `x ${x.toFixed(2)}  y ${y.toFixed(2)} m   ${lat.toFixed(7)}, ${lon.toFixed(7)}`;
  if (!drag) return;
  drag.moved = true;
  pairs[drag.row][drag.side] = snapped(drag.side, x, y, event.originalEvent);
  scene.redraw();
});
document.addEventListener("mouseup", () => {
  if (!drag) return;
  map.dragging.enable();
  if (drag.moved) { past.push(drag.before); future.length = 0; changed(); }
  drag = null;
  show();
});

function changed() {
  verdict = null;
  show();
  judge();
}

function show() {
  const a = answer ?? {}, chips = [];
  const chip = (text, value) => chips.push(el("span", { class: "chip" }, el("small", {}, text), el("b", {}, value)));
  chip("rigid start", a.before_rmse_m === undefined ? "…" : `${number(a.before_rmse_m, 3)} m`);
  chip(data.method === "pose_graph" ? "pose graph" : data.method === "rubber_sheet" ? "rubber sheet" : "as rubber sheet", a.after_rmse_m === undefined ? "…" : `${number(a.after_rmse_m, 3)} m`);
  chip("with valid GNSS", a.valid_rmse_m === undefined ? "…" : `${number(a.valid_rmse_m, 3)} m`);
  if (a.sheet) {
    const stretch = decode(a.sheet.stretch);
    chip("stretch", `${number(Math.min(...stretch), 3)} to ${number(Math.max(...stretch), 3)}`);
  }
  if (a.lanes) $("widths").replaceChildren(...widthRows(a.lanes));
  $("figures").replaceChildren(...chips);
  const spoken = verdict ?? a;
  $("message").textContent = spoken.error ?? spoken.said ?? "";
  $("message").classList.toggle("bad", Boolean(spoken.error));
  $("rows").replaceChildren(...pairs.map(rowOf));
  $("undo").disabled = !past.length;
  $("redo").disabled = !future.length;
  $("save").disabled = JSON.stringify(pairs) === saved;
  document.title = `${$("save").disabled ? "" : "• "}${data.map} · FlexMap editor`;
  scene.redraw();
}

/** Why each point that was there is used or not; which of them nobody gave, so that they are the alignment's own. */
const reasonOf = new Map(points ? points.label.map((name, i) => [name, points.reason[i]]) : []);
const automatic = new Set([...reasonOf].filter(([, why]) => !/^(given|excluded) by the user/.test(why)).map(([name]) => name));

/** How the widths of the lanes would change, and which lanelets by more than 10 cm, the worst first. */
function widthRows(lanes) {
  const worst = [...lanes.lanelets].sort((a, b) => b[1] - a[1]);
  const out = [el("dl", { class: "facts" }, el("dt", {}, "greatest change"), el("dd", {}, `${number(lanes.max_m, 2)} m`),
    el("dt", {}, "cross sections over 10 cm"), el("dd", {}, percent(lanes.share_over_10cm)), el("dt", {}, "folded lanelets"), el("dd", {}, number(lanes.folded, 0)))];
  if (!worst.length) return out;
  return [...out, el("p", { class: "hint" }, swatch("lanes-differ"), ` ${number(worst.length, 0)} lanelets change by more than 10 cm:`),
    el("div", { class: "links" }, worst.slice(0, 60).map(([id, change_m]) => el("button", { type: "button", class: "link", onclick: () => goToLanelet(id) }, `${id} (${number(change_m, 2)} m)`)))];
}

function goToLanelet(id) {
  const row = before?.rowOf.get(id);
  if (row === undefined) return;
  const [a, b, c, d] = before.boxes[row];
  map.fitBounds(L.latLngBounds(L.latLng(b, a), L.latLng(d, c)).pad(0.8), { maxZoom: 3, animate: false });
}

function rowOf(pair, i) {
  const loo = answer?.left_out_m?.[i], left = answer?.residual_m?.[i];
  return el("tr", { class: i === chosen ? "chosen" : null, onclick: () => { chosen = i; show(); } },
    el("td", {}, el("input", { type: "checkbox", checked: pair.used, "aria-label": "use", onclick: (e) => e.stopPropagation(), onchange: () => change(() => { pairs[i].used = !pairs[i].used; }) })),
    el("td", { title: reasonOf.get(pair.label) ?? "picked here" }, foreign(pair.label.slice(0, 40)), automatic.has(pair.label) ? el("small", { class: "auto" }, " automatic") : null),
    el("td", { class: "num" }, number(Math.hypot(pair.target[0] - pair.source[0], pair.target[1] - pair.source[1]), 2)),
    ...(data.method === "pose_graph" ? [el("td", { class: "num" }, left === null || left === undefined ? "–" : number(left, 2))] : []),
    el("td", { class: "num" }, loo === null || loo === undefined ? "–" : number(loo, 2)),
    el("td", {}, el("input", { type: "number", min: "0.001", max: "100", step: "0.01", value: String(pair.sigma), "aria-label": "sigma", onclick: (e) => e.stopPropagation(),
      onchange: (event) => { const v = Number(event.target.value); if (v > 0 && v <= 100) change(() => { pairs[i].sigma = v; }); else show(); } })),
    el("td", {}, el("button", { type: "button", class: "close", title: "Remove", onclick: (e) => { e.stopPropagation(); change(() => { pairs.splice(i, 1); chosen = -1; }); } }, "×")));
}

async function save() {
  const sent = JSON.stringify(pairs), told = await ask("save", { pairs, base: data.editor.base }).catch(() => ({ error: "the server does not answer" }));
  if (!told.error) { saved = sent; data.editor.base = told.base; }
  verdict = told; // stands until the next change, whatever preview arrives after it
  show();
}

$("add").addEventListener("click", () => adding(!isAdding()));
$("undo").addEventListener("click", () => travel(past, future));
$("redo").addEventListener("click", () => travel(future, past));
$("save").addEventListener("click", save);
document.addEventListener("keydown", (event) => {
  const typing = /^(INPUT|SELECT)$/.test(event.target.tagName) && event.target.type !== "checkbox", key = event.key.toLowerCase();
  if ((event.ctrlKey || event.metaKey) && key === "z" && !typing) travel(...(event.shiftKey ? [future, past] : [past, future]));
  else if ((event.ctrlKey || event.metaKey) && key === "y" && !typing) travel(future, past);
  else if ((event.ctrlKey || event.metaKey) && key === "s") { if (!$("save").disabled) save(); }
  else if (typing || event.ctrlKey || event.metaKey) return;
  else if (key === "a") adding(!isAdding());
  else if (key === "enter" && half) finish(half.target);
  else if (key === "escape") adding(false);
  else if (key === "delete" && chosen >= 0) change(() => { pairs.splice(chosen, 1); chosen = -1; });
  else return;
  event.preventDefault();
});
addEventListener("beforeunload", (event) => { if (!$("save").disabled) event.preventDefault(); });
addEventListener("resize", () => map.invalidateSize({ pan: false }));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { inks.cache.clear(); scene.redraw(); });

if (data.method === "pose_graph") $("left").after(el("th", { class: "num", title: "How far the pose graph with all of them puts it from its target" }, "left, m"));
if (!before) $("widths").hidden = true;
adding(false);
show();
judge().then(() => { document.documentElement.dataset.ready = "yes"; });
