// One canvas for all layers, in metres of the map frame; Leaflet moves it, zooms it and listens.

/** Colours of the theme, by the name of their custom property without the dashes. */
const inks = {
  cache: new Map(),
  get(name) {
    if (!this.cache.has(name)) {
      this.cache.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
    }
    return this.cache.get(name);
  },
};

const Scene = L.Renderer.extend({
  options: { padding: 0.35 },

  initialize(layers) {
    L.Renderer.prototype.initialize.call(this, {});
    this.layers = layers;
  },

  _initContainer() {
    this._container = document.createElement("canvas");
    this._container.setAttribute("aria-hidden", "true");
    this._ctx = this._container.getContext("2d");
  },

  _destroyContainer() {
    this._container.remove();
  },

  _updatePaths() {},

  _update() {
    if (this._map._animatingZoom && this._bounds) return;
    L.Renderer.prototype._update.call(this);
    const size = this._bounds.getSize(), ratio = window.devicePixelRatio || 1;
    L.DomUtil.setPosition(this._container, this._bounds.min);
    if (this._container.width !== Math.round(size.x * ratio) || this._container.height !== Math.round(size.y * ratio)) {
      this._container.width = Math.round(size.x * ratio);
      this._container.height = Math.round(size.y * ratio);
      this._container.style.width = `${size.x}px`;
      this._container.style.height = `${size.y}px`;
    }
    this.draw();
  },

  draw() {
    if (!this._bounds) return;
    const started = performance.now();
    const ctx = this._ctx, ratio = window.devicePixelRatio || 1;
    const k = this._map.getZoomScale(this._map.getZoom(), 0);
    const origin = this._map.getPixelOrigin().add(this._bounds.min);
    const size = this._bounds.getSize();
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.clearRect(0, 0, this._container.width, this._container.height);
    ctx.setTransform(k * ratio, 0, 0, -k * ratio, -origin.x * ratio, -origin.y * ratio);
    const view = {
      ctx, k, px: 1 / k,
      box: [origin.x / k, -(origin.y + size.y) / k, (origin.x + size.x) / k, -origin.y / k],
    };
    for (const layer of this.layers) {
      if (!layer.on) continue;
      ctx.save();
      layer.draw(view);
      ctx.restore();
    }
    this.lastDraw_ms = performance.now() - started;
  },

  redraw() {
    if (this._frame) return;
    this._frame = requestAnimationFrame(() => {
      this._frame = null;
      this.draw();
    });
  },
});

function meets(a, b) {
  return a[0] <= b[2] && a[2] >= b[0] && a[1] <= b[3] && a[3] >= b[1];
}

const CELL_M = 300;

/** Features that look alike as few paths, one per square of the plane, so that only what is in view is drawn. */
class Paths {
  constructor() {
    this.cells = new Map();
  }

  add(flat, closed) {
    const box = boxOf(flat);
    if (!(box[0] <= box[2])) return;
    const key = `${Math.floor(box[0] / CELL_M)},${Math.floor(box[1] / CELL_M)}`;
    let cell = this.cells.get(key);
    if (!cell) this.cells.set(key, (cell = { path: new Path2D(), box: [Infinity, Infinity, -Infinity, -Infinity] }));
    let pen = false;
    for (let i = 0; i < flat.length; i += 2) {
      if (Number.isNaN(flat[i])) pen = false;
      else if (pen) cell.path.lineTo(flat[i], flat[i + 1]);
      else { cell.path.moveTo(flat[i], flat[i + 1]); pen = true; }
    }
    if (closed) cell.path.closePath();
    cell.box = [Math.min(cell.box[0], box[0]), Math.min(cell.box[1], box[1]),
      Math.max(cell.box[2], box[2]), Math.max(cell.box[3], box[3])];
  }

  stroke(view, colour, width_px, dash_px = []) {
    view.ctx.strokeStyle = colour;
    view.ctx.lineWidth = width_px * view.px;
    view.ctx.lineJoin = "round";
    view.ctx.setLineDash(dash_px.map((d) => d * view.px));
    for (const cell of this.cells.values()) if (meets(cell.box, view.box)) view.ctx.stroke(cell.path);
    view.ctx.setLineDash([]);
  }

  fill(view, colour) {
    view.ctx.fillStyle = colour;
    for (const cell of this.cells.values()) if (meets(cell.box, view.box)) view.ctx.fill(cell.path);
  }
}

/** A track cut into paths of a few hundred points; `broken(i)` is true where no line leads to point i. */
function trackPaths(xy, broken) {
  const paths = new Paths();
  let part = [];
  for (let i = 0; i < xy.length / 2; i++) {
    if (part.length && (broken(i) || part.length > 500)) {
      const last = part.slice(-2);
      paths.add(part, false);
      part = broken(i) ? [] : last;
    }
    part.push(xy[2 * i], xy[2 * i + 1]);
  }
  if (part.length) paths.add(part, false);
  return paths;
}

function inView(view, x, y, margin_px = 20) {
  const margin = margin_px * view.px;
  return x >= view.box[0] - margin && x <= view.box[2] + margin && y >= view.box[1] - margin && y <= view.box[3] + margin;
}

function disc(view, x, y, radius_px, fill, stroke, width_px = 1.5) {
  const { ctx, px } = view;
  ctx.beginPath();
  ctx.arc(x, y, radius_px * px, 0, 2 * Math.PI);
  if (fill) { ctx.fillStyle = fill; ctx.fill(); }
  if (stroke) { ctx.strokeStyle = stroke; ctx.lineWidth = width_px * px; ctx.stroke(); }
}

/** An arrow from a to b, `exaggerate` times as long. */
function arrow(view, ax, ay, bx, by, colour, width_px = 2) {
  const { ctx, px } = view;
  const length = Math.hypot(bx - ax, by - ay);
  ctx.strokeStyle = ctx.fillStyle = colour;
  ctx.lineWidth = width_px * px;
  ctx.beginPath();
  ctx.moveTo(ax, ay);
  ctx.lineTo(bx, by);
  ctx.stroke();
  if (length < 3 * px) return;
  const head = Math.min(9 * px, 0.6 * length), ux = (bx - ax) / length, uy = (by - ay) / length;
  ctx.beginPath();
  ctx.moveTo(bx, by);
  ctx.lineTo(bx - head * ux + 0.4 * head * uy, by - head * uy - 0.4 * head * ux);
  ctx.lineTo(bx - head * ux - 0.4 * head * uy, by - head * uy + 0.4 * head * ux);
  ctx.closePath();
  ctx.fill();
}
