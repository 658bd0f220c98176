// The map: the road, what was driven on it in colours, and where episodes ended.

const VIRIDIS = ["#482576", "#3e4c8a", "#2a788e", "#22a884", "#7ad151", "#fde725"];
const SIDES = ["#0b63c4", "#6aa7e8", "#a9afb6", "#ee9b62", "#c44900"];
// Names of colours in page.css, which has a light and a dark one for each.
const LAP_COLORS = [1, 2, 3, 4, 5, 6, 7, 8].map((n) => `--lap${n}`);
const FAST_COLORS = [1, 2, 3, 4, 5].map((n) => `--fast${n}`);
const WORST_COLORS = [1, 2, 3, 4, 5].map((n) => `--worst${n}`);
const END_COLORS = {
  lap_complete: "--end1",
  off_track: "--end2",
  crashed: "--end3",
  reversed: "--end4",
  immobilized: "--end5",
};
const OTHER_END = "--edge";

const RAMPS = { plain: ramp(VIRIDIS), sides: ramp(SIDES) };

/** What the laps and cells may be coloured by: its colours and the values at their two ends. */
function colorScale(map, name) {
  const sides = name === "steering" || name === "slip";
  const [low, high] = map.limits[name];
  const colors = sides ? RAMPS.sides : RAMPS.plain;
  const of = (value) => {
    if (Number.isNaN(value)) return null;
    const part = high > low ? (value - low) / (high - low) : 0.5;
    return colors[Math.min(Math.max(Math.floor(part * 64), 0), 63)];
  };
  return { low, high, colors, of };
}

/** Numbers of the map in typed arrays; `first[k]` to `first[k + 1]` are the steps of lap k. */
function unpackMap(packed) {
  const columns = (group) =>
    Object.fromEntries(Object.entries(group).map(([key, value]) => [key, unpack(value)]));
  const map = { ...packed, steps: columns(packed.steps), laps: columns(packed.laps) };
  map.ends = columns(packed.ends);
  map.cells = {
    ...packed.cells,
    x: unpack(packed.cells.x),
    y: unpack(packed.cells.y),
    periods: packed.cells.periods.map(columns),
  };
  map.road = packed.road && columns(packed.road);
  return map;
}

function drawCells(ctx, camera, map, period, name) {
  const values = map.cells.periods[period][name],
    scale = colorScale(map, name);
  const size = Math.max(map.cells.size * camera.scale, 1) + 0.6;
  for (let i = 0; i < values.length; i++) {
    const ink = scale.of(values[i]);
    if (ink === null) continue;
    ctx.fillStyle = ink;
    ctx.fillRect(
      camera.x(map.cells.x[i]) - size / 2,
      camera.y(map.cells.y[i]) - size / 2,
      size,
      size,
    );
  }
}

/** A lap up to a step, in one colour or in those of a scale. */
function drawLap(ctx, camera, map, lap, until, ink, scaleName, width) {
  const { x, y } = map.steps,
    first = map.first[lap];
  const scale = scaleName && colorScale(map, scaleName),
    values = scaleName && map.steps[scaleName];
  ctx.lineWidth = width;
  ctx.lineJoin = ctx.lineCap = "round";
  if (!scale) {
    ctx.strokeStyle = ink;
    ctx.beginPath();
    for (let i = first; i <= until; i++) {
      if (i === first) ctx.moveTo(camera.x(x[i]), camera.y(y[i]));
      else ctx.lineTo(camera.x(x[i]), camera.y(y[i]));
    }
    ctx.stroke();
    return;
  }
  for (let i = first + 1; i <= until; i++) {
    const found = scale.of(values[i]);
    if (found === null) continue;
    ctx.strokeStyle = found;
    ctx.beginPath();
    ctx.moveTo(camera.x(x[i - 1]), camera.y(y[i - 1]));
    ctx.lineTo(camera.x(x[i]), camera.y(y[i]));
    ctx.stroke();
  }
}

function drawEnds(ctx, camera, map, wanted) {
  const ends = map.ends,
    radius = wanted.length > 2000 ? 2.2 : 3.4;
  const inks = map.statuses.map((name) => color(END_COLORS[name] || OTHER_END));
  ctx.strokeStyle = color("--paper");
  ctx.lineWidth = 0.8;
  for (const i of wanted) {
    ctx.fillStyle = inks[ends.status[i]];
    ctx.beginPath();
    ctx.arc(camera.x(ends.x[i]), camera.y(ends.y[i]), radius, 0, 7);
    ctx.fill();
    ctx.stroke();
  }
}
