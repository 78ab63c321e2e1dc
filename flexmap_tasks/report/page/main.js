// Address, theme, keys; then the page begins.

// --- address, theme, keys --------------------------------------------------------------------------

/** #at=x,y,zoom&lanelet=id: where the map is and what is selected. */
function writeAddress() {
  const centre = map.getCenter(), parts = [`at=${centre.lng.toFixed(1)},${centre.lat.toFixed(1)},${map.getZoom().toFixed(2)}`];
  if (state.item >= 0) parts.push(`item=${state.item + 1}`);
  else if (state.kind) parts.push(`${state.kind}=${state.id}`);
  const address = `#${parts.join("&")}`;
  if (address !== location.hash) history.replaceState(null, "", address);
}

function readAddress() {
  const wanted = new URLSearchParams(location.hash.slice(1));
  const item = Number(wanted.get("item")), total = data.review.row.length;
  if (Number.isInteger(item) && item >= 1 && item <= total) stepTo(item - 1);
  for (const kind of ["lanelet", "way", "point"]) {
    const id = wanted.get(kind);
    if (id && /^-?\d+$/.test(id) && (kind !== "point" || Number(id) < (points?.label.length ?? 0))) select(kind, id, true);
  }
  const at = (wanted.get("at") ?? "").split(",").map(Number);
  if (at.length === 3 && at.every(Number.isFinite)) map.setView(latLng(at[0], at[1]), Math.max(-8, Math.min(8, at[2])), { animate: false });
  if (location.hash) writeAddress();
}

const THEMES = ["auto", "light", "dark"];
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  $("theme").textContent = `Theme: ${theme}`;
  inks.cache.clear();
  scene.redraw();
  if (CHART_TABS.has(openTab) && !$("main").classList.contains("folded")) showTab(openTab);
}
$("theme").addEventListener("click", () => setTheme(THEMES[(THEMES.indexOf(document.documentElement.dataset.theme) + 1) % 3]));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => setTheme(document.documentElement.dataset.theme));

$("print").addEventListener("click", () => window.print());
$("help").addEventListener("click", () => $("about").showModal());

function whole() {
  const box = boxOf(Array.from(slam.after));
  for (const other of after?.boxes ?? []) {
    box[0] = Math.min(box[0], other[0]);
    box[1] = Math.min(box[1], other[1]);
    box[2] = Math.max(box[2], other[2]);
    box[3] = Math.max(box[3], other[3]);
  }
  if (!(box[0] <= box[2])) box.splice(0, 4, -100, -100, 100, 100);
  map.fitBounds(L.latLngBounds(latLng(box[0], box[1]), latLng(box[2], box[3])), {
    animate: false, paddingTopLeft: [24, 56], paddingBottomRight: [52, 66],
  });
}

document.addEventListener("keydown", (event) => {
  const ordered = event.ctrlKey || event.metaKey, key = event.key.toLowerCase(), text = /^(text|search|number)$/.test(event.target.type);
  if (ordered && !text && (key === "z" || key === "y")) {
    event.preventDefault();
    return key === "y" || event.shiftKey ? travelDecisions(redone, undone) : travelDecisions(undone, redone);
  }
  if (ordered && key === "s" && unsaved()) { event.preventDefault(); return saveDecisions(); }
  if (ordered || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName) && event.target.type !== "checkbox") return undefined;
  const keys = { n: () => step(1), p: () => step(-1), y: () => decideShown("accept"), x: () => decideShown("reject"), c: () => decideShown("choose"), "/": () => $("search").focus(), f: whole, Escape: () => (pick ? choosing(null) : select(null)), "?": () => $("about").showModal() };
  if (/^[1-5]$/.test(event.key)) setView(Number(event.key) - 1);
  else if (keys[event.key]) keys[event.key]();
  else return undefined;
  return event.preventDefault();
});

function headline() {
  const value = (name) => measures.get(name), out = [];
  const add = (label, text, kind) => out.push(el("span", { class: kind ? `chip is-${kind}` : "chip" }, el("small", {}, label), el("b", {}, text)));
  add("deviation", `${number(value("deviation_before_all_rmse"))} → ${number(value("deviation_after_all_rmse"))} m`);
  if (data.matches) add("matched", percent(value("match_rate")));
  if (data.transfers) add("values set", number(value("transfers_set"), 0));
  if (data.review.row.length) add("to review", number(openItems(), 0), "review");
  const missed = data.quality.filter((m) => m.passed === false).length;
  if (data.quality.some((m) => m.passed !== null)) add("limits", missed ? `${missed} missed` : "all kept", missed ? "missed" : "ok");
  $("figures").replaceChildren(...out);
}

showDecided();
document.documentElement.dataset.theme = "auto";
map.invalidateSize({ pan: false });
whole();
scene.addTo(map);
if (data.transfers) { buildFilter(); refilter(); }
setItem(-1);
setView(0);
showDetails(null);
fold(innerHeight < 620);
readAddress();
map.on("moveend", writeAddress);
addEventListener("hashchange", readAddress);
addEventListener("resize", () => { map.invalidateSize({ pan: false }); if (!$("main").classList.contains("folded")) showTab(openTab); });
addEventListener("beforeprint", () => { for (const table of Object.values(tables)) table.fill(true, true); });
document.documentElement.dataset.ready = "yes";
