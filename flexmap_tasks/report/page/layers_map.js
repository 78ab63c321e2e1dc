// Layers of the maps and of what conflation decided; then all layers in the order in which they are drawn.

const CONFIDENCES = [0.5, 0.65, 0.8, 0.9, 1.01];
const VERDICTS = ["agree", "differ", "unknown", "unmatched"];
const ACTIONS = ["set", "keep", "review", "split", "remove"];

/** Paths of a map's lines: bounds that are drawn on the road, all others (virtual, furniture) apart. */
function linePaths(map) {
  const out = { painted: new Paths(), other: new Paths() };
  const { offset, xy, kind } = map.lines;
  kind.forEach((name, row) => {
    const flat = Array.from(xy.subarray(2 * offset[row], 2 * offset[row + 1]));
    (/^(line_|road_border|curbstone|guard_rail|fence|wall)/.test(name) ? out.painted : out.other).add(flat, false);
  });
  return out;
}

const lazy = {};
/** Made when first needed. */
function made(name, make) {
  return (lazy[name] ??= make());
}

function ringPaths(rows) {
  const out = new Paths();
  for (const row of rows) out.add(after.rings[row], true);
  return out;
}

function drawAfter(view) {
  const all = made("after", () => ringPaths(after.rings.keys())), lines = made("afterLines", () => linePaths(after));
  all.fill(view, inks.get("lane-fill"));
  if (view.k < 0.25) return all.stroke(view, inks.get("lane-line"), 0.7);
  lines.other.stroke(view, inks.get("lane-other"), 0.8, [4, 3]);
  return lines.painted.stroke(view, inks.get("lane-line"), 1);
}

function drawBefore(view) {
  const lines = made("beforeLines", () => linePaths(before));
  lines.other.stroke(view, inks.get("before"), 0.8);
  lines.painted.stroke(view, inks.get("before"), 0.9);
}

function roadPaths() {
  const out = new Paths();
  roads.id.forEach((_, row) => out.add(Array.from(roads.xy.subarray(2 * roads.offset[row], 2 * roads.offset[row + 1])), false));
  return out;
}

function drawRoads(view) {
  const all = made("roads", roadPaths);
  all.stroke(view, inks.get("road-edge"), 4.5);
  all.stroke(view, inks.get("road"), 2.2);
}

const links = data.links && { ...data.links, lane: metres(data.links.lane), way: metres(data.links.way) };

function linkPaths() {
  const out = CONFIDENCES.map(() => new Paths());
  links.row.forEach((row, i) => {
    const confidence = data.matches.confidence[row];
    out[CONFIDENCES.findIndex((limit) => confidence < limit)].add(
      [links.lane[2 * i], links.lane[2 * i + 1], links.way[2 * i], links.way[2 * i + 1]], false);
  });
  return out;
}

function drawLinks(view) {
  made("links", linkPaths).forEach((paths, i) => paths.stroke(view, inks.get(`confidence-${i}`), 1.8));
}

function verdictRows() {
  const rows = Object.fromEntries(VERDICTS.map((verdict) => [verdict, []]));
  data.lane_check.lanelet.forEach((id, i) => {
    const row = after.rowOf.get(id);
    if (row !== undefined) rows[data.lane_check.verdict[i]]?.push(row);
  });
  return Object.fromEntries(VERDICTS.map((verdict) => [verdict, ringPaths(rows[verdict])]));
}

function drawLanes(view) {
  const paths = made("lanes", verdictRows);
  for (const verdict of ["unmatched", "unknown", "agree", "differ"]) {
    if (view.k < 0.6) {
      // From afar a lane is thinner than its outline: one stroke in the colour of the verdict.
      paths[verdict].stroke(view, inks.get(`lanes-${verdict}-edge`), verdict === "unmatched" ? 5 : verdict === "differ" ? 5.5 : 3.5);
      paths[verdict].stroke(view, inks.get(verdict === "unmatched" ? "lanes-unmatched" : `lanes-${verdict}`), 3);
      continue;
    }
    paths[verdict].fill(view, inks.get(`lanes-${verdict}`));
    paths[verdict].stroke(view, inks.get(`lanes-${verdict}-edge`), verdict === "differ" ? 1.6 : 0.9);
  }
}

/** Which decisions are shown; a set of actions and an attribute, "" for all. */
const filter = { key: "", actions: new Set(["set"]) };

function passes(row) {
  return filter.actions.has(data.transfers.action[row]) && (filter.key === "" || data.transfers.key[row] === filter.key);
}

function changedPaths() {
  const hits = new Map();
  data.transfers.lanelet.forEach((id, i) => {
    const row = after.rowOf.get(id);
    if (row !== undefined && passes(i)) hits.set(row, (hits.get(row) ?? 0) + 1);
  });
  const classes = [[], [], []];
  for (const [row, count] of hits) classes[Math.min(count, 3) - 1].push(row);
  return classes.map(ringPaths);
}

function drawChanged(view) {
  made("changed", changedPaths).forEach((paths, i) => {
    if (view.k < 0.6) return paths.stroke(view, inks.get(`changed-far-${i}`), 3.5);
    paths.fill(view, inks.get(`changed-${i}`));
    return paths.stroke(view, inks.get("changed-edge"), 0.8);
  });
}

/** Where a lanelet lies: its middle in the finished map, or where it was before it was taken out. */
function placeOf(id) {
  const map = after?.rowOf.has(id) ? after : before?.rowOf.has(id) ? before : null;
  return map && map.middles[map.rowOf.get(id)];
}

function drawReview(view) {
  for (const [id, items] of reviewOf) {
    const at = placeOf(id);
    if (!at || !inView(view, ...at)) continue;
    const open = items.some(isOpen), far = view.k < 0.6;
    if (open) disc(view, ...at, far ? 3.6 : 6.5, inks.get("review"), inks.get("map"), far ? 0.9 : 1.6);
    else disc(view, ...at, far ? 3 : 5, inks.get("map"), inks.get("act-set"), far ? 1.4 : 2.4);
    if (view.k >= 1.2 && items.length > 1) label(view, String(items.length), ...at, 9, -6);
  }
}

const findings = data.findings && { ...data.findings, xy: metres(data.findings.xy) };

function placeOfFinding(row) {
  if (!Number.isNaN(findings.xy[2 * row])) return [findings.xy[2 * row], findings.xy[2 * row + 1]];
  if (findings.primitive[row] === "lanelet") return placeOf(findings.id[row]);
  if (findings.primitive[row] !== "road" || !roads?.rowOf.has(findings.id[row])) return null;
  const road = roads.rowOf.get(findings.id[row]);
  const middle = Math.floor((roads.offset[road] + roads.offset[road + 1]) / 2);
  return [roads.xy[2 * middle], roads.xy[2 * middle + 1]];
}

const changePlaces = data.changes ? metres(data.changes.xy) : [];

/** A square on the middle of every way that OSM changed, the way itself in the same colour. */
function drawChanges(view) {
  const { ctx, px } = view, c = data.changes;
  made("osmChanges", () => {
    const paths = new Paths();
    for (const way of new Set(c.way)) if (roads?.rowOf.has(way)) paths.add(courseOf(way), false);
    return paths;
  }).stroke(view, inks.get("changes"), 3.2);
  for (let row = 0; row < c.way.length; row++) {
    const x = changePlaces[2 * row], y = changePlaces[2 * row + 1], r = 5 * px;
    if (!inView(view, x, y)) continue;
    ctx.fillStyle = inks.get(c.kind[row] === "gone" ? "changes-gone" : c.kind[row] === "new" ? "changes-new" : "changes");
    ctx.fillRect(x - r, y - r, 2 * r, 2 * r);
    ctx.strokeStyle = inks.get("map");
    ctx.lineWidth = 1.4 * px;
    ctx.strokeRect(x - r, y - r, 2 * r, 2 * r);
  }
}

function drawFindings(view) {
  const { ctx, px } = view;
  for (let row = 0; row < findings.id.length; row++) {
    const at = placeOfFinding(row);
    if (!at || !inView(view, ...at)) continue;
    const r = 7 * px;
    ctx.beginPath();
    ctx.moveTo(at[0], at[1] + r);
    ctx.lineTo(at[0] + r, at[1] - 0.75 * r);
    ctx.lineTo(at[0] - r, at[1] - 0.75 * r);
    ctx.closePath();
    ctx.fillStyle = inks.get(`finding-${findings.severity[row]}`) || inks.get("finding-info");
    ctx.fill();
    ctx.strokeStyle = inks.get("map");
    ctx.lineWidth = 1.4 * px;
    ctx.stroke();
  }
}

if (data.tiles) addLayer({ id: "background", group: "Maps", name: "Background", swatch: "background", count: NaN, draw: drawBackground });
if (roads) addLayer({ id: "roads", group: "Maps", name: "OSM roads", swatch: "road", count: roads.id.length, draw: drawRoads });
if (before) addLayer({ id: "before", group: "Maps", name: "HD map, rigid start", swatch: "before", count: before.lanelets.id.length, draw: drawBefore });
if (after) addLayer({ id: "after", group: "Maps", name: "HD map, finished", swatch: "after", count: after.lanelets.id.length, draw: drawAfter });
if (data.lane_check) addLayer({ id: "lanes", group: "Conflation", name: "Lane check", swatch: "lanes", count: data.lane_check.lanelet.length, draw: drawLanes });
if (data.transfers) addLayer({ id: "changed", group: "Conflation", name: "Attribute decisions", swatch: "changed", count: 0, draw: drawChanged });
if (sheet) addLayer({ id: "sheet", group: "Drive", name: "Rubber sheet", swatch: "sheet", count: sheet.triangles.length / 3, draw: drawSheet });
addLayer({ id: "gnss", group: "Drive", name: "GNSS by quality", swatch: "gnss", count: data.gnss.count, draw: drawGnss });
addLayer({ id: "slam_before", group: "Drive", name: "SLAM, rigid start", swatch: "slam-before", count: data.slam.count, draw: (view) => beforePaths.stroke(view, inks.get("slam-before"), 2.4, [7, 5]) });
addLayer({ id: "slam_after", group: "Drive", name: "SLAM, aligned", swatch: "slam-after", count: data.slam.count, draw: (view) => afterPaths.stroke(view, inks.get("slam-after"), 2.6) });
if (slam.sigma.some((v) => v >= 0)) addLayer({ id: "sigma", group: "Drive", name: "Predicted σ", swatch: "sigma", count: data.slam.count, draw: drawSigma });
if (!sheet && data.slam.count) addLayer({ id: "corrections", group: "Drive", name: "Pose corrections", swatch: "corrections", count: data.slam.count, draw: drawCorrections });
if (ties) addLayer({ id: "ties", group: "Drive", name: "Correspondences", swatch: "ties", count: ties.fix.length / 2, draw: drawTies });
if (data.changes?.way.length) addLayer({ id: "changes", group: "Conflation", name: "OSM changes", swatch: "changes", count: data.changes.way.length, draw: drawChanges });
if (links) addLayer({ id: "links", group: "Conflation", name: "Match links", swatch: "links", count: data.matches.lanelet.length, draw: drawLinks });
if (data.review.row.length) addLayer({ id: "review", group: "Conflation", name: "Review items", swatch: "review", count: data.review.row.length, draw: drawReview });
if (findings?.id.length) addLayer({ id: "findings", group: "Conflation", name: "Findings", swatch: "finding", count: findings.id.length, draw: drawFindings });
if (points) addLayer({ id: "points", group: "Drive", name: "Control points", swatch: "point", count: points.label.length, draw: drawPoints });

const VIEWS = [
  ["Overview", ["roads", "after", "slam_after", "review", "points"]],
  ["Alignment", ["before", "after", "gnss", "slam_before", "slam_after", "points", "sheet", "corrections"]],
  ["Matching", ["roads", "after", "links"]],
  ["Lanes", ["roads", "lanes", "after"]],
  ["Attributes", ["roads", "after", "changed", "review"]],
];
