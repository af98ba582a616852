// Quantized-mesh tiles: where they lie, and what their bytes say.
// Source: the quantized-mesh-1.0 specification.

const A = 6378137.0; // WGS 84
const E2 = 0.00669437999014;

export const RADIUS = A;

/** Earth-centred x, y, z of a place; radians and metres. */
export function cartesian(lon, lat, height) {
  const n = A / Math.sqrt(1 - E2 * Math.sin(lat) ** 2);
  const r = (n + height) * Math.cos(lat);
  return [r * Math.cos(lon), r * Math.sin(lon), (n * (1 - E2) + height) * Math.sin(lat)];
}

/** East, north and up of a place. */
export function axes(lon, lat) {
  const [s, c, sl, cl] = [Math.sin(lat), Math.cos(lat), Math.sin(lon), Math.cos(lon)];
  return [[-sl, cl, 0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]];
}

/** How a layer.json cuts the world. */
export class Tiling {
  constructor(layer) {
    this.mercator = layer.projection === "EPSG:3857";
    this.roots = this.mercator ? 1 : 2;
    this.available = layer.available;
    this.maxzoom = layer.maxzoom ?? (layer.available ? layer.available.length - 1 : 30);
    this.minzoom = layer.minzoom ?? 0;
    this.bounds = (layer.bounds ?? [-180, -90, 180, 90]).map((degrees) => (degrees * Math.PI) / 180);
  }

  has(z, x, y) {
    if (z > this.maxzoom) return false;
    if (!this.available) return true;
    const holds = (r) => r.startX <= x && x <= r.endX && r.startY <= y && y <= r.endY;
    return (this.available[z] ?? []).some(holds);
  }

  inBounds(lon, lat) {
    const [west, south, east, north] = this.bounds;
    return west < lon && lon < east && south < lat && lat < north;
  }

  /** Metres that tiles of a zoom may be wrong, as CesiumJS assumes. */
  geometricError(z) {
    return (2 * Math.PI * A * 0.25) / (65 * this.roots) / 2 ** z;
  }

  /** The place at a share u, v of a tile, from its south-west corner. */
  place(z, x, y, u, v) {
    const lon = (2 * (x + u) / (this.roots * 2 ** z) - 1) * Math.PI;
    const edge = (row) => {
      const north = row / 2 ** z;
      return this.mercator ? Math.atan(Math.sinh((2 * north - 1) * Math.PI)) : (north - 0.5) * Math.PI;
    };
    return [lon, edge(y) + v * (edge(y + 1) - edge(y))]; // v goes by latitude in both
  }
}

/** Decode a tile: u, v, h in 0..1, heights in metres, indices, edges, normals (or null). */
export function decode(buffer) {
  const view = new DataView(buffer);
  const [low, high] = [view.getFloat32(24, true), view.getFloat32(28, true)];
  const count = view.getUint32(88, true);
  let at = 92;
  const running = () => {
    const values = new Float32Array(count);
    for (let i = 0, sum = 0; i < count; i++, at += 2) {
      const code = view.getUint16(at, true);
      sum += (code >> 1) ^ -(code & 1);
      values[i] = sum / 32767;
    }
    return values;
  };
  const [u, v, h] = [running(), running(), running()];
  const wide = count > 65536;
  const size = wide ? 4 : 2;
  at = Math.ceil(at / size) * size;
  const numbers = (n) => {
    const values = wide ? new Uint32Array(n) : new Uint16Array(n); // some writers count on wrapping
    for (let i = 0; i < n; i++, at += size) values[i] = wide ? view.getUint32(at, true) : view.getUint16(at, true);
    return values;
  };
  const length = () => (at += 4, view.getUint32(at - 4, true));
  const indices = numbers(3 * length());
  for (let i = 0, highest = 0; i < indices.length; i++) {
    const code = indices[i];
    indices[i] = highest - code;
    if (code === 0) highest++;
  }
  const edges = [0, 1, 2, 3].map(() => numbers(length()));
  let normals = null;
  while (at + 5 <= buffer.byteLength) {
    const [id, bytes] = [view.getUint8(at), view.getUint32(at + 1, true)];
    if (id === 1) normals = octDecode(new Uint8Array(buffer, at + 5, 2 * count));
    at += 5 + bytes;
  }
  return { u, v, heights: h.map((t) => low + t * (high - low)), indices, edges, normals };
}

function octDecode(bytes) {
  const normals = new Float32Array((bytes.length / 2) * 3);
  for (let i = 0; i < bytes.length / 2; i++) {
    let [x, y] = [(bytes[2 * i] / 255) * 2 - 1, (bytes[2 * i + 1] / 255) * 2 - 1];
    const z = 1 - Math.abs(x) - Math.abs(y);
    if (z < 0) [x, y] = [(1 - Math.abs(y)) * Math.sign(x || 1), (1 - Math.abs(x)) * Math.sign(y || 1)];
    const length = Math.hypot(x, y, z);
    normals.set([x / length, y / length, z / length], 3 * i);
  }
  return normals;
}

/** Normals of a surface that comes without: of its triangles, weighted by area. */
export function normalsOf(positions, indices) {
  const normals = new Float32Array(positions.length);
  for (let t = 0; t < indices.length; t += 3) {
    const [a, b, c] = [indices[t], indices[t + 1], indices[t + 2]].map((i) => 3 * i);
    const p = [0, 1, 2].map((k) => positions[b + k] - positions[a + k]);
    const q = [0, 1, 2].map((k) => positions[c + k] - positions[a + k]);
    const n = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
    for (const corner of [a, b, c]) for (let k = 0; k < 3; k++) normals[corner + k] += n[k];
  }
  for (let i = 0; i < normals.length; i += 3) {
    const length = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[i + k] /= length;
  }
  return normals;
}
