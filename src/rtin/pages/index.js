// What is served, in words.
const base = new URL(".", location.href).href;
const facts = document.getElementById("facts");

function fact(name, value) {
  const [term, text] = [document.createElement("dt"), document.createElement("dd")];
  term.textContent = name;
  text.textContent = value;
  facts.append(term, text);
}

function degrees([west, south, east, north]) {
  const side = (value, plus, minus) => `${Math.abs(value).toFixed(3)}° ${value < 0 ? minus : plus}`;
  return `${side(west, "E", "W")} to ${side(east, "E", "W")}, ${side(south, "N", "S")} to ${side(north, "N", "S")}`;
}

const { terrain } = await (await fetch("health")).json();
if (terrain) {
  const layer = await (await fetch("layer.json")).json();
  if (layer.name) document.getElementById("name").textContent = layer.name;
  if (layer.description) document.getElementById("about").textContent = layer.description;
  if (layer.bounds) fact("Bounds", degrees(layer.bounds));
  fact("Zooms", `${layer.minzoom ?? 0} to ${layer.maxzoom ?? layer.available.length - 1}`);
  fact("Projection", layer.projection ?? "EPSG:4326");
  if (layer.attribution) fact("Attribution", layer.attribution);
  document.getElementById("snippet").textContent =
    `viewer.terrainProvider = await Cesium.CesiumTerrainProvider.fromUrl(\n  "${base}",\n  { requestVertexNormals: true },\n);`;
} else {
  document.getElementById("snippet").textContent =
    `viewer.scene.primitives.add(\n  await Cesium.Cesium3DTileset.fromUrl("${base}tileset.json", { maximumScreenSpaceError: 2 }),\n);`;
}
