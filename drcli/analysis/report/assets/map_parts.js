// What the maps of the report and of the console share. A module; the report has it without `export`.
// `color` gives the colour of a name such as "--road" in the present theme.

const CAR_M = 0.3;

/** 64 colours between the given ones. @param {string[]} stops such as "#2c5fd6" */
export function ramp(stops) {
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

/** Turns metres into pixels of the canvas: the whole track, or a part of it. */
export class Camera {
  constructor([x0, y0, x1, y1]) {
    this.x0 = x0;
    this.y0 = y0;
    this.x1 = x1;
    this.y1 = y1;
    this.reset();
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

/**
 * The ground of the road.
 * @param {any} map has the metres of the `road` as columns inner_x, inner_y, outer_x, … and whether it is `closed`
 */
export function drawRoad(ctx, camera, map, color) {
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

/** Borders, centre line and the line at waypoint 0. */
export function drawBorders(ctx, camera, map, color) {
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
  ctx.strokeStyle = color("--ink");
  ctx.lineWidth = 2;
  ctx.beginPath();
  ctx.moveTo(camera.x(road.inner_x[0]), camera.y(road.inner_y[0]));
  ctx.lineTo(camera.x(road.outer_x[0]), camera.y(road.outer_y[0]));
  ctx.stroke();
}

/** Numbers of every tenth or so waypoint outside the road. */
export function drawWaypoints(ctx, camera, map, color) {
  const { road } = map;
  if (!road) return;
  const n = road.center_x.length;
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
    const tx = ox + ((ox - ix) / length) * 11,
      ty = oy + ((oy - iy) / length) * 11;
    if (Math.hypot(tx - lastX, ty - lastY) < 30) continue;
    if (i && Math.hypot(tx - firstX, ty - firstY) < 26) continue;
    if (!i) [firstX, firstY] = [tx, ty];
    ctx.fillText(String(road.index[i]), tx, ty);
    [lastX, lastY] = [tx, ty];
  }
}

/** A car as an arrow; the yaw is in degrees. */
export function drawCar(ctx, camera, x, y, yawDeg, ink, color) {
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
