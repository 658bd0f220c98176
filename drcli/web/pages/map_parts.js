// What is drawn on a map of a track: road, borders, cells, paths, dots, cars and their names.

import { ink } from "/theme_colors.js";

const CAR_M = 0.3;
const PUT_BACK_M = 0.6; // two steps further apart are not joined: the car was put back
const WAYPOINT_STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500];
const NUMBERS_PX = 34;

/** Colours of values: of lines from blue to orange, of areas those of viridis, as in pictures of `dr-reward plot`. */
export const RAMPS = {
  line: ramp(["#2c5fd6", "#3f8fbf", "#7fa37a", "#d1a53c", "#f26a1b"]),
  area: ramp(["#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#fde725"]),
};

/** 64 colours between the given ones. @param {string[]} stops such as "#2c5fd6" */
function ramp(stops) {
  const parts = stops.map((stop) => [1, 3, 5].map((at) => parseInt(stop.slice(at, at + 2), 16)));
  return Array.from({ length: 64 }, (_, i) => {
    const at = (i / 63) * (parts.length - 1);
    const low = Math.min(Math.floor(at), parts.length - 2);
    const mixed = parts[low].map((part, k) =>
      Math.round(part + (at - low) * (parts[low + 1][k] - part)),
    );
    return `rgb(${mixed.join(",")})`;
  });
}

/** A colour of the theme by its name; others, such as rgb(…), are taken as they are. */
const css = (name) => (name.includes("(") ? name : ink(name));

/** The least and the greatest value, without the rarest two percent at both ends. */
export function rangeOf({ values, range }) {
  if (range) return range;
  const sorted = Array.from(values)
    .filter(Number.isFinite)
    .sort((a, b) => a - b);
  const at = (share) => sorted[Math.round((sorted.length - 1) * share)] ?? 0;
  return [at(0.02), at(0.98)];
}

/** The colour of a value of something with `values`. */
function shades(valued, colors) {
  const [low, high] = rangeOf(valued);
  return (value) => {
    if (!Number.isFinite(value)) return ink("faint");
    const share = high > low ? (value - low) / (high - low) : 0.5;
    return colors[Math.min(Math.max(Math.floor(share * 64), 0), 63)];
  };
}

/** Least x, least y, greatest x, greatest y of points, with a margin for the numbers of the waypoints. @param {number[][]} points */
export function boundsOf(points) {
  const [xs, ys] = [0, 1].map((axis) => points.map((point) => point[axis]).sort((a, b) => a - b));
  const [x0, y0, x1, y1] = [xs[0], ys[0], xs.at(-1), ys.at(-1)];
  const margin = 0.05 * Math.max(x1 - x0, y1 - y0, 0.5);
  return [x0 - margin, y0 - margin, x1 + margin, y1 + margin];
}

/** Turns metres into pixels of a canvas: all within the bounds, or a part around a place. */
export class Camera {
  /** @param {number[]} bounds @param {number} width @param {number} height @param {{zoom: number, x?: number, y?: number}} part */
  constructor([x0, y0, x1, y1], width, height, { zoom, x, y }) {
    this.width = width;
    this.height = height;
    this.scale = zoom * Math.min(width / (x1 - x0), height / (y1 - y0));
    this.middle = zoom > 1 ? [x, y] : [(x0 + x1) / 2, (y0 + y1) / 2];
  }

  x(metres) {
    return this.width / 2 + (metres - this.middle[0]) * this.scale;
  }
  y(metres) {
    return this.height / 2 - (metres - this.middle[1]) * this.scale;
  }

  metres(px, py) {
    return [
      this.middle[0] + (px - this.width / 2) / this.scale,
      this.middle[1] - (py - this.height / 2) / this.scale,
    ];
  }
}

/** Begin a line through points [x, y] in metres. */
function trace(pen, camera, points, closed = false) {
  pen.beginPath();
  for (const [x, y] of points) pen.lineTo(camera.x(x), camera.y(y));
  if (closed) pen.closePath();
}

/** @param {any} pen @param {Camera} camera @param {any} track lines `center`, `inner` and `outer` of points */
export function drawRoad(pen, camera, { inner, outer, closed }) {
  pen.fillStyle = pen.strokeStyle = ink("road");
  pen.lineWidth = 1;
  // Piece by piece between the borders: right for open tracks and for those that cross themselves.
  for (let k = 0; k < inner.length - (closed ? 0 : 1); k += 1) {
    const next = (k + 1) % inner.length;
    trace(pen, camera, [inner[k], inner[next], outer[next], outer[k]], true);
    pen.fill();
    pen.stroke();
  }
}

/** Borders, centre line and the line at waypoint 0. @param {any} pen @param {Camera} camera @param {any} track */
export function drawBorders(pen, camera, { center, inner, outer, closed }) {
  const line = (points, color, width, dash = []) => {
    Object.assign(pen, { strokeStyle: ink(color), lineWidth: width });
    pen.setLineDash(dash);
    trace(pen, camera, points, closed);
    pen.stroke();
  };
  line(inner, "edge", 1.2);
  line(outer, "edge", 1.2);
  if (center) line(center, "edge", 0.8, [4, 5]);
  line([inner[0], outer[0]], "ink", 2);
}

/**
 * Dots at the waypoints, and the numbers of as many as there is room for outside the road.
 * @param {any} pen @param {Camera} camera @param {any} track
 */
export function drawWaypoints(pen, camera, { center, inner, outer }) {
  Object.assign(pen, { textAlign: "center", textBaseline: "middle", fillStyle: ink("quiet") });
  pen.font = "11px system-ui, sans-serif";
  const places = center.map((_, k) => {
    const [ox, oy, ix, iy] = [...outer[k], ...inner[k]];
    const length = Math.hypot(ox - ix, oy - iy) || 1;
    const away = 11 / camera.scale / length;
    return [camera.x(ox + (ox - ix) * away), camera.y(oy + (oy - iy) * away)];
  });
  const far = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
  const around = places.reduce((sum, place, k) => sum + (k && far(place, places[k - 1])), 0);
  const step = WAYPOINT_STEPS.find((each) => (around / places.length) * each >= NUMBERS_PX) ?? 1000;
  const written = [];
  places.forEach((place, k) => {
    if (k % step || written.some((other) => far(place, other) < 0.7 * NUMBERS_PX)) return;
    written.push(place);
    pen.fillText(String(k), ...place);
  });
  for (const [x, y] of center) pen.fillRect(camera.x(x) - 1, camera.y(y) - 1, 2, 2);
}

/** Areas coloured by a value. @param {any} pen @param {Camera} camera @param {any} cells `corners` of each and `values` */
export function drawCells(pen, camera, cells) {
  const shade = shades(cells, cells.sides ? RAMPS.line : RAMPS.area);
  pen.lineWidth = 0.7; // without it, the ground is seen between neighbours
  cells.corners.forEach((corners, k) => {
    pen.fillStyle = pen.strokeStyle = shade(cells.values[k]);
    trace(pen, camera, corners, true);
    pen.fill();
    pen.stroke();
  });
}

/** A line in one colour, or coloured by its values. */
export function drawPath(pen, camera, path) {
  const { x, y, values, far = PUT_BACK_M, color = "c2" } = path;
  const shade = values && shades(path, RAMPS.line);
  const groups = new Map(); // steps of one colour are one line
  for (let k = 1; k < x.length; k += 1) {
    if (Math.hypot(x[k] - x[k - 1], y[k] - y[k - 1]) > far) continue;
    const one = shade ? shade(values[k]) : css(color);
    if (!groups.has(one)) groups.set(one, []);
    groups.get(one).push(k);
  }
  pen.lineJoin = pen.lineCap = "round";
  pen.lineWidth = path.width ?? (values ? 3.5 : 2);
  pen.globalAlpha = path.alpha ?? 1;
  pen.setLineDash(path.dashed ? [6, 4] : []);
  for (const [one, steps] of groups) {
    pen.strokeStyle = one;
    pen.beginPath();
    steps.forEach((k, n) => {
      if (steps[n - 1] !== k - 1) pen.moveTo(camera.x(x[k - 1]), camera.y(y[k - 1]));
      pen.lineTo(camera.x(x[k]), camera.y(y[k]));
    });
    pen.stroke();
  }
  pen.globalAlpha = 1;
  pen.setLineDash([]);
}

/** Places as dots: many at one place become one dark spot, unless they have colours of their own. @param {any} pen @param {Camera} camera @param {any[][]} dots */
export function drawDots(pen, camera, dots) {
  const names = new Set(dots.map(([, , color = "bad"]) => color));
  const inks = new Map([...names].map((name) => [name, ink(name)]));
  for (const [x, y, color] of dots) {
    pen.globalAlpha = color ? 0.9 : 0.25;
    pen.fillStyle = inks.get(color ?? "bad");
    pen.beginPath();
    pen.arc(camera.x(x), camera.y(y), color ? 3.5 : 6, 0, 7);
    pen.fill();
  }
  pen.globalAlpha = 1;
}

/** Draw around a place that is turned. */
function turned(pen, camera, x, y, yaw, draw) {
  pen.save();
  pen.translate(camera.x(x), camera.y(y));
  pen.rotate(-yaw);
  draw();
  pen.restore();
}

/** @param {any} pen @param {Camera} camera @param {number[]} box x, y, yaw */
export function drawBox(pen, camera, [x, y, yaw]) {
  const long = Math.max(0.4 * camera.scale, 7);
  const wide = Math.max(0.3 * camera.scale, 7);
  turned(pen, camera, x, y, yaw, () => {
    Object.assign(pen, { fillStyle: ink("edge"), strokeStyle: ink("paper"), lineWidth: 1 });
    pen.fillRect(-long / 2, -wide / 2, long, wide);
    pen.strokeRect(-long / 2, -wide / 2, long, wide);
  });
}

/** A car as an arrow, with its name above it, but inside the picture. */
export function drawCar(pen, camera, { x, y, yaw, color = "c1", name = "" }) {
  const length = Math.max(CAR_M * camera.scale, 13);
  const shape = [
    [0.55, 0],
    [-0.45, 0.36],
    [-0.25, 0],
    [-0.45, -0.36],
  ];
  turned(pen, camera, x, y, yaw, () => {
    Object.assign(pen, { fillStyle: css(color), strokeStyle: ink("ink"), lineWidth: 1.3 });
    pen.beginPath();
    for (const [along, across] of shape) pen.lineTo(along * length, across * length);
    pen.closePath();
    pen.fill();
    pen.stroke();
  });
  if (!name) return;
  Object.assign(pen, { textAlign: "center", textBaseline: "middle", lineWidth: 3 });
  Object.assign(pen, { strokeStyle: ink("paper"), fillStyle: ink("ink") });
  pen.font = "600 12px system-ui";
  const half = pen.measureText(name).width / 2 + 2;
  const above = camera.y(y) < 34 ? camera.y(y) + 20 : camera.y(y) - 18;
  const beside = Math.max(half, Math.min(camera.width - half, camera.x(x)));
  pen.strokeText(name, beside, above);
  pen.fillText(name, beside, above);
}
