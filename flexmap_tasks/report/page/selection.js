// The map, what is selected on it, and the review.

const $ = (id) => document.getElementById(id);
const DIGITS = 1;

document.title = `${data.map} · FlexMap report`;
$("title").append(foreign(data.map));

const map = L.map("map", {
  crs: L.CRS.Simple, zoomControl: false, attributionControl: false, minZoom: -8, maxZoom: 8,
  zoomSnap: 0, zoomDelta: 0.75, wheelPxPerZoomLevel: 90, inertia: true, boxZoom: true,
});
L.control.zoom({ position: "topright" }).addTo(map);
L.control.scale({ imperial: false, maxWidth: 140 }).addTo(map);
const latLng = (x, y) => L.latLng(y, x);

// --- what is selected ----------------------------------------------------------------------------

/** item : of the review; pose : of the drive; offer : the way in question; hover : the way a click would choose */
const state = { kind: null, id: null, item: -1, pose: null, offer: null, hover: null };

const marks = {
  on: true,
  draw(view) {
    for (const [id, ink] of [[state.offer, "review"], [state.hover, "selected"]]) {
      if (id) trace(view, courseOf(id), inks.get(ink));
    }
    if (state.kind === "lanelet") {
      const shown = after?.rowOf.has(state.id) ? after : before?.rowOf.has(state.id) ? before : null;
      if (shown) outline(view, shown.rings[shown.rowOf.get(state.id)], true);
    } else if (state.kind === "way") {
      outline(view, courseOf(state.id), false);
    } else if (state.kind === "point") {
      disc(view, points.target[2 * state.id], points.target[2 * state.id + 1], 10, null, inks.get("selected"), 3);
    }
    if (state.pose !== null) disc(view, slam.after[2 * state.pose], slam.after[2 * state.pose + 1], 7, inks.get("slam-after"), inks.get("map"), 2.5);
  },
};

/** The course of a way, x0, y0, x1, ...; empty where the report does not show it. */
function courseOf(id) {
  const row = roads?.rowOf.get(id);
  return row === undefined ? [] : Array.from(roads.xy.subarray(2 * roads.offset[row], 2 * roads.offset[row + 1]));
}

function trace(view, flat, colour) {
  const path = new Paths();
  path.add(flat, false);
  path.stroke(view, inks.get("map"), 7);
  path.stroke(view, colour, 4, [10, 5]);
}

function outline(view, flat, closed) {
  const path = new Paths();
  path.add(flat, closed);
  if (closed) path.fill(view, inks.get("selected-fill"));
  path.stroke(view, inks.get("map"), 6);
  path.stroke(view, inks.get("selected"), 3);
}

const scene = new Scene([...layers, marks]);

function boxOfSelection(kind, id) {
  if (kind === "lanelet") {
    const shown = after?.rowOf.has(id) ? after : before?.rowOf.has(id) ? before : null;
    return shown && shown.boxes[shown.rowOf.get(id)];
  }
  if (kind === "way") return roads?.rowOf.has(id) ? roads.boxes[roads.rowOf.get(id)] : null;
  const [x, y] = [points.target[2 * id], points.target[2 * id + 1]];
  return [x - 40, y - 40, x + 40, y + 40];
}

/** Select a lanelet, way or control point, or nothing; with `go` the map moves there when it is out of sight. */
function select(kind, id = null, go = false) {
  Object.assign(state, { kind, id });
  state.offer = null;
  if (state.item >= 0) setItem(-1);
  showDetails(kind, id);
  const box = kind && boxOfSelection(kind, id);
  if (go && box) {
    const bounds = L.latLngBounds(latLng(box[0], box[1]), latLng(box[2], box[3]));
    const small = map.project(bounds.getNorthEast()).distanceTo(map.project(bounds.getSouthWest())) < 60;
    if (small || !map.getBounds().contains(bounds)) map.fitBounds(bounds.pad(0.8), { maxZoom: 3, animate: false });
  }
  scene.redraw();
  writeAddress();
}

function goTo(x, y) {
  map.setView(latLng(x, y), Math.max(map.getZoom(), 1), { animate: false });
}

function showPose(i) {
  const pose = i === null || i === undefined ? null : i;
  if (pose === state.pose) return;
  state.pose = pose;
  scene.redraw();
}

// --- a click: the topmost thing near it ------------------------------------------------------------

function inRing(ring, x, y) {
  let inside = false;
  for (let i = 0, j = ring.length - 2; i < ring.length; j = i, i += 2) {
    if (ring[i + 1] > y !== ring[j + 1] > y && x < ((ring[j] - ring[i]) * (y - ring[i + 1])) / (ring[j + 1] - ring[i + 1]) + ring[i]) inside = !inside;
  }
  return inside;
}

function toSegment(x, y, ax, ay, bx, by) {
  const dx = bx - ax, dy = by - ay, square = dx * dx + dy * dy;
  const t = square ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / square)) : 0;
  return Math.hypot(x - ax - t * dx, y - ay - t * dy);
}

function roadAt(x, y, reach) {
  let best = null, least = reach;
  for (let row = 0; row < roads.id.length; row++) {
    const [a, b, c, d] = roads.boxes[row];
    if (x < a - reach || x > c + reach || y < b - reach || y > d + reach) continue;
    for (let i = roads.offset[row]; i < roads.offset[row + 1] - 1; i++) {
      const distance = toSegment(x, y, roads.xy[2 * i], roads.xy[2 * i + 1], roads.xy[2 * i + 2], roads.xy[2 * i + 3]);
      if (distance < least) { least = distance; best = roads.id[row]; }
    }
  }
  return best;
}

function thingAt(x, y) {
  const px = 1 / map.getZoomScale(map.getZoom(), 0);
  if (points && layer("points").on) {
    for (let i = 0; i < points.label.length; i++) {
      if (Math.hypot(points.target[2 * i] - x, points.target[2 * i + 1] - y) < 9 * px) return ["point", String(i)];
    }
  }
  if (layer("review")?.on) {
    for (const id of reviewOf.keys()) {
      const at = placeOf(id);
      if (at && Math.hypot(at[0] - x, at[1] - y) < 8 * px) return ["lanelet", id];
    }
  }
  const hits = [];
  after?.boxes.forEach((box, row) => {
    if (x >= box[0] && x <= box[2] && y >= box[1] && y <= box[3] && inRing(after.rings[row], x, y)) hits.push(after.lanelets.id[row]);
  });
  if (hits.length) return ["lanelet", hits[(hits.indexOf(state.kind === "lanelet" ? state.id : null) + 1) % hits.length]];
  const way = roads && layer("roads").on ? roadAt(x, y, 8 * px) : null;
  return way ? ["way", way] : [null, null];
}

map.on("click", (event) => {
  $("found").hidden = true;
  if (pick) return choosePicked(event.latlng.lng, event.latlng.lat);
  return select(...thingAt(event.latlng.lng, event.latlng.lat));
});
map.on("mousemove", (event) => {
  const { lng: x, lat: y } = event.latlng, [lon, lat] = lonLat(x, y);
  $("readout").textContent = `x ${x.toFixed(DIGITS)}  y ${y.toFixed(DIGITS)} m   ${lat.toFixed(6)}, ${lon.toFixed(6)}   UTM ${data.frame.zone}`;
  if (!pick) return;
  const hover = roadAt(x, y, 14 / map.getZoomScale(map.getZoom(), 0));
  if (hover !== state.hover) { state.hover = hover; scene.redraw(); }
});

// --- review, step by step --------------------------------------------------------------------------

function openItems() {
  let open = 0;
  for (let i = 0; i < data.review.row.length; i++) if (isOpen(i)) open++;
  return open;
}

function setItem(i) {
  state.item = i;
  const total = data.review.row.length;
  $("stepper").hidden = total === 0;
  const open = openItems();
  $("step").textContent = i < 0 ? `${open} to review` : `${i + 1} of ${total}`;
}

function stepTo(i) {
  if (layer("review")) setLayer("review", true);
  choosing(null);
  setItem(i);
  // A change is about a way; where the report does not show it, a lanelet on it must do.
  const way = data.review.kind[i] === "change" ? data.changes.way[data.review.row[i]] : null;
  if (way && roads?.rowOf.has(way)) select("way", way, true);
  else select("lanelet", data.review.lanelet[i], true);
  setItem(i);
  const { subject, have, offer, why } = question(i), about = asked(i);
  state.offer = about.way_id;
  $("inspector").querySelector(".notice")?.remove();
  $("inspector").querySelector(".heading")?.after(el("div", { class: "question" },
    el("small", {}, `Review ${i + 1} of ${data.review.row.length} · ${KINDS[data.review.kind[i]]}`),
    el("p", {}, foreign(subject), data.review.kind[i] === "change" ? ": was " : ": map ", el("b", {}, have === "" ? "–" : foreign(have)), data.review.kind[i] === "change" ? ", is " : ", OSM ", el("b", {}, offer === "" ? "–" : foreign(offer))),
    el("p", { class: "reason" }, foreign(why)),
    decisionButtons(about)));
  scene.redraw();
  writeAddress();
}

function step(by) {
  const total = data.review.row.length;
  if (total) stepTo(state.item < 0 ? (by > 0 ? 0 : total - 1) : (state.item + by + total) % total);
}

$("next").addEventListener("click", () => step(1));
$("previous").addEventListener("click", () => step(-1));
$("decided").addEventListener("click", saveDecisions);
$("undo").addEventListener("click", () => travelDecisions(undone, redone));
$("redo").addEventListener("click", () => travelDecisions(redone, undone));
