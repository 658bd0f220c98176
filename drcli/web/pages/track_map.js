// A map of a track on a canvas: road, waypoints, paths and areas coloured by a value, cars with their heading.

import * as parts from "/map_parts.js";
import { number, short } from "/text.js";
import { theme } from "/theme_colors.js";
import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from "/ui.js";

const NOTHING = [];
const WHOLE = { zoom: 1, x: 0, y: 0 };
const MOST_ZOOM = 12;

/** Empty a canvas and draw on it, in pixels of the page. @param {any} canvas @param {number[]} size @param {(pen: any) => void} draw */
function paint(canvas, [width, height], draw) {
  const ratio = devicePixelRatio || 1;
  const size = { width: Math.round(width * ratio), height: Math.round(height * ratio) };
  // A size that is set empties a canvas, even if it is the same, but takes a while.
  if (canvas.width !== size.width || canvas.height !== size.height) Object.assign(canvas, size);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  draw(pen);
  return canvas;
}

/**
 * A map that fits into its place; what is given is drawn again only when it is another object, and cars each time.
 * @param {{label: string, height?: number | string | null, zooms?: boolean, within?: number[] | null,
 *   pick?: ((x: number, y: number, near: number) => void) | null, hover?: ((x: number, y: number, near: number) => void) | null,
 *   track: {center?: number[][], inner: number[][], outer: number[][], closed: boolean} | null,
 *   paths?: {x: ArrayLike<number>, y: ArrayLike<number>, values?: ArrayLike<number>, color?: string, alpha?: number,
 *     dashed?: boolean, width?: number, far?: number, name?: string, unit?: string, digits?: number, range?: number[], sides?: string[]}[],
 *   cells?: {corners: number[][][], values: ArrayLike<number>, name: string, unit?: string, range?: number[], sides?: string[]} | null,
 *   dots?: any[][], cars?: {x: number, y: number, yaw: number, color?: string, name?: string}[], objects?: number[][], numbers?: boolean}} props
 *   Places are metres, dots are [x, y, colour], yaw is radians, objects are [x, y, yaw]; pick gets the metres of a click,
 *   hover those under the pointer, and both how many metres are near there; paths and cells with values are coloured by
 *   them, between those of `range`, which lie on two `sides` of a middle; numbers shows those of the waypoints. The
 *   height is pixels, null as the style sheet says, or "track" as the track needs; all `within` least x, least y,
 *   greatest x and greatest y can be seen.
 */
export function TrackMap({
  label,
  height = 380,
  zooms = false,
  within = null,
  pick = null,
  hover = null,
  track,
  paths = NOTHING,
  cells = null,
  dots = NOTHING,
  cars = NOTHING,
  objects = NOTHING,
  numbers = false,
}) {
  const canvas = useRef(null);
  const dragged = useRef(false);
  const [size, setSize] = useState([0, 0]);
  const [part, setPart] = useState(WHOLE);
  const bounds = useMemo(() => {
    if (within) return within;
    const points = track
      ? [...track.inner, ...track.outer]
      : paths.flatMap(({ x, y }) => Array.from(x, (each, k) => [each, y[k]]));
    return points.length ? parts.boundsOf(points) : null;
  }, [track, track ? null : paths]);
  const camera = bounds && size[0] ? new parts.Camera(bounds, size[0], size[1], part) : null;
  const ground = useMemo(() => {
    if (!camera) return null;
    return paint(document.createElement("canvas"), size, (pen) => {
      if (track) parts.drawRoad(pen, camera, track);
      if (cells) parts.drawCells(pen, camera, cells);
      if (track) parts.drawBorders(pen, camera, track);
      for (const path of [...paths].reverse()) parts.drawPath(pen, camera, path);
      parts.drawDots(pen, camera, dots);
      if (numbers && track) parts.drawWaypoints(pen, camera, track);
    });
  }, [track, bounds, size, part, paths, cells, dots, numbers, theme.value]);
  // With what else has changed: an effect after it would cost a second picture of the page.
  useLayoutEffect(() => {
    if (!ground) return;
    paint(canvas.current, size, (pen) => {
      pen.drawImage(ground, 0, 0, ...size);
      for (const each of objects) parts.drawBox(pen, camera, each);
      for (const car of [...cars].reverse()) parts.drawCar(pen, camera, car);
    });
  });
  useEffect(() => {
    const resize = new ResizeObserver(([{ contentRect: box }]) => setSize([box.width, box.height]));
    resize.observe(canvas.current);
    return () => resize.disconnect();
  }, []);

  const zoomBy = (factor) => {
    const zoom = Math.min(Math.max(part.zoom * factor, 1), MOST_ZOOM);
    setPart({ zoom, x: camera.middle[0], y: camera.middle[1] });
  };
  const at = (listener, { offsetX, offsetY }) =>
    camera && listener?.(...camera.metres(offsetX, offsetY), 14 / camera.scale);
  const move = (event) => {
    if (!event.buttons) at(hover, event);
    else if (part.zoom > 1) {
      dragged.current = true;
      const inside = (value, low, high) => Math.min(Math.max(value, low), high);
      const [x, y] = camera.middle;
      setPart({
        zoom: part.zoom,
        x: inside(x - event.movementX / camera.scale, bounds[0], bounds[2]),
        y: inside(y + event.movementY / camera.scale, bounds[1], bounds[3]),
      });
    }
  };
  const hold = (event) => {
    dragged.current = false;
    if (part.zoom > 1) event.currentTarget.setPointerCapture(event.pointerId);
  };
  const wheel = (event) => {
    if (!event.ctrlKey) return; // a plain wheel scrolls the page
    event.preventDefault();
    zoomBy(event.deltaY < 0 ? 1.2 : 1 / 1.2);
  };
  const scaled = cells ?? paths.find((each) => each.values);
  const scale = useMemo(() => scaled && scaleOf(scaled), [scaled]);
  const style = {
    height: typeof height === "number" ? `${height}px` : null,
    aspectRatio:
      height === "track" && bounds ? (bounds[2] - bounds[0]) / (bounds[3] - bounds[1]) : null,
    touchAction: part.zoom > 1 ? "none" : "pan-y",
  };
  const zoomer = (name, text, factor) =>
    html`<button type="button" aria-label=${name} onClick=${() => zoomBy(factor)}>${text}</button>`;
  return html`
    <div class="track-map">
      <canvas ref=${canvas} role="img" style=${style} aria-label=${scale ? `${label}. ${scale.text}` : label}
        onClick=${(event) => dragged.current || at(pick, event)} onPointerMove=${(hover || zooms) && move}
        onPointerDown=${zooms && hold} onWheel=${zooms && wheel}></canvas>
      ${zooms && html`<div class="zoom">${zoomer("Zoom in", "+", 1.6)}${zoomer("Zoom out", "−", 1 / 1.6)}</div>`}
      <p class="map-legend readout">${
        scale
          ? html`${scale.name}: ${scale.low}
            <span class="map-scale" style=${{ background: `linear-gradient(90deg, ${scale.colors.join(", ")})` }}></span>
            ${scale.high}`
          : " "
      }</p>
    </div>`;
}

/** The colours of something with values, and what their ends mean. */
function scaleOf(valued) {
  const { name, unit, digits, sides } = valued;
  const [low, high] = parts.rangeOf(valued).map((end, k) => {
    const value = digits === undefined ? short(end) : number(end, digits);
    return [value, k > 0 && unit, sides?.[k]].filter(Boolean).join(" ");
  });
  const colors = valued.corners && !sides ? parts.RAMPS.area : parts.RAMPS.line;
  const text = `${name}: from ${low} to ${high}.`;
  return { name, low, high, text, colors: colors.filter((_, k) => k % 9 === 0) };
}
