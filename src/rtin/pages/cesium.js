// The terrain of this server on CesiumJS's globe, with nothing from outside: no token, no imagery.
/* global Cesium */
const base = new URL(".", location.href).href;
const element = (id) => document.getElementById(id);
const LIGHT = { east: -0.5, north: 0.5, up: 0.7071 }; // from the north-west, as maps are lit
// Heights' colours as in rtin._tint: share of the way up, colour.
const TINT = [[0, "#73946b"], [0.2, "#99b078"], [0.4, "#d1cc94"], [0.6, "#c2a173"], [0.8, "#9e8069"], [0.92, "#c7bfb8"], [1, "#f7f7f7"]];

function globe() {
  const widget = new Cesium.CesiumWidget("cesium", { baseLayer: false, creditContainer: undefined });
  Object.assign(widget.scene.globe, {
    baseColor: Cesium.Color.fromCssColorString("#9db09a"),
    enableLighting: true,
    dynamicAtmosphereLighting: false,
    showGroundAtmosphere: false,
    depthTestAgainstTerrain: true,
  });
  widget.scene.highDynamicRange = false;
  return widget;
}

function ramp() {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [256, 1];
  const context = canvas.getContext("2d");
  const gradient = context.createLinearGradient(0, 0, 256, 0);
  TINT.forEach(([share, colour]) => gradient.addColorStop(share, colour));
  context.fillStyle = gradient;
  context.fillRect(0, 0, 256, 1);
  return canvas;
}

/** Lowest and highest of a few places, from tiles about as large as the bounds. */
async function heightRange(provider, rectangle, maxzoom) {
  const zoom = Math.max(0, Math.min(maxzoom, Math.floor(Math.log2(Math.PI / Math.max(rectangle.width, rectangle.height))) + 2));
  const places = [];
  // Seventeenths of the world are on no border between tiles, where availability counts both.
  for (let i = 1; i < 17; i++) for (let j = 1; j < 17; j++) {
    places.push(new Cesium.Cartographic(rectangle.west + (rectangle.width * i) / 17, rectangle.south + (rectangle.height * j) / 17));
  }
  // Around the terrain there may be coarser tiles only.
  const level = (place) => Math.min(zoom, provider.availability?.computeMaximumLevelAtPosition(place) ?? zoom);
  const levels = Map.groupBy(places, level);
  await Promise.all([...levels].map(([each, those]) => Cesium.sampleTerrain(provider, each, those)));
  const heights = places.map((place) => place.height ?? 0);
  return [Math.min(...heights), Math.max(...heights, Math.min(...heights) + 1)];
}

function light(scene, rectangle) {
  const middle = Cesium.Rectangle.center(rectangle);
  const frame = Cesium.Transforms.eastNorthUpToFixedFrame(Cesium.Cartographic.toCartesian(middle));
  const towards = new Cesium.Cartesian3(-LIGHT.east, -LIGHT.north, -LIGHT.up);
  const direction = Cesium.Matrix4.multiplyByPointAsVector(frame, towards, new Cesium.Cartesian3());
  scene.light = new Cesium.DirectionalLight({ direction: Cesium.Cartesian3.normalize(direction, direction), intensity: 1.6 });
}

function flyTo(camera, sphere) {
  const offset = new Cesium.HeadingPitchRange(0, Cesium.Math.toRadians(-38), sphere.radius * 2.4);
  const complete = () => { document.body.dataset.there = true; };
  camera.flyToBoundingSphere(sphere, { offset, duration: 1.5, complete });
}

async function showTerrain(widget, layer) {
  const provider = await Cesium.CesiumTerrainProvider.fromUrl(base, { requestVertexNormals: true });
  const rectangle = Cesium.Rectangle.fromDegrees(...(layer.bounds ?? [-180, -90, 180, 90]));
  widget.terrainProvider = provider;
  const [low, high] = await heightRange(provider, rectangle, layer.maxzoom ?? layer.available.length - 1);
  const material = Cesium.Material.fromType("ElevationRamp", { minimumHeight: low, maximumHeight: high, image: ramp() });
  widget.scene.globe.material = material;
  light(widget.scene, rectangle);
  flyTo(widget.camera, Cesium.BoundingSphere.fromRectangle3D(rectangle, Cesium.Ellipsoid.WGS84, (low + high) / 2));
  element("name").textContent = layer.name ?? "Terrain";
  element("credit").textContent = layer.attribution ?? "";
  return provider;
}

const json = async (url) => (await fetch(url)).json();

/** The tiles without children, files within files read as long as there are few. */
async function lastTiles(url) {
  const within = (tile, file) => (tile.children?.length ? tile.children.flatMap((each) => within(each, file)) : [{ tile, file }]);
  const read = async (file) => within((await json(file)).root, file);
  let last = await read(url);
  const isFile = ({ tile }) => tile.content?.uri.endsWith(".json");
  while (last.some(isFile) && last.length < 64) {
    last = (await Promise.all(last.map((each) => (isFile(each) ? read(new URL(each.tile.content.uri, each.file)) : [each])))).flat();
  }
  return last.map(({ tile }) => tile);
}

/** A sphere around the finest tiles: closer around the terrain than that of the root. */
async function sphereOf(tileset, url) {
  const regions = (await lastTiles(url)).map((tile) => tile.boundingVolume.region);
  if (!regions.every((region) => region)) return tileset.boundingSphere;
  return Cesium.BoundingSphere.fromBoundingSpheres(regions.map(([west, south, east, north, low, high]) =>
    Cesium.BoundingSphere.fromRectangle3D(new Cesium.Rectangle(west, south, east, north), Cesium.Ellipsoid.WGS84, (low + high) / 2)));
}

async function showModel(widget) {
  const [{ scene, camera }, url] = [widget, `${base}tileset.json`];
  const tileset = await Cesium.Cesium3DTileset.fromUrl(url, { maximumScreenSpaceError: 2 });
  scene.primitives.add(tileset);
  tileset.style = new Cesium.Cesium3DTileStyle({ color: "color('#b3a284')" });
  tileset.environmentMapManager.enabled = false; // the light is the sun's alone
  tileset.imageBasedLighting.imageBasedLightingFactor = new Cesium.Cartesian2(0.4, 0);
  for (const part of [scene.globe, scene.skyAtmosphere, scene.skyBox]) part.show = false;
  scene.backgroundColor = Cesium.Color.fromCssColorString("#e7eef3");
  const sphere = await sphereOf(tileset, url);
  light(scene, Cesium.Rectangle.fromCartesianArray([sphere.center]));
  tileset.loadProgress.addEventListener((requests, processing) => count(requests + processing));
  flyTo(camera, sphere);
  element("name").textContent = "3D Tiles";
  return tileset;
}

function count(left) {
  element("counts").textContent = left ? `${left} tiles to load` : "all tiles in sight are loaded";
  document.body.dataset.left = left;
}

function listen(widget) {
  element("exaggeration").addEventListener("input", ({ target }) => {
    widget.scene.verticalExaggeration = Number(target.value);
    element("times").textContent = Number(target.value).toFixed(1);
  });
  element("wireframe").addEventListener("input", ({ target }) => {
    // CesiumJS has no public way; its own inspector does this too.
    widget.scene.globe._surface.tileProvider._debug.wireframe = target.checked;
  });
  widget.scene.globe.tileLoadProgressEvent.addEventListener(count);
}

if (typeof Cesium === "undefined") {
  element("message").hidden = false;
} else {
  const widget = globe();
  listen(widget);
  const { terrain } = await json("health");
  const shown = terrain ? await showTerrain(widget, await json("layer.json")) : await showModel(widget);
  Object.assign(window, { widget, shown }); // for the console
  document.body.dataset.state = "ready";
}
