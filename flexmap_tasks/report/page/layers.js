// Layers of the drive: what each draws, and what it is called. A layer: { id, group, name, swatch, count, on, draw }.

const layers = [];

function addLayer(layer) {
  layers.push({ on: false, ...layer });
}

const layer = (id) => layers.find((l) => l.id === id);

const QUALITIES = [
  ["fine", "σ up to 0.1 m"], ["fair", "σ up to 1 m"], ["poor", "σ over 1 m"], ["none", "no fix"], ["plain", "quality not given"], ["left-out", "left out by the alignment"],
];

/** Row of QUALITIES for a fix: by sigma where there is one, by status otherwise. */
function qualityOf(status, sigma) {
  if (status === -1) return 3;
  if (sigma >= 0) return sigma <= 0.1 ? 0 : sigma <= 1 ? 1 : 2;
  return status === 2 ? 0 : status === 1 ? 1 : status === 0 ? 2 : 4;
}

const gnss = { ...data.gnss, xy: metres(data.gnss.xy) };
gnss.quality = Uint8Array.from(gnss.status, (status, i) => (gnss.left_out[i] ? 5 : qualityOf(status, gnss.sigma[i])));
gnss.seen = [...new Set(gnss.quality)].sort();
const gaps = new Paths();
for (let i = 1; i < gnss.observed.length; i++) {
  if (!gnss.observed[i]) gaps.add(Array.from(gnss.xy.subarray(2 * i - 2, 2 * i + 2)), false);
}

const slam = { ...data.slam, before: metres(data.slam.before), after: metres(data.slam.after) };
const beforePaths = trackPaths(slam.before, () => false);
const afterPaths = trackPaths(slam.after, () => false);

function drawGnss(view) {
  gaps.stroke(view, inks.get("gnss-gap"), 1.5, [3, 4]);
  const { ctx, px } = view, size = Math.max(2.2, Math.min(5, 2 + view.k / 4)) * px;
  for (const quality of gnss.seen) {
    ctx.fillStyle = inks.get(`gnss-${QUALITIES[quality][0]}`);
    let lastX = Infinity, lastY = Infinity;
    for (let i = 0; i < gnss.quality.length; i++) {
      if (gnss.quality[i] !== quality) continue;
      const x = gnss.xy[2 * i], y = gnss.xy[2 * i + 1];
      if (Math.abs(x - lastX) < 0.7 * px && Math.abs(y - lastY) < 0.7 * px) continue;
      lastX = x;
      lastY = y;
      if (inView(view, x, y)) ctx.fillRect(x - size / 2, y - size / 2, size, size);
    }
  }
}

const sheet = data.sheet && { ...data.sheet, source: metres(data.sheet.source), target: metres(data.sheet.target) };
const sheetPaths = [new Paths(), new Paths()];
if (sheet) {
  for (let t = 0; t < sheet.triangles.length; t += 3) {
    for (const [which, xy] of [sheet.source, sheet.target].entries()) {
      const flat = [0, 1, 2].flatMap((i) => {
        const v = sheet.triangles[t + i];
        return [xy[2 * v], xy[2 * v + 1]];
      });
      sheetPaths[which].add(flat, true);
    }
  }
}

function drawSheet(view) {
  sheetPaths[1].fill(view, inks.get("sheet-fill"));
  sheetPaths[0].stroke(view, inks.get("sheet-before"), 1, [3, 3]);
  sheetPaths[1].stroke(view, inks.get("sheet"), 1.2);
}

const points = data.points && {
  ...data.points,
  source: metres(data.points.source), target: metres(data.points.target), moved: metres(data.points.moved),
};

/** Distances of control point i from its target, metres: as the rigid start and as the warp leaves it. */
function pointShift(i) {
  const d = (xy) => Math.hypot(points.target[2 * i] - xy[2 * i], points.target[2 * i + 1] - xy[2 * i + 1]);
  return { start: d(points.source), left: d(points.moved) };
}

function drawPoints(view) {
  for (let i = 0; i < points.label.length; i++) {
    const [sx, sy, tx, ty] = [points.source[2 * i], points.source[2 * i + 1], points.target[2 * i], points.target[2 * i + 1]];
    if (!inView(view, tx, ty, 200)) continue;
    const colour = inks.get(points.used[i] ? "point" : "point-unused");
    // At least 18 pixels long, so that the direction shows from afar.
    const length = Math.hypot(tx - sx, ty - sy), shown = Math.max(length, Math.min(18 * view.px, length * 20));
    if (length > 0) arrow(view, tx - (shown * (tx - sx)) / length, ty - (shown * (ty - sy)) / length, tx, ty, colour, 2.2);
    disc(view, tx, ty, 4.5, points.used[i] ? inks.get("point-fill") : null, colour, 2);
    label(view, points.label[i].slice(0, 24), tx, ty, 9, -7);
  }
}

/** Text beside a place, with a halo; offsets in pixels to the right and down. */
function label(view, text, x, y, right_px, down_px) {
  const { ctx } = view, at = ctx.getTransform().transformPoint({ x, y }), ratio = window.devicePixelRatio || 1;
  ctx.save();
  ctx.setTransform(ratio, 0, 0, ratio, at.x + right_px * ratio, at.y + down_px * ratio);
  ctx.font = "600 11px system-ui, sans-serif";
  ctx.lineWidth = 3;
  ctx.lineJoin = "round";
  ctx.strokeStyle = inks.get("map");
  ctx.strokeText(text, 0, 0);
  ctx.fillStyle = inks.get("text");
  ctx.fillText(text, 0, 0);
  ctx.restore();
}

const ties = data.ties && { fix: metres(data.ties.fix), place: metres(data.ties.place) };

function drawTies(view) {
  made("ties", () => {
    const paths = new Paths();
    for (let i = 0; i < ties.fix.length; i += 2) paths.add([ties.fix[i], ties.fix[i + 1], ties.place[i], ties.place[i + 1]], false);
    return paths;
  }).stroke(view, inks.get("ties"), 1.3);
  for (let i = 0; view.k >= 4 && i < ties.fix.length; i += 2) {
    if (inView(view, ties.fix[i], ties.fix[i + 1])) disc(view, ties.fix[i], ties.fix[i + 1], 2.2, inks.get("ties"), null);
  }
}

/** Arrows from where the rigid start leaves the drive to where the alignment has it, one every 40 pixels or 10 m. */
function drawCorrections(view) {
  const apart = Math.max(10, 40 * view.px);
  let last = -Infinity;
  for (let i = 0; i < slam.driven.length; i++) {
    if (slam.driven[i] - last < apart) continue;
    last = slam.driven[i];
    const [bx, by, ax, ay] = [slam.before[2 * i], slam.before[2 * i + 1], slam.after[2 * i], slam.after[2 * i + 1]];
    if (inView(view, ax, ay, 100)) arrow(view, bx, by, ax, ay, inks.get("sheet"), 1.4);
  }
}

const SIGMAS = [0.02, 0.05, 0.1, 0.2, Infinity];

function drawSigma(view) {
  made("sigma", () => SIGMAS.map((_, level) => trackPaths(slam.after, (i) => i === 0 || SIGMAS.findIndex((limit) => slam.sigma[i] <= limit) !== level)))
    .forEach((paths, level) => paths.stroke(view, inks.get(`sigma-${level}`), 5));
}
