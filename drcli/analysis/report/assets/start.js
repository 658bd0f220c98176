// Starts all parts.

for (const start of [startTheme, startCopyButtons, startGraphs]) {
  attempt(document.querySelector("header"), start);
}
const mapRoom = document.getElementById("map");
if (mapRoom) attempt(mapRoom, () => startMap(mapRoom));
