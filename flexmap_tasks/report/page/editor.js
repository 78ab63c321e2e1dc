// Control points as a person edits them: pairs, their history, and what the server says of them.

/** The pairs: { label, source: [x, y], target: [x, y], sigma, used }, metres in the map frame, after the rigid start. */
let pairs = points
  ? points.label.map((name, i) => ({
      label: name, source: [points.source[2 * i], points.source[2 * i + 1]], target: [points.target[2 * i], points.target[2 * i + 1]],
      sigma: Math.round(points.sigma[i] * 1e6) / 1e6, used: Boolean(points.used[i]),
    }))
  : [];
const past = [], future = [];
let saved = JSON.stringify(pairs), chosen = -1, drag = null, half = null, answer = null, verdict = null, asking = 0;

/** Change the pairs in a way that can be undone. */
function change(make) {
  past.push(JSON.stringify(pairs));
  future.length = 0;
  make();
  changed();
}

function travel(from, to) {
  if (!from.length) return;
  to.push(JSON.stringify(pairs));
  pairs = JSON.parse(from.pop());
  chosen = Math.min(chosen, pairs.length - 1);
  changed();
}

/** The nearest place of a track to (x, y), or null when it is further than `reach` metres. */
function onTrack(xy, x, y, reach) {
  let best = null, least = reach;
  for (let i = 0; i + 3 < xy.length; i += 2) {
    const [ax, ay, bx, by] = [xy[i], xy[i + 1], xy[i + 2], xy[i + 3]], dx = bx - ax, dy = by - ay, square = dx * dx + dy * dy;
    const t = square ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / square)) : 0;
    const distance = Math.hypot(x - ax - t * dx, y - ay - t * dy);
    if (distance < least) { least = distance; best = [ax + t * dx, ay + t * dy]; }
  }
  return best;
}

/** Where the sheet now in force takes a place of the rigid start: the shift of the nearest pose. */
function carried([x, y]) {
  let nearest = 0, least = Infinity;
  for (let i = 0; i < slam.before.length; i += 2) {
    const distance = Math.hypot(slam.before[i] - x, slam.before[i + 1] - y);
    if (distance < least) { least = distance; nearest = i; }
  }
  return [x + slam.after[nearest] - slam.before[nearest], y + slam.after[nearest + 1] - slam.before[nearest + 1]];
}

/** The partner on the GNSS line that the present sheet suggests for a place on the SLAM track. */
function suggested(source) {
  const place = carried(source);
  return onTrack(gnss.xy, ...place, 60) ?? place;
}

function freeName() {
  const names = new Set(pairs.map((pair) => pair.label));
  for (let i = pairs.length; ; i++) if (!names.has(`p${i}`)) return `p${i}`;
}

/** Ask the server; the address of the page holds the token. */
async function ask(what, body) {
  const reply = await fetch(what, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
  const told = await reply.json().catch(() => ({ error: `the server answered ${reply.status}` }));
  if (!reply.ok && !told.error) told.error = `the server answered ${reply.status}`;
  return told;
}

async function judge() {
  const mine = ++asking;
  const told = await ask("preview", { pairs }).catch(() => ({ error: "the server does not answer; is flexmap edit still running?" }));
  if (mine !== asking) return;
  answer = told;
  if (told.track) {
    slam.after = metres(column(told.track));
    layer("slam_after").draw = (view) => made("edited", () => trackPaths(slam.after, () => false)).stroke(view, inks.get("slam-after"), 2.6);
    lazy.edited = lazy.bent = undefined;
    if (told.sheet) reshape(told.sheet);
  }
  show();
}

function reshape(packed) {
  const fresh = decode(packed), source = metres(fresh.source), target = metres(fresh.target);
  const paths = [new Paths(), new Paths()];
  for (let t = 0; t < fresh.triangles.length; t += 3) {
    for (const [which, xy] of [source, target].entries()) {
      paths[which].add([0, 1, 2].flatMap((i) => [xy[2 * fresh.triangles[t + i]], xy[2 * fresh.triangles[t + i] + 1]]), true);
    }
  }
  sheetPaths[0] = paths[0];
  sheetPaths[1] = paths[1];
}

const handles = {
  on: true,
  draw(view) {
    pairs.forEach((pair, i) => {
      const colour = inks.get(pair.used ? "point" : "point-unused"), wide = i === chosen;
      arrow(view, ...pair.source, ...pair.target, colour, wide ? 3 : 2);
      disc(view, ...pair.source, wide ? 7 : 5, inks.get("slam-before"), inks.get("map"), 1.5);
      disc(view, ...pair.target, wide ? 7 : 5, inks.get("point-fill"), colour, 2.4);
      label(view, pair.label.slice(0, 24), ...pair.target, 10, -8);
    });
    if (half) {
      arrow(view, ...half.source, ...half.target, inks.get("selected"), 2);
      disc(view, ...half.source, 7, inks.get("slam-before"), inks.get("selected"), 2.4);
      disc(view, ...half.target, 7, null, inks.get("selected"), 2.4);
    }
  },
};
