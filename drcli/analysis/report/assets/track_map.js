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
const CAR_M = 0.3;

/** 64 colours between the given ones. */
function ramp(stops) {
  const parts = stops.map((stop) => [1, 3, 5].map((at) => parseInt(stop.slice(at, at + 2), 16)));
  return Array.from({ length: 64 }, (_, i) => {
    const at = (i / 63) * (parts.length - 1),
      low = Math.min(Math.floor(at), parts.length - 2);
    const mixed = parts[low].map((part, k) =>
      Math.round(part + (at - low) * (parts[low + 1][k] - part)),
    );
    return `rgb(${mixed.join(",")})`;
  });
}

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

/** Turns metres into pixels of the canvas: the whole track, or a part of it. */
class Camera {
  constructor([x0, y0, x1, y1]) {
    Object.assign(this, { x0, y0, x1, y1, zoom: 1 });
    this.centre = [(x0 + x1) / 2, (y0 + y1) / 2];
  }

  /** Height for a width, in pixels of the page. */
  height(width, most) {
    const wanted = (width * (this.y1 - this.y0)) / (this.x1 - this.x0);
    return Math.round(Math.min(Math.max(wanted, width * 0.35, 200), most));
  }

  fit(width, height) {
    this.width = width;
    this.tall = height;
    this.scale = this.zoom * Math.min(width / (this.x1 - this.x0), height / (this.y1 - this.y0));
  }

  x(metres) {
    return this.width / 2 + (metres - this.centre[0]) * this.scale;
  }
  y(metres) {
    return this.tall / 2 - (metres - this.centre[1]) * this.scale;
  }

  metres(px, py) {
    return [
      this.centre[0] + (px - this.width / 2) / this.scale,
      this.centre[1] - (py - this.tall / 2) / this.scale,
    ];
  }

  zoomBy(factor) {
    this.zoom = Math.min(Math.max(this.zoom * factor, 1), 12);
    if (this.zoom === 1) this.reset();
  }

  reset() {
    this.zoom = 1;
    this.centre = [(this.x0 + this.x1) / 2, (this.y0 + this.y1) / 2];
  }

  pan(px, py) {
    const inside = (value, low, high) => Math.min(Math.max(value, low), high);
    this.centre = [
      inside(this.centre[0] - px / this.scale, this.x0, this.x1),
      inside(this.centre[1] + py / this.scale, this.y0, this.y1),
    ];
  }
}

function tracePath(ctx, camera, xs, ys, closed) {
  ctx.beginPath();
  for (let i = 0; i < xs.length; i++) {
    if (i) ctx.lineTo(camera.x(xs[i]), camera.y(ys[i]));
    else ctx.moveTo(camera.x(xs[i]), camera.y(ys[i]));
  }
  if (closed) ctx.closePath();
}

function drawRoad(ctx, camera, map) {
  const road = map.road;
  if (!road) return;
  // Piece by piece between the borders: right for open tracks and for those that cross themselves.
  ctx.fillStyle = ctx.strokeStyle = color("--road");
  ctx.lineWidth = 1;
  const n = road.inner_x.length;
  for (let i = 0; i + 1 < n + (map.closed ? 1 : 0); i++) {
    const j = (i + 1) % n;
    ctx.beginPath();
    ctx.moveTo(camera.x(road.inner_x[i]), camera.y(road.inner_y[i]));
    ctx.lineTo(camera.x(road.inner_x[j]), camera.y(road.inner_y[j]));
    ctx.lineTo(camera.x(road.outer_x[j]), camera.y(road.outer_y[j]));
    ctx.lineTo(camera.x(road.outer_x[i]), camera.y(road.outer_y[i]));
    ctx.closePath();
    ctx.fill();
    ctx.stroke();
  }
}

function drawBorders(ctx, camera, map) {
  const road = map.road;
  if (!road) return;
  ctx.strokeStyle = color("--edge");
  ctx.lineWidth = 1.2;
  for (const side of ["inner", "outer"]) {
    tracePath(ctx, camera, road[`${side}_x`], road[`${side}_y`], map.closed);
    ctx.stroke();
  }
  ctx.setLineDash([4, 5]);
  ctx.lineWidth = 0.8;
  tracePath(ctx, camera, road.center_x, road.center_y, map.closed);
  ctx.stroke();
  ctx.setLineDash([]);
  drawWaypoints(ctx, camera, map);
}

/** Numbers of every tenth or so waypoint outside the road, and a line at waypoint 0. */
function drawWaypoints(ctx, camera, map) {
  const road = map.road,
    n = road.center_x.length;
  ctx.fillStyle = color("--quiet");
  ctx.font = "11px system-ui, sans-serif";
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  let lastX = -1e9,
    lastY = -1e9,
    firstX = 0,
    firstY = 0;
  for (let i = 0; i < n; i += road.every[0]) {
    const ox = camera.x(road.outer_x[i]),
      oy = camera.y(road.outer_y[i]);
    const ix = camera.x(road.inner_x[i]),
      iy = camera.y(road.inner_y[i]);
    const length = Math.hypot(ox - ix, oy - iy) || 1;
    if (i === 0) {
      ctx.strokeStyle = color("--ink");
      ctx.lineWidth = 2;
      ctx.beginPath();
      ctx.moveTo(ix, iy);
      ctx.lineTo(ox, oy);
      ctx.stroke();
    }
    const tx = ox + ((ox - ix) / length) * 11,
      ty = oy + ((oy - iy) / length) * 11;
    if (Math.hypot(tx - lastX, ty - lastY) < 30) continue;
    if (i && Math.hypot(tx - firstX, ty - firstY) < 26) continue;
    if (!i) [firstX, firstY] = [tx, ty];
    ctx.fillText(String(road.index[i]), tx, ty);
    [lastX, lastY] = [tx, ty];
  }
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

function drawCar(ctx, camera, x, y, yawDeg, ink) {
  const yaw = (yawDeg * Math.PI) / 180,
    length = Math.max(CAR_M * camera.scale, 13);
  ctx.save();
  ctx.translate(camera.x(x), camera.y(y));
  ctx.rotate(-yaw);
  ctx.beginPath();
  ctx.moveTo(length * 0.55, 0);
  ctx.lineTo(-length * 0.45, length * 0.36);
  ctx.lineTo(-length * 0.25, 0);
  ctx.lineTo(-length * 0.45, -length * 0.36);
  ctx.closePath();
  ctx.fillStyle = ink;
  ctx.strokeStyle = color("--ink");
  ctx.lineWidth = 1.3;
  ctx.fill();
  ctx.stroke();
  ctx.restore();
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
