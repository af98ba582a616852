// The terrain of layer.json in WebGL 2, without a library. Distances are metres, earth-centred;
// what is drawn is moved to the camera first, for float32 could not hold it otherwise.
import { RADIUS, Tiling, axes, cartesian, decode, normalsOf } from "./tiles.js";

const FIELD_OF_VIEW = Math.PI / 4;
const MOST_REQUESTS = 6;
const MOST_TILES = 800; // kept for when they are seen again
const PIXELS = [16, 8, 4, 2, 1]; // of error allowed on the screen, by detail

const VERTEX = `#version 300 es
layout(location = 0) in vec3 position; // on the ellipsoid, from the tile's centre
layout(location = 1) in vec3 up;
layout(location = 2) in vec3 normal;
layout(location = 3) in vec3 spot; // u, v, metres of the skirt
layout(location = 4) in float height;
uniform mat4 camera;
uniform vec3 centre;
uniform float exaggeration;
uniform float haze;
out vec2 share;
out vec3 shown; // metres, brightness, clearness
void main() {
  vec3 at = centre + position + up * (height * exaggeration - spot.z);
  float rise = dot(normal, up);
  vec3 slope = normalize((normal - up * rise) * exaggeration + up * max(rise, 1e-3));
  vec3 east = normalize(vec3(-up.y, up.x, 1e-9));
  vec3 light = -.5 * east + .5 * cross(up, east) + .7071 * up; // as rtin._tint has it
  float far = length(at) / haze;
  shown = vec3(height, .32 + .95 * max(dot(slope, light), 0.), exp(-far * far));
  share = spot.xy;
  gl_Position = camera * vec4(at, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec2 share;
in vec3 shown;
uniform int hidden; // quadrants that finer tiles cover
uniform vec2 range;
uniform vec4 ink; // of lines; alpha 0: the surface
uniform sampler2D tint; // left half: sea floor, right half: land
out vec4 colour;
bool covered(float x, float y) {
  return (hidden >> (int(share.x + x >= .5) + 2 * int(share.y + y >= .5)) & 1) == 1;
}
void main() {
  // A little lies under the finer tiles: not a ray of the background gets through.
  const float e = .002;
  if (covered(e, e) && covered(e, -e) && covered(-e, e) && covered(-e, -e)) discard;
  bool sea = range.x < 0. && range.y > 0.;
  float shore = sea ? 0. : range.x;
  float land = 1. + max(shown.x - shore, 0.) / (range.y - shore);
  float part = sea && shown.x < 0. ? 1. - shown.x / range.x : land;
  vec3 seen = texture(tint, vec2(clamp(part / 2., 0., 1.), .5)).rgb * shown.y;
  seen = mix(seen, ink.rgb, ink.a);
  colour = vec4(mix(vec3(.906, .933, .953), seen, shown.z), 1.);
}`;

// The colours of rtin._tint: share of the way up, red, green, blue.
const SEA = [[0, 33, 69, 115], [0.6, 84, 140, 184], [1, 179, 214, 230]];
const LAND = [
  [0, 115, 148, 107], [0.2, 153, 176, 120], [0.4, 209, 204, 148], [0.6, 194, 161, 115],
  [0.8, 158, 128, 105], [0.92, 199, 191, 184], [1, 247, 247, 247],
];

const element = (id) => document.getElementById(id);
const canvas = element("view");

function fail(text) {
  element("message").textContent = text;
  element("message").hidden = false;
  document.body.dataset.state = "failed";
  throw new Error(text);
}

// --- vectors and matrices (columns first, as WebGL has them) -------------------------------------

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const sum = (...terms) => [0, 1, 2].map((k) => terms.reduce((all, [f, a]) => all + f * a[k], 0));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => sum([1 / Math.hypot(...a), a]);

// --- tiles ---------------------------------------------------------------------------------------

class Tile {
  constructor(tiling, z, x, y) {
    Object.assign(this, { tiling, z, x, y, state: "unknown", seen: 0, children: null });
    const [lon, lat] = tiling.place(z, x, y, 0.5, 0.5);
    this.centre = cartesian(lon, lat, 0);
    const corners = [0, 0.5, 1].flatMap((u) => [0, 0.5, 1].map((v) => tiling.place(z, x, y, u, v)));
    const far = corners.map(([a, b]) => Math.hypot(...minus(cartesian(a, b, 0), this.centre)));
    this.radius = Math.max(...far);
    this.heights = [0, 0];
  }

  /** South-west, south-east, north-west, north-east; null where there is none. */
  family() {
    const { tiling, z, x, y } = this;
    const child = (i) => [z + 1, 2 * x + (i & 1), 2 * y + (i >> 1)];
    this.children ??= [0, 1, 2, 3].map((i) => (tiling.has(...child(i)) ? new Tile(tiling, ...child(i)) : null));
    return this.children;
  }

  async load(gl) {
    this.state = "loading";
    try {
      const response = await fetch(`${this.z}/${this.x}/${this.y}.terrain`);
      if (response.status === 503) return setTimeout(() => { this.state = "unknown"; wake(); }, 1000);
      if (!response.ok) return (this.state = "missing");
      this.build(gl, decode(await response.arrayBuffer()));
      this.state = "ready";
    } catch (error) {
      this.state = "missing";
      console.error(`tile ${this.z}/${this.x}/${this.y}: ${error.message}`);
    }
  }

  build(gl, mesh) {
    const count = mesh.u.length;
    const skirts = mesh.edges.reduce((all, edge) => all + edge.length, 0);
    const data = new Float32Array((count + skirts) * 13);
    const raised = new Float32Array(count * 3);
    this.heights = [Infinity, -Infinity];
    this.range = [Infinity, -Infinity]; // of what lies in the bounds: around them there may be zeros
    const widen = (span, value) => [Math.min(span[0], value), Math.max(span[1], value)];
    for (let i = 0; i < count; i++) {
      const [lon, lat] = this.tiling.place(this.z, this.x, this.y, mesh.u[i], mesh.v[i]);
      const [base, up] = [minus(cartesian(lon, lat, 0), this.centre), axes(lon, lat)[2]];
      data.set([...base, ...up, 0, 0, 0, mesh.u[i], mesh.v[i], 0, mesh.heights[i]], 13 * i);
      raised.set(sum([1, base], [mesh.heights[i], up]), 3 * i);
      this.heights = widen(this.heights, mesh.heights[i]);
      if (this.tiling.inBounds(lon, lat)) this.range = widen(this.range, mesh.heights[i]);
    }
    const normals = mesh.normals ?? normalsOf(raised, mesh.indices);
    for (let i = 0; i < count; i++) data.set(normals.subarray(3 * i, 3 * i + 3), 13 * i + 6);
    const walls = this.skirt(mesh, data);
    this.mesh = { u: mesh.u, v: mesh.v, heights: mesh.heights };
    this.triangles = mesh.indices.length / 3;
    this.vertices = count;
    this.upload(gl, data, mesh.indices, walls);
  }

  /** Walls below the four edges hide where tiles of two zooms meet. Return their triangles. */
  skirt(mesh, data) {
    const depth = 4 * this.tiling.geometricError(this.z);
    const walls = [];
    let next = mesh.u.length;
    mesh.edges.forEach((edge, side) => {
      const along = side % 2 ? mesh.u : mesh.v;
      const inOrder = [...edge].sort((a, b) => along[a] - along[b]);
      inOrder.forEach((vertex, i) => {
        data.copyWithin(13 * next, 13 * vertex, 13 * vertex + 13);
        data[13 * next + 11] = depth;
        if (i) walls.push(inOrder[i - 1], vertex, next - 1, vertex, next, next - 1);
        next++;
      });
    });
    return walls;
  }

  upload(gl, data, indices, walls) {
    this.array = gl.createVertexArray();
    this.buffers = [gl.createBuffer(), gl.createBuffer()];
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[0]);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    [[3, 0], [3, 3], [3, 6], [3, 9], [1, 12]].forEach(([size, from], i) => {
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, size, gl.FLOAT, false, 52, 4 * from);
    });
    const lines = new Uint32Array(2 * indices.length);
    for (let i = 0; i < indices.length; i++) lines.set([indices[i], indices[i % 3 === 2 ? i - 2 : i + 1]], 2 * i);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.buffers[1]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array([...indices, ...walls, ...lines]), gl.STATIC_DRAW);
    this.lengths = [indices.length + walls.length, lines.length];
  }

  forget(gl) {
    gl.deleteVertexArray(this.array);
    this.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    this.state = "unknown";
  }
}

// --- the camera turns about a place on the ground --------------------------------------------------

const eye = { lon: 0, lat: 0, ground: 0, distance: 1e7, heading: 0, tilt: 0.7 };
const controls = { exaggeration: 1, detail: 3, wireframe: false };

function look() {
  const [east, north, up] = axes(eye.lon, eye.lat);
  const target = cartesian(eye.lon, eye.lat, eye.ground * controls.exaggeration);
  const away = sum([-Math.sin(eye.heading), east], [-Math.cos(eye.heading), north]);
  const back = sum([Math.cos(eye.tilt), away], [Math.sin(eye.tilt), up]);
  const right = unit(cross(sum([Math.sin(eye.tilt), sum([-1, away])], [Math.cos(eye.tilt), up]), back));
  const top = cross(back, right);
  const position = sum([1, target], [eye.distance, back]);
  const aspect = canvas.width / canvas.height;
  const f = 1 / Math.tan(FIELD_OF_VIEW / 2);
  const [near, far] = [eye.distance / 200, eye.distance * 40 + 2e5];
  const [p, q] = [(near + far) / (near - far), (2 * near * far) / (near - far)];
  const column = (k) => [(f / aspect) * right[k], f * top[k], p * back[k], -back[k]];
  const matrix = [...column(0), ...column(1), ...column(2), 0, 0, q, 0];
  const planes = [[f / aspect, right], [-f / aspect, right], [f, top], [-f, top]].map(([g, axis]) =>
    unit(sum([-1, back], [g, axis])));
  return { position, matrix, planes, back };
}

function sees(view, tile) {
  const height = Math.max(...tile.heights.map(Math.abs)) * controls.exaggeration;
  const offset = minus(tile.centre, view.position);
  const inside = view.planes.every((plane) => dot(plane, offset) > -tile.radius - height);
  return { inside, distance: Math.max(Math.hypot(...offset) - tile.radius - height, eye.distance / 100) };
}

// --- choosing and drawing ------------------------------------------------------------------------

let frame = 0;
let asleep = true;
let loading = 0;

/** Collect what to draw of a tile and below, and what to load. Return whether it is covered. */
function choose(view, tile, pixels, draw, wanted) {
  const { inside, distance } = sees(view, tile);
  if (!inside) return true;
  tile.seen = frame;
  const error = (tile.tiling.geometricError(tile.z) * pixels) / distance;
  if (tile.state === "unknown") wanted.push([error, tile]);
  const skip = tile.z < tile.tiling.minzoom || tile.state === "missing";
  if (tile.state !== "ready" && !skip) return false;
  const finer = error > PIXELS[controls.detail] || skip ? tile.family() : [null, null, null, null];
  let hidden = 0;
  finer.forEach((child, i) => {
    if (child && choose(view, child, pixels, draw, wanted)) hidden |= 1 << i;
  });
  if (tile.state === "ready" && hidden !== 15) draw.push([tile, hidden]);
  return tile.state === "ready" || hidden === 15;
}

function start(gl, layer) {
  const tiling = new Tiling(layer);
  const roots = Array.from({ length: tiling.roots }, (_, x) => new Tile(tiling, 0, x, 0));
  const uniform = program(gl);
  const range = [Infinity, -Infinity];

  function paint() {
    asleep = true;
    frame++;
    resize(gl);
    const view = look();
    const [draw, wanted] = [[], []];
    const pixels = canvas.height / (2 * Math.tan(FIELD_OF_VIEW / 2));
    roots.forEach((root) => choose(view, root, pixels, draw, wanted));
    request(gl, wanted);
    measure(draw);
    const known = range[0] < range[1] ? range : [0, 1];
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(uniform.camera, false, view.matrix);
    gl.uniform1f(uniform.exaggeration, controls.exaggeration);
    gl.uniform2fv(uniform.range, known);
    gl.uniform1f(uniform.haze, Math.max(eye.distance * 12, 2e4));
    draw.forEach(([tile, hidden]) => paintTile(tile, hidden, view));
    tell(draw);
    if (frame % 60 === 0) roots.forEach((root) => tidy(gl, root));
  }

  function paintTile(tile, hidden, view) {
    const [surface, lines] = tile.lengths;
    gl.uniform3fv(uniform.centre, minus(tile.centre, view.position));
    gl.uniform1i(uniform.hidden, hidden);
    gl.bindVertexArray(tile.array);
    gl.uniform4f(uniform.ink, 0, 0, 0, 0);
    gl.drawElements(gl.TRIANGLES, surface, gl.UNSIGNED_INT, 0);
    if (!controls.wireframe) return;
    gl.uniform4f(uniform.ink, 0.08, 0.16, 0.2, 0.55);
    gl.drawElements(gl.LINES, lines, gl.UNSIGNED_INT, 4 * surface);
  }

  /** The colours span all heights seen so far; the camera turns about the ground. */
  function measure(draw) {
    for (const [tile] of draw) {
      range[0] = Math.min(range[0], tile.range[0]);
      range[1] = Math.max(range[1], tile.range[1]);
    }
    const fine = Math.max(...draw.map(([tile]) => tile.z));
    const below = draw.find(([tile]) => tile.z === fine && holds(tile, eye.lon, eye.lat));
    const rise = below ? heightNear(below[0], eye.lon, eye.lat) - eye.ground : 0;
    if (Math.abs(rise) < eye.distance / 500) return;
    eye.ground += rise / 4;
    wake();
  }

  wake = () => {
    if (asleep) requestAnimationFrame(paint);
    asleep = false;
  };
  frameBounds(layer.bounds ?? [-180, -90, 180, 90]);
  listen();
  wake();
}

/** The height of the vertex nearest to a place in a tile. */
function heightNear({ tiling, z, x, y, mesh }, lon, lat) {
  const [[west, south], [east, north]] = [tiling.place(z, x, y, 0, 0), tiling.place(z, x, y, 1, 1)];
  const [u, v] = [(lon - west) / (east - west), (lat - south) / (north - south)];
  let [best, nearest] = [0, Infinity];
  for (let i = 0; i < mesh.u.length; i++) {
    const away = Math.hypot(mesh.u[i] - u, mesh.v[i] - v);
    if (away < nearest) [best, nearest] = [i, away];
  }
  return mesh.heights[best];
}

let wake = () => {};

function holds(tile, lon, lat) {
  const [[west, south], [east, north]] = [tile.tiling.place(tile.z, tile.x, tile.y, 0, 0), tile.tiling.place(tile.z, tile.x, tile.y, 1, 1)];
  return west <= lon && lon < east && south <= lat && lat < north;
}

function request(gl, wanted) {
  wanted.sort(([a], [b]) => b - a);
  for (const [, tile] of wanted.slice(0, MOST_REQUESTS - loading)) {
    loading++;
    tile.load(gl).finally(() => { loading--; wake(); });
  }
  document.body.dataset.state = loading ? "loading" : "ready";
}

function tell(draw) {
  const triangles = draw.reduce((all, [tile]) => all + tile.triangles, 0);
  const zooms = draw.map(([tile]) => tile.z);
  const span = zooms.length ? ` · zoom ${Math.min(...zooms)} to ${Math.max(...zooms)}` : "";
  const more = loading ? ` · ${loading} loading` : "";
  element("counts").textContent = `${draw.length} tiles, ${triangles.toLocaleString("en")} triangles${span}${more}`;
  Object.assign(document.body.dataset, { tiles: draw.length, triangles });
}

/** Let go of tiles not seen for long, when there are many. */
function tidy(gl, root) {
  const all = [];
  const walk = (tile) => { all.push(tile); tile.children?.forEach((child) => child && walk(child)); };
  walk(root);
  const ready = all.filter((tile) => tile.state === "ready").sort((a, b) => a.seen - b.seen);
  ready.slice(0, Math.max(0, ready.length - MOST_TILES)).forEach((tile) => tile.seen < frame && tile.forget(gl));
}

function frameBounds([west, south, east, north]) {
  const radians = Math.PI / 180;
  eye.lon = ((west + east) / 2) * radians;
  eye.lat = ((south + north) / 2) * radians;
  const width = (east - west) * radians * Math.cos(eye.lat);
  const size = Math.min(Math.hypot(width, (north - south) * radians), 2) * RADIUS;
  eye.distance = Math.max(size * 1.15, 10);
}

// --- WebGL and input -----------------------------------------------------------------------------

function program(gl) {
  const linked = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(linked, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) fail(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(linked);
  gl.useProgram(linked);
  gl.enable(gl.DEPTH_TEST);
  gl.depthFunc(gl.LEQUAL);
  gl.enable(gl.POLYGON_OFFSET_FILL);
  gl.polygonOffset(2, 8);
  gl.clearColor(0.906, 0.933, 0.953, 1);
  paintTint(gl);
  const names = ["camera", "centre", "exaggeration", "hidden", "range", "ink", "haze"];
  return Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(linked, name)]));
}

function paintTint(gl) {
  const width = 1024;
  const pixels = new Uint8Array(4 * width).fill(255);
  for (let i = 0; i < width; i++) {
    const [stops, t] = i < width / 2 ? [SEA, i / (width / 2 - 1)] : [LAND, (i - width / 2) / (width / 2 - 1)];
    const k = Math.min(stops.findLastIndex(([at]) => at <= t), stops.length - 2);
    const part = (t - stops[k][0]) / (stops[k + 1][0] - stops[k][0]);
    for (let c = 0; c < 3; c++) pixels[4 * i + c] = stops[k][c + 1] * (1 - part) + stops[k + 1][c + 1] * part;
  }
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, width, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
}

function resize(gl) {
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((n) => Math.max(1, Math.round(n * devicePixelRatio)));
  if (canvas.width === width && canvas.height === height) return;
  [canvas.width, canvas.height] = [width, height];
  gl.viewport(0, 0, width, height);
}

function turn(dx, dy) {
  eye.heading += dx * 0.006;
  eye.tilt = Math.min(Math.max(eye.tilt + dy * 0.006, 0.08), Math.PI / 2 - 0.001);
}

function move(dx, dy) {
  const metres = (2 * eye.distance * Math.tan(FIELD_OF_VIEW / 2)) / canvas.clientHeight;
  const [right, ahead] = [(-dx * metres) / RADIUS, (dy * metres) / RADIUS / Math.max(Math.sin(eye.tilt), 0.3)];
  const [s, c] = [Math.sin(eye.heading), Math.cos(eye.heading)];
  eye.lon += (right * c + ahead * s) / Math.max(Math.cos(eye.lat), 0.05);
  eye.lon -= 2 * Math.PI * Math.round(eye.lon / (2 * Math.PI));
  eye.lat = Math.min(Math.max(eye.lat + ahead * c - right * s, -1.55), 1.55);
}

function zoomBy(factor) {
  eye.distance = Math.min(Math.max(eye.distance * factor, 5), 4 * RADIUS);
}

function listen() {
  const fingers = new Map();
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomBy(Math.exp(Math.max(-1, Math.min(1, event.deltaY * (event.deltaMode ? 0.05 : 0.0015)))));
    wake();
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  const lift = (event) => fingers.delete(event.pointerId);
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
    const spread = () => Math.hypot(...[0, 1].map((k) => [...fingers.values()].reduce((a, b) => a[k] - b[k]))) || 1;
    const before = fingers.size === 2 ? spread() : 1;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size === 2) { zoomBy(before / spread()); move(dx / 2, dy / 2); }
    else if (event.buttons & 2 || event.shiftKey) move(dx, dy);
    else turn(dx, dy);
    wake();
  });
  addEventListener("resize", () => wake());
  for (const name of ["exaggeration", "detail", "wireframe"]) {
    element(name).addEventListener("input", ({ target }) => {
      controls[name] = target.type === "checkbox" ? target.checked : Number(target.value);
      element("times").textContent = controls.exaggeration.toFixed(1);
      wake();
    });
  }
}

const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
if (!gl) fail("This page needs WebGL 2, which this browser lacks or has turned off.");
const response = await fetch("layer.json").catch(() => ({ ok: false }));
if (!response.ok) fail("This page shows quantized-mesh tiles, and the server has none: there is no layer.json.");
const layer = await response.json();
element("name").textContent = layer.name ?? "Terrain";
element("credit").textContent = layer.attribution ?? "";
start(gl, layer);
