// Pictures behind the map, from a server of web-map tiles (Web Mercator); nothing is asked of it until the layer is on.

const TILE_PX = 256, MOST_TILES = 80, EQUATOR_M = 2 * Math.PI * 6378137;
const pictures = new Map();

/** The place of a longitude and latitude in the map frame: Newton steps through the grid of `lonLat`. */
function placeOfLonLat(lon, lat, near) {
  let [x, y] = near;
  for (let i = 0; i < 3; i++) {
    const at = lonLat(x, y), east = lonLat(x + 50, y), north = lonLat(x, y + 50);
    const [a, b, c, d] = [(east[0] - at[0]) / 50, (north[0] - at[0]) / 50, (east[1] - at[1]) / 50, (north[1] - at[1]) / 50];
    const u = lon - at[0], v = lat - at[1], det = a * d - b * c;
    x += (d * u - b * v) / det;
    y += (a * v - c * u) / det;
  }
  return [x, y];
}

const tileX = (lon, z) => ((lon + 180) / 360) * 2 ** z;
const tileY = (lat, z) => ((1 - Math.asinh(Math.tan((lat * Math.PI) / 180)) / Math.PI) / 2) * 2 ** z;
const tileLon = (x, z) => (x / 2 ** z) * 360 - 180;
const tileLat = (y, z) => (Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / 2 ** z))) * 180) / Math.PI;

function picture(z, x, y) {
  const url = data.tiles.url.replace("{z}", z).replace("{x}", x).replace("{y}", y);
  if (!pictures.has(url)) {
    const image = new Image();
    image.referrerPolicy = "no-referrer";
    image.onload = () => scene.redraw();
    pictures.set(url, image);
    image.src = url;
  }
  const image = pictures.get(url);
  return image.complete && image.naturalWidth ? image : null;
}

function drawBackground(view) {
  const [x0, y0, x1, y1] = view.box, middle = [(x0 + x1) / 2, (y0 + y1) / 2], lat = lonLat(...middle)[1];
  const wanted = Math.log2((EQUATOR_M * Math.cos((lat * Math.PI) / 180) * view.k) / TILE_PX);
  let z = Math.max(0, Math.min(data.tiles.max_zoom, Math.round(wanted)));
  const corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(([x, y]) => lonLat(x, y));
  const range = () => {
    const xs = corners.map(([lon]) => tileX(lon, z)), ys = corners.map(([, l]) => tileY(l, z));
    return [Math.floor(Math.min(...xs)), Math.floor(Math.max(...xs)), Math.floor(Math.min(...ys)), Math.floor(Math.max(...ys))];
  };
  let [a, b, c, d] = range();
  while (z > 0 && (b - a + 1) * (d - c + 1) > MOST_TILES) { z--; [a, b, c, d] = range(); }
  for (let tx = a; tx <= b; tx++) for (let ty = c; ty <= d; ty++) {
    const image = picture(z, tx, ty);
    if (!image) continue;
    const nw = placeOfLonLat(tileLon(tx, z), tileLat(ty, z), middle), ne = placeOfLonLat(tileLon(tx + 1, z), tileLat(ty, z), nw);
    const sw = placeOfLonLat(tileLon(tx, z), tileLat(ty + 1, z), nw), size = image.naturalWidth;
    view.ctx.save();
    view.ctx.transform((ne[0] - nw[0]) / size, (ne[1] - nw[1]) / size, (sw[0] - nw[0]) / size, (sw[1] - nw[1]) / size, ...nw);
    view.ctx.drawImage(image, 0, 0);
    view.ctx.restore();
  }
}
