// Plays laps: the clock, its controls and keys, and where cars are between two steps.

import { Choice, html, useEffect, useRef, useState } from "/ui.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4];
const PUT_BACK_M = 1.5; // a car that is further from where it was was put there

/** The index of the last value that is at most `x`; 0 if none is. @param {ArrayLike<number>} values rise */
export function lastAt(values, x) {
  let low = 0;
  let high = values.length - 1;
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    if (values[middle] <= x + 1e-9) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** The value of `ys` at an x between those of `xs`, which rise; outside, the first or the last. */
export function valueAt(xs, ys, x) {
  const row = lastAt(xs, x);
  const next = Math.min(row + 1, xs.length - 1);
  const gap = xs[next] - xs[row];
  const part = gap > 0 ? Math.min(Math.max((x - xs[row]) / gap, 0), 1) : 0;
  return ys[row] + part * (ys[next] - ys[row]);
}

/**
 * Where a car is, as `TrackMap` takes it.
 * @param {{x: ArrayLike<number>, y: ArrayLike<number>, yaw_rad: ArrayLike<number>}} lap
 * @param {ArrayLike<number>} axis by what the lap is played
 */
export function carAt({ x, y, yaw_rad: yaw }, axis, at) {
  const row = lastAt(axis, at);
  const next = Math.min(row + 1, axis.length - 1);
  if (Math.hypot(x[next] - x[row], y[next] - y[row]) > PUT_BACK_M)
    return { x: x[row], y: y[row], yaw: yaw[row] };
  // Neither from -180 to 180 degrees nor back, which is no turn.
  const turn = Math.atan2(Math.sin(yaw[next] - yaw[row]), Math.cos(yaw[next] - yaw[row]));
  const part = valueAt([axis[row], axis[next]], [0, 1], at);
  return { x: valueAt(axis, x, at), y: valueAt(axis, y, at), yaw: yaw[row] + part * turn };
}

/**
 * A player of laps that are aligned by `axes`, such as the seconds of each.
 * @param {any[]} axes arrays that rise
 * @param {number} start
 * @param {(at: number, seconds: number) => number} later where it is so many seconds later
 */
export function usePlayer(axes, start, later = (at, seconds) => at + seconds) {
  const [wanted, seek] = useState(start);
  const [playing, setPlaying] = useState(false);
  const [speed, setSpeed] = useState(1);
  const beginning = Math.min(...axes.map((axis) => axis[0]));
  const end = Math.max(...axes.map((axis) => axis.at(-1)));
  const at = Math.min(Math.max(wanted, beginning), end);
  const ended = at >= end - 1e-6;
  const toggle = () => {
    if (!playing && ended) seek(beginning);
    setPlaying(!playing);
  };
  /** Some steps of the first lap on, of the next one where the first has ended. */
  const move = (steps) => {
    setPlaying(false);
    const axis =
      axes.find((each) => (steps > 0 ? each.at(-1) > at : each[0] < at && each.at(-1) >= at)) ??
      axes[0];
    const between = steps < 0 && axis[lastAt(axis, at)] < at ? 1 : 0;
    let row = Math.min(Math.max(lastAt(axis, at) + steps + between, 0), axis.length - 1);
    // Progress may stand still for some steps.
    while (row > 0 && row < axis.length - 1 && axis[row] === at) row += Math.sign(steps);
    seek(axis[row]);
  };
  const faster = (by) =>
    setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(speed) + by, 0), SPEEDS.length - 1)]);
  const advance = useRef(null);
  advance.current = (seconds) => seek(later(at, seconds));
  useEffect(() => {
    if (!playing) return undefined;
    let before = performance.now();
    let frame = 0;
    const step = (time) => {
      advance.current((Math.max(Math.min(time - before, 250), 0) / 1000) * speed);
      before = time;
      frame = requestAnimationFrame(step);
    };
    frame = requestAnimationFrame(step);
    return () => cancelAnimationFrame(frame);
  }, [playing, speed]);
  useEffect(() => {
    if (playing && ended) setPlaying(false);
  }, [playing, ended]);
  const keys = {
    k: toggle,
    ArrowRight: (event) => move(event.shiftKey ? 15 : 1),
    ArrowLeft: (event) => move(event.shiftKey ? -15 : -1),
    Home: () => seek(beginning),
    End: () => seek(end),
    "+": () => faster(1),
    "-": () => faster(-1),
  };
  return { at, beginning, end, playing, speed, seek, toggle, move, setSpeed, keys };
}

/** Does what a key is for, unless somebody types or a control needs it. @param {KeyboardEvent} event @param {Object} keys */
export function pressKey(event, keys) {
  const target = /** @type {Element} */ (event.target);
  const typed = target.closest?.("input:not([type=range]), select, textarea, dialog, .u-over");
  if (typed || event.ctrlKey || event.metaKey || event.altKey) return;
  if (document.querySelector("dialog[open]")) return;
  const onControl = target.closest?.("button, a, summary");
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const action = keys[key === " " && !onControl ? "k" : key];
  if (!action) return;
  event.preventDefault();
  action(event);
}

/**
 * The controls of a player.
 * @param {{player: any, position: string, children?: any}} props position: in words; children: more controls
 */
export function Playback({ player, position, children = null }) {
  const { at, beginning, end, playing, speed, seek, toggle, move, setSpeed } = player;
  const button = (label, text, action) =>
    html`<button type="button" aria-label=${label} onClick=${action}>${text}</button>`;
  return html`
    <div class="player-controls" role="group" aria-label="Playback">
      ${button("To the beginning", "|◀", () => seek(beginning))}
      ${button("One step back", "◀", () => move(-1))}
      <button type="button" class="main play" onClick=${toggle}>${playing ? "Pause" : "Play"}</button>
      ${button("One step on", "▶", () => move(1))}
      <${Choice} label=${html`<span class="unseen">Speed</span>`} value=${String(speed)}
        options=${SPEEDS.map((each) => [String(each), `${each}×`])} onChange=${(value) => setSpeed(Number(value))} />
      ${children}
      <input type="range" min=${beginning} max=${end} step="any" value=${at} aria-label="Position in the episode"
        aria-valuetext=${position} onInput=${(event) => seek(Number(event.currentTarget.value))} />
      <p class="position">${position}</p>
    </div>`;
}
