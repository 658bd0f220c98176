// A map of a track on a canvas: road, waypoints, paths coloured by a value, cars with their heading.

import { Camera, drawBorders, drawCar, drawRoad, drawWaypoints, ramp } from "/map_parts.js";
import { theme } from "/store.js";
import { number } from "/text.js";
import { ink } from "/theme_colors.js";
import { html, useEffect, useLayoutEffect, useMemo, useRef } from "/ui.js";

const COLORS = ramp(["#2c5fd6", "#3f8fbf", "#7fa37a", "#d1a53c", "#f26a1b"]);
const PUT_BACK_M = 0.6; // two steps further apart are not joined: the car was put back
const MARGIN = 0.05; // of the longer side, for the numbers of the waypoints

/** A colour of the theme by its name; others, such as rgb(…), are taken as they are. */
const css = (name) => (name.includes("(") ? name : ink(name));
const color = (name) => ink(name.slice(2));

/** What the drawing functions take, from lines of points [x, y]. */
function mapOf(track, paths) {
  const road = { every: [1], index: track?.center.map((_, k) => k) };
  for (const side of track ? ["center", "inner", "outer"] : [])
    [0, 1].forEach((axis) => (road[`${side}_${"xy"[axis]}`] = track[side].map((at) => at[axis])));
  const xs = track ? [...road.inner_x, ...road.outer_x] : paths.flatMap((path) => path.x);
  const ys = track ? [...road.inner_y, ...road.outer_y] : paths.flatMap((path) => path.y);
  if (!xs.length) return null;
  const edges = (values) =>
    values.reduce(
      ([low, high], each) => [Math.min(low, each), Math.max(high, each)],
      [Infinity, -Infinity],
    );
  const [[x0, x1], [y0, y1]] = [edges(xs), edges(ys)];
  const margin = MARGIN * Math.max(x1 - x0, y1 - y0, 0.5);
  const camera = new Camera([x0 - margin, y0 - margin, x1 + margin, y1 + margin]);
  return { road: track && road, closed: track?.closed, camera };
}

function drawPath(pen, camera, path) {
  const far = (k) => Math.hypot(path.x[k] - path.x[k - 1], path.y[k] - path.y[k - 1]) > PUT_BACK_M;
  const [low, high] = path.values ? range(path.values) : [0, 0];
  const groups = new Map(); // steps of one colour are one line
  for (let k = 1; k < path.x.length; k += 1) {
    const share = high > low ? (path.values[k] - low) / (high - low) : 0;
    const shade = path.values ? COLORS[Math.min(Math.max(Math.floor(share * 64), 0), 63)] : "";
    if (!groups.has(shade)) groups.set(shade, []);
    if (!far(k)) groups.get(shade).push(k);
  }
  pen.lineWidth = path.values ? 3.5 : 2;
  pen.globalAlpha = path.alpha ?? 1;
  pen.setLineDash(path.dashed ? [6, 4] : []);
  for (const [shade, steps] of groups) {
    pen.strokeStyle = shade || css(path.color ?? "c2");
    pen.beginPath();
    steps.forEach((k, n) => {
      if (steps[n - 1] !== k - 1) pen.moveTo(camera.x(path.x[k - 1]), camera.y(path.y[k - 1]));
      pen.lineTo(camera.x(path.x[k]), camera.y(path.y[k]));
    });
    pen.stroke();
  }
  pen.globalAlpha = 1;
  pen.setLineDash([]);
}

/** @param {any} pen @param {any} camera @param {number[]} box x, y, yaw */
function drawBox(pen, camera, [x, y, yaw]) {
  const long = Math.max(0.4 * camera.scale, 7);
  const wide = Math.max(0.3 * camera.scale, 7);
  pen.save();
  pen.translate(camera.x(x), camera.y(y));
  pen.rotate(-yaw);
  pen.fillStyle = ink("edge");
  pen.fillRect(-long / 2, -wide / 2, long, wide);
  pen.restore();
}

/** A name above the car, but inside the picture. */
function drawName(pen, camera, car) {
  pen.font = "600 12px system-ui";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.lineWidth = 3;
  pen.strokeStyle = ink("paper");
  pen.fillStyle = ink("ink");
  const half = pen.measureText(car.name).width / 2 + 2;
  const y = camera.y(car.y) < 34 ? camera.y(car.y) + 20 : camera.y(car.y) - 18;
  const x = Math.max(half, Math.min(camera.width - half, camera.x(car.x)));
  pen.strokeText(car.name, x, y);
  pen.fillText(car.name, x, y);
}

/** What stays the same while cars move. */
function drawGround(pen, map, { paths, dots, numbers }) {
  const { camera } = map;
  pen.lineJoin = pen.lineCap = "round";
  drawRoad(pen, camera, map, color);
  drawBorders(pen, camera, map, color);
  for (const path of [...paths].reverse()) drawPath(pen, camera, path);
  pen.fillStyle = css("bad");
  pen.globalAlpha = DOT_ALPHA; // many at one place become one dark spot
  for (const [x, y] of dots) {
    pen.beginPath();
    pen.arc(camera.x(x), camera.y(y), DOT_PX, 0, 7);
    pen.fill();
  }
  pen.globalAlpha = 1;
  if (!numbers || !map.road) return;
  drawWaypoints(pen, camera, map, color);
  map.road.center_x.forEach((x, k) =>
    pen.fillRect(camera.x(x) - 1.5, camera.y(map.road.center_y[k]) - 1.5, 3, 3),
  );
}

/** The least and the greatest value, without the rarest two percent at both ends. */
function range(values) {
  const sorted = values.filter(Number.isFinite).sort((a, b) => a - b);
  if (!sorted.length) return [0, 0];
  return [
    sorted[Math.floor((sorted.length - 1) * 0.02)],
    sorted[Math.ceil((sorted.length - 1) * 0.98)],
  ];
}

const NOTHING = [];
const DOT_PX = 6;
const DOT_ALPHA = 0.25;

/**
 * A map that fits into its place; `track` and `paths` are drawn again only when they are other objects.
 * @param {{label: string, height?: number | null, pick?: ((x: number, y: number) => void) | null,
 *   track: {center: number[][], inner: number[][], outer: number[][], closed: boolean} | null,
 *   paths?: {x: number[], y: number[], values?: number[], digits?: number, name?: string, unit?: string, color?: string,
 *     alpha?: number, dashed?: boolean}[],
 *   dots?: number[][], cars?: {x: number, y: number, yaw: number, color?: string, name?: string}[], objects?: number[][], numbers?: boolean}} props
 *   Places are metres, dots are [x, y], yaw is radians, objects are [x, y, yaw]; pick gets the metres of a click;
 *   a path with values is coloured by them; numbers shows those of the waypoints.
 */
export function TrackMap(props) {
  const {
    label,
    height = 380,
    pick = null,
    track,
    paths = NOTHING,
    dots = NOTHING,
    numbers = false,
  } = props;
  const canvas = useRef(null);
  const ground = useRef(null);
  const map = useMemo(() => mapOf(track, paths), [track, track ? null : paths]);
  const draw = () => {
    const { clientWidth: width, clientHeight: tall } = canvas.current ?? {};
    if (!width || !tall) return;
    const ratio = devicePixelRatio || 1;
    const size = { width: Math.round(width * ratio), height: Math.round(tall * ratio) };
    const { cars = [], objects = [] } = props;
    const fresh = (other) => {
      // A size that is set empties a canvas, even if it is the same, but takes a while.
      if (other.width !== size.width || other.height !== size.height) Object.assign(other, size);
      const pen = other.getContext("2d");
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.clearRect(0, 0, width, tall);
      return pen;
    };
    if (ground.current?.width !== size.width || ground.current?.height !== size.height) {
      ground.current = document.createElement("canvas");
      const pen = fresh(ground.current);
      map?.camera.fit(width, tall);
      if (map) drawGround(pen, map, { paths, dots, numbers });
    }
    const pen = fresh(canvas.current);
    pen.drawImage(ground.current, 0, 0, width, tall);
    if (!map) return;
    for (const each of objects) drawBox(pen, map.camera, each);
    for (const car of [...cars].reverse()) {
      const yaw = (car.yaw * 180) / Math.PI;
      drawCar(pen, map.camera, car.x, car.y, yaw, css(car.color ?? "c1"), color);
      if (car.name) drawName(pen, map.camera, car);
    }
  };
  const newest = useRef(draw);
  newest.current = draw;
  useLayoutEffect(() => {
    ground.current = null;
  }, [map, paths, dots, numbers, theme.value]);
  // With what else has changed: an effect after it would cost a second picture of the page.
  useLayoutEffect(draw);
  useEffect(() => {
    const resize = new ResizeObserver(() => newest.current());
    resize.observe(canvas.current);
    return () => resize.disconnect();
  }, []);

  const path = paths.find((each) => each.values);
  const [low, high] = path ? range(path.values).map((end) => number(end, path.digits ?? 2)) : [];
  const unit = path?.unit ? ` ${path.unit}` : "";
  const click = (event) => {
    if (!map) return;
    const [x, y] = map.camera.metres(event.offsetX, event.offsetY);
    pick(x, y);
  };
  return html`
    <div class="track-map">
      <canvas ref=${canvas} role="img" style=${height && { height: `${height}px` }}
        aria-label=${path ? `${label}. ${path.name}: from ${low} to ${high}${unit}.` : label}
        onClick=${pick && click}></canvas>
      <p class="map-legend readout">${
        path
          ? html`${path.name}: ${low}
            <span class="map-scale" style=${{ background: `linear-gradient(90deg, ${COLORS.filter((_, k) => k % 9 === 0).join(", ")})` }}></span>
            ${high}${unit}`
          : " "
      }</p>
    </div>`;
}
