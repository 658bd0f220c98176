// A map of a track on a canvas: road, waypoints, paths coloured by a value, cars with their heading.

import { h, number } from "/dom.js";
import { ink } from "/theme_colors.js";
import { html, useEffect, useLayoutEffect, useRef } from "/vendor/preact/preact.js";

const STOPS = ["#2c5fd6", "#3f8fbf", "#7fa37a", "#d1a53c", "#f26a1b"].map((text) =>
  [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16)),
);
const SHADES = 24;
const MARGIN_PX = 14;

/** A colour of the theme by its name; others, such as rgb(…), are taken as they are. */
const css = (name) => (name.includes("(") ? name : ink(name));

/** The colour of a share from 0 to 1. */
function shade(share) {
  const place = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1),
    first = Math.min(Math.floor(place), STOPS.length - 2);
  const mixed = STOPS[first].map((low, k) =>
    Math.round(low + (place - first) * (STOPS[first + 1][k] - low)),
  );
  return `rgb(${mixed.join(",")})`;
}

/**
 * A map that fits into its place.
 * @param {{label: string, height?: number | null, pick?: function(number, number): void}} spec pick gets metres of a click.
 * @returns element, and functions that set what is shown:
 *   setTrack({center, inner, outer, closed}), lines of points [x, y] in metres;
 *   setPaths([{x, y, values?, color?, alpha?, dashed?, name?, unit?}]), a path with values is coloured by them;
 *   setCars([{x, y, yaw, color, name}]), yaw in radians; setObjects([[x, y, yaw], …]); showWaypoints(boolean).
 */
export function trackMap({ label, height = 380, pick = null }, signal) {
  const canvas = h("canvas", { role: "img", "aria-label": label });
  const legend = h("p", { class: "map-legend readout" }, " ");
  const element = h("div", { class: "track-map" }, canvas, legend);
  const state = { track: null, paths: [], cars: [], objects: [], numbers: false };
  const ground = document.createElement("canvas");
  let scale = 1,
    left = 0,
    top = 0,
    waiting = false,
    stale = true;
  if (height) canvas.style.setProperty("height", `${height}px`);

  const at = (x, y) => [left + x * scale, top - y * scale];
  const draw = (groundToo = false) => {
    stale ||= groundToo;
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      if (element.isConnected) paint();
    });
  };

  function paint() {
    const ratio = devicePixelRatio || 1,
      width = Math.round(canvas.clientWidth * ratio),
      rows = Math.round(canvas.clientHeight * ratio);
    if (!width || !rows) return;
    if (canvas.width !== width || canvas.height !== rows) {
      canvas.width = ground.width = width;
      canvas.height = ground.height = rows;
      stale = true;
    }
    if (stale) {
      fit(ratio);
      paintGround(ground.getContext("2d"), ratio);
      stale = false;
    }
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, width, rows);
    pen.drawImage(ground, 0, 0);
    for (const [x, y, yaw] of state.objects) box(pen, x, y, yaw, 0.4, 0.3, css("edge"), ratio);
    for (const car of [...state.cars].reverse()) paintCar(pen, car, ratio);
  }

  function fit(ratio) {
    const points = state.track
      ? [...state.track.inner, ...state.track.outer]
      : state.paths.flatMap((path) => path.x.map((x, k) => [x, path.y[k]]));
    if (!points.length) return;
    const box = points.reduce(
      ([a, b, c, d], [x, y]) => [Math.min(a, x), Math.min(b, y), Math.max(c, x), Math.max(d, y)],
      [Infinity, Infinity, -Infinity, -Infinity],
    );
    const margin = MARGIN_PX * ratio,
      wide = Math.max(box[2] - box[0], 0.5),
      high = Math.max(box[3] - box[1], 0.5);
    scale = Math.min((ground.width - 2 * margin) / wide, (ground.height - 2 * margin) / high);
    left = (ground.width - wide * scale) / 2 - box[0] * scale;
    top = (ground.height + high * scale) / 2 + box[1] * scale;
  }

  function paintGround(pen, ratio) {
    pen.clearRect(0, 0, ground.width, ground.height);
    pen.lineJoin = pen.lineCap = "round";
    if (state.track) paintRoad(pen, state.track, ratio);
    for (const path of [...state.paths].reverse()) paintPath(pen, path, ratio);
    if (state.track && state.numbers) paintWaypoints(pen, state.track.center, ratio);
  }

  function paintRoad(pen, track, ratio) {
    const trace = (line) =>
      line.forEach(([x, y], k) => (k ? pen.lineTo(...at(x, y)) : pen.moveTo(...at(x, y))));
    pen.beginPath();
    if (track.closed) {
      trace(track.outer);
      pen.closePath();
      trace(track.inner);
      pen.closePath();
    } else {
      trace([...track.outer, ...[...track.inner].reverse()]);
      pen.closePath();
    }
    pen.fillStyle = css("road");
    pen.fill("evenodd");
    pen.strokeStyle = css("edge");
    pen.lineWidth = ratio;
    for (const line of [track.outer, track.inner]) {
      pen.beginPath();
      trace(line);
      pen.stroke();
    }
    pen.strokeStyle = css("ink");
    pen.lineWidth = 3 * ratio;
    pen.beginPath();
    trace([track.inner[0], track.outer[0]]);
    pen.stroke();
    pen.strokeStyle = css("faint");
    pen.lineWidth = ratio;
    pen.setLineDash([4 * ratio, 6 * ratio]);
    pen.beginPath();
    trace(track.center);
    pen.stroke();
    pen.setLineDash([]);
  }

  function paintPath(pen, path, ratio) {
    pen.lineWidth = (path.values ? 3.5 : 2) * ratio;
    const far = (k) => Math.hypot(path.x[k] - path.x[k - 1], path.y[k] - path.y[k - 1]) > 0.6; // the car was put back
    if (!path.values) {
      pen.strokeStyle = css(path.color ?? "c2");
      pen.globalAlpha = path.alpha ?? 1;
      pen.setLineDash(path.dashed ? [6 * ratio, 4 * ratio] : []);
      pen.beginPath();
      path.x.forEach((x, k) =>
        k && !far(k) ? pen.lineTo(...at(x, path.y[k])) : pen.moveTo(...at(x, path.y[k])),
      );
      pen.stroke();
      pen.setLineDash([]);
      pen.globalAlpha = 1;
      return;
    }
    const [low, high] = range(path.values);
    const groups = new Map();
    for (let k = 1; k < path.x.length; k += 1) {
      if (far(k)) continue;
      const place =
        high > low
          ? Math.min(
              SHADES - 1,
              Math.max(0, Math.floor(((path.values[k] - low) / (high - low)) * SHADES)),
            )
          : 0;
      if (!groups.has(place)) groups.set(place, []);
      groups.get(place).push(k);
    }
    for (const [place, steps] of groups) {
      pen.strokeStyle = shade(place / (SHADES - 1));
      pen.beginPath();
      for (const k of steps) {
        pen.moveTo(...at(path.x[k - 1], path.y[k - 1]));
        pen.lineTo(...at(path.x[k], path.y[k]));
      }
      pen.stroke();
    }
  }

  function paintWaypoints(pen, center, ratio) {
    pen.font = `${11 * ratio}px system-ui`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    let last = null;
    center.forEach(([x, y], k) => {
      const [px, py] = at(x, y);
      pen.fillStyle = css("ink");
      pen.beginPath();
      pen.arc(px, py, 1.6 * ratio, 0, 7);
      pen.fill();
      if (last && Math.hypot(px - last[0], py - last[1]) < 26 * ratio) return;
      if (k === center.length - 1 && k) return; // on a closed track, it repeats the first one
      last = [px, py];
      pen.lineWidth = 3 * ratio;
      pen.strokeStyle = css("paper");
      pen.strokeText(k, px, py - 9 * ratio);
      pen.fillText(k, px, py - 9 * ratio);
    });
  }

  function box(pen, x, y, yaw, length, width, color, ratio) {
    const [px, py] = at(x, y),
      least = 7 * ratio;
    pen.save();
    pen.translate(px, py);
    pen.rotate(-yaw);
    pen.fillStyle = color;
    const long = Math.max(length * scale, least),
      wide = Math.max(width * scale, least);
    pen.fillRect(-long / 2, -wide / 2, long, wide);
    pen.restore();
  }

  function paintCar(pen, car, ratio) {
    const [px, py] = at(car.x, car.y),
      size = Math.min(Math.max(0.3 * scale, 9 * ratio), 22 * ratio);
    pen.save();
    pen.translate(px, py);
    pen.rotate(-car.yaw);
    pen.beginPath();
    pen.moveTo(size, 0);
    pen.lineTo(-size * 0.7, size * 0.62);
    pen.lineTo(-size * 0.35, 0);
    pen.lineTo(-size * 0.7, -size * 0.62);
    pen.closePath();
    pen.fillStyle = css(car.color ?? "c1");
    pen.strokeStyle = css("paper");
    pen.lineWidth = 2 * ratio;
    pen.stroke();
    pen.fill();
    pen.restore();
    if (!car.name) return;
    pen.font = `600 ${12 * ratio}px system-ui`;
    pen.textAlign = "center";
    pen.lineWidth = 3 * ratio;
    pen.strokeStyle = css("paper");
    pen.fillStyle = css("ink");
    // Above the car, but inside the picture.
    const above = py - size - 6 * ratio,
      half = pen.measureText(car.name).width / 2 + 2 * ratio;
    const y = above < 14 * ratio ? py + size + 16 * ratio : above,
      x = Math.max(half, Math.min(canvas.width - half, px));
    pen.strokeText(car.name, x, y);
    pen.fillText(car.name, x, y);
  }

  function tell() {
    const path = state.paths.find((each) => each.values);
    if (!path) {
      legend.replaceChildren(" ");
      return;
    }
    const [low, high] = range(path.values);
    const scaleOf = h("span", { class: "map-scale" });
    scaleOf.style.setProperty(
      "background",
      `linear-gradient(90deg, ${[0, 0.25, 0.5, 0.75, 1].map(shade).join(", ")})`,
    );
    legend.replaceChildren(
      `${path.name ?? "Value"}: ${number(low, 2)} `,
      scaleOf,
      ` ${number(high, 2, path.unit ?? "")}`,
    );
  }

  if (pick) {
    canvas.addEventListener("click", (event) => {
      const ratio = devicePixelRatio || 1;
      pick((event.offsetX * ratio - left) / scale, (top - event.offsetY * ratio) / scale);
    });
  }
  const resize = new ResizeObserver(() => draw(true));
  resize.observe(canvas);
  addEventListener("themechange", () => draw(true), { signal });
  signal?.addEventListener("abort", () => resize.disconnect(), { once: true });
  return {
    element,
    setTrack(track) {
      state.track = track;
      draw(true);
    },
    setPaths(paths) {
      state.paths = paths;
      tell();
      draw(true);
    },
    setCars(cars) {
      state.cars = cars;
      draw();
    },
    setObjects(objects) {
      state.objects = objects;
      draw();
    },
    showWaypoints(on) {
      state.numbers = on;
      draw(true);
    },
  };
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

/** The map as a component; arrays that are the same as before are not drawn again. */
export function TrackMap({
  label,
  height = 380,
  pick = null,
  track,
  paths,
  cars = [],
  objects = [],
  numbers = false,
}) {
  const place = useRef(null);
  const map = useRef(null);
  useLayoutEffect(() => {
    const own = new AbortController();
    map.current = trackMap({ label, height, pick }, own.signal);
    place.current.replaceChildren(map.current.element);
    return () => own.abort();
  }, [label, height]);
  useEffect(() => map.current.setTrack(track), [track, label]);
  useEffect(() => map.current.setPaths(paths), [paths, label]);
  useEffect(() => map.current.setCars(cars), [JSON.stringify(cars), label]);
  useEffect(() => map.current.setObjects(objects), [JSON.stringify(objects), label]);
  useEffect(() => map.current.showWaypoints(numbers), [numbers, label]);
  return html`<div ref=${place}></div>`;
}
