// The data of the page: base64 to typed arrays, text by row of one table.

const TYPES = { f4: Float32Array, f8: Float64Array, i4: Int32Array, i8: BigInt64Array, u1: Uint8Array };
const NOWHERE = -2147483648;

const raw = JSON.parse(document.getElementById("data").textContent);

function bytesOf(base64) {
  const text = atob(base64);
  const out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out.buffer;
}

/** A column: a typed array, or strings; 64-bit ids become strings, so that none is rounded. */
function column(packed) {
  const array = new TYPES[packed.t](bytesOf(packed.b));
  if (packed.text) return Array.from(array, (row) => raw.texts[row]);
  if (packed.t === "i8") return Array.from(array, String);
  return array;
}

function isColumn(value) {
  return value && typeof value === "object" && typeof value.b === "string" && value.t in TYPES;
}

/** Everything in a part of the data, columns decoded. */
function decode(value) {
  if (isColumn(value)) return column(value);
  if (Array.isArray(value) || value === null || typeof value !== "object") return value;
  const out = {};
  for (const [name, inner] of Object.entries(value)) out[name] = decode(inner);
  return out;
}

/** Whole millimetres x0, y0, x1, ... as metres; NaN where there is no place. */
function metres(xy) {
  const out = new Float64Array(xy.length);
  for (let i = 0; i < xy.length; i++) out[i] = xy[i] === NOWHERE ? NaN : xy[i] / 1000;
  return out;
}

const data = {};
for (const name of Object.keys(raw)) if (name !== "texts") data[name] = decode(raw[name]);

function rowsById(ids) {
  const rows = new Map();
  ids.forEach((id, row) => rows.set(id, row));
  return rows;
}

function rowsGrouped(ids) {
  const rows = new Map();
  ids.forEach((id, row) => (rows.has(id) ? rows.get(id).push(row) : rows.set(id, [row])));
  return rows;
}

/** Tags of element `row` as [key, value] pairs in the order of the map. */
function tagsOf(tags, row) {
  const out = [];
  for (let i = tags.offset[row]; i < tags.offset[row + 1]; i++) out.push([tags.key[i], tags.value[i]]);
  return out;
}

/** A map with its lines in metres and, per lanelet, a closed ring, a box and the middle of the road. */
function prepareMap(map) {
  if (!map) return null;
  const xy = metres(map.lines.xy);
  const { offset } = map.lines;
  const rings = map.lanelets.id.map((_, row) => {
    const left = walk(xy, offset, map.lanelets.left[row], map.lanelets.left_inverted[row]);
    const right = walk(xy, offset, map.lanelets.right[row], !map.lanelets.right_inverted[row]);
    return left.concat(right);
  });
  const half = rings.map((ring, row) => offset[map.lanelets.left[row] + 1] - offset[map.lanelets.left[row]]);
  return {
    lines: { ...map.lines, xy },
    lanelets: map.lanelets,
    rings,
    boxes: rings.map(boxOf),
    middles: rings.map((ring, row) => middleOf(ring, half[row])),
    rowOf: rowsById(map.lanelets.id),
  };
}

function walk(xy, offset, line, backwards) {
  const out = [];
  const from = offset[line], to = offset[line + 1];
  for (let i = from; i < to; i++) {
    const j = backwards ? to - 1 - (i - from) : i;
    out.push(xy[2 * j], xy[2 * j + 1]);
  }
  return out;
}

function boxOf(flat) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (let i = 0; i < flat.length; i += 2) {
    if (Number.isNaN(flat[i])) continue;
    box[0] = Math.min(box[0], flat[i]);
    box[1] = Math.min(box[1], flat[i + 1]);
    box[2] = Math.max(box[2], flat[i]);
    box[3] = Math.max(box[3], flat[i + 1]);
  }
  return box;
}

/** Halfway between the middles of both bounds. */
function middleOf(ring, leftCount) {
  const n = ring.length / 2;
  const a = Math.min(Math.floor(leftCount / 2), n - 1);
  const b = Math.min(leftCount + Math.floor((n - leftCount) / 2), n - 1);
  if (leftCount === 2 && n === 4) {
    return [(ring[0] + ring[2] + ring[4] + ring[6]) / 4, (ring[1] + ring[3] + ring[5] + ring[7]) / 4];
  }
  return [(ring[2 * a] + ring[2 * b]) / 2, (ring[2 * a + 1] + ring[2 * b + 1]) / 2];
}

const before = prepareMap(data.before);
const after = prepareMap(data.after);
const roads = data.roads && {
  ...data.roads,
  xy: metres(data.roads.xy),
  rowOf: rowsById(data.roads.id),
  boxes: data.roads.id.map((_, row) =>
    boxOf(metres(data.roads.xy.subarray(2 * data.roads.offset[row], 2 * data.roads.offset[row + 1])))),
};
const matchesOf = data.matches ? rowsGrouped(data.matches.lanelet) : new Map();
const matchesOfWay = data.matches ? rowsGrouped(data.matches.way) : new Map();
const transfersOf = data.transfers ? rowsGrouped(data.transfers.lanelet) : new Map();
const lanesOf = data.lane_check ? rowsById(data.lane_check.lanelet) : new Map();
const reviewOf = rowsGrouped(data.review.lanelet);
const sourceOf = new Map();
if (data.transfers) data.transfers.lanelet.forEach((id, row) => sourceOf.set(id, data.transfers.source[row]));

/** The id of the lanelet this one was cut from, or its own. */
function sourceId(id) {
  return sourceOf.get(id) ?? id;
}

/** Latitude and longitude in degrees of a place, interpolated in a grid (1 cm at 5 km). */
function lonLat(x, y) {
  const { low_m: low, high_m: high, grid, lonlat_deg: nodes } = data.frame;
  const u = ((x - low[0]) / (high[0] - low[0])) * (grid - 1);
  const v = ((y - low[1]) / (high[1] - low[1])) * (grid - 1);
  const i = Math.max(0, Math.min(grid - 2, Math.floor(u)));
  const j = Math.max(0, Math.min(grid - 2, Math.floor(v)));
  const at = (a, b) => nodes[(j + b) * grid + i + a];
  return [0, 1].map((k) =>
    (at(0, 0)[k] * (1 - (u - i)) + at(1, 0)[k] * (u - i)) * (1 - (v - j)) +
    (at(0, 1)[k] * (1 - (u - i)) + at(1, 1)[k] * (u - i)) * (v - j));
}
