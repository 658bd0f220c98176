// The polar picture of an action space: steering is the direction, speed the distance.

import { number } from "/text.js";
import { html } from "/ui.js";

const RADIUS = 250;
const CENTER = 220;
const BOTTOM = 290;

/** Steering as text: degrees and the side. */
export const steering = (angle) =>
  `${number(Math.abs(angle), Math.abs(angle) % 1 ? 1 : 0)}°${angle > 0 ? " left" : angle < 0 ? " right" : ""}`;

const isNumber = (value) => Number.isFinite(value);

/** Steering and speed of each action, or of the two corners of the ranges. */
function cornersOf(space) {
  const pairs = Array.isArray(space)
    ? space.map((each) => [each?.steering_angle, each?.speed])
    : ["low", "high"].map((end) => [space?.steering_angle?.[end], space?.speed?.[end]]);
  return pairs.filter((pair) => pair.every(isNumber));
}

/**
 * A picture of actions.
 * @param {{space: any, chosen?: number, choose?: ((index: number) => void) | null}} props `space` is action_space of the file
 */
export function Polar({ space, chosen = -1, choose = null }) {
  const corners = cornersOf(space);
  const widest = Math.min(90, Math.max(30, ...corners.map(([angle]) => Math.abs(angle))));
  const fastest = Math.max(0.1, ...corners.map(([, speed]) => speed));
  const reach = 1.08 * fastest;
  const at = (angle, speed) => {
    const turn = (Math.max(-90, Math.min(90, angle)) * Math.PI) / 180;
    const away = (Math.max(speed, 0) / reach) * RADIUS;
    return [CENTER - away * Math.sin(turn), BOTTOM - away * Math.cos(turn)];
  };
  const point = (angle, speed) =>
    at(angle, speed)
      .map((each) => each.toFixed(1))
      .join(" ");
  const radius = (speed) => ((Math.max(speed, 0) / reach) * RADIUS).toFixed(1);
  const arc = (speed, from, to) =>
    `${point(from, speed)} A ${radius(speed)} ${radius(speed)} 0 0 0 ${point(to, speed)}`;
  const center = `${CENTER} ${BOTTOM}`;
  const edge = widest + 3;
  const step = fastest > 2.4 ? 1 : fastest > 1.2 ? 0.5 : 0.25;
  const speeds = Array.from({ length: Math.floor(reach / step) }, (_, k) => (k + 1) * step);
  const spread = widest > 30 ? 15 : 10;
  const most = Math.floor(widest / spread);
  const angles = Array.from({ length: 2 * most + 1 }, (_, k) => (k - most) * spread);
  const text = textOf(space, corners, fastest);
  return html`
    <figure class="polar-figure">
      <svg viewBox="0 0 440 320" class="polar" role="img" aria-label=${`Polar picture of the action space: ${text}`}>
        <path class="polar-field" d=${`M ${center} L ${arc(reach, -edge, edge)} Z`} />
        ${speeds.map((speed) => {
          const [x, y] = at(-edge, speed);
          const label = number(speed, speed % 1 ? 2 : 0).replace(/0$/, "");
          return html`<path class="polar-grid" d=${`M ${arc(speed, -edge, edge)}`} />
            <text class="polar-label" x=${x + 5} y=${y + 12}>${speed % 1 ? label : number(speed)}</text>`;
        })}
        ${angles.map((angle) => {
          const [x, y] = at(angle, reach * 1.05);
          return html`<path class="polar-grid" d=${`M ${center} L ${point(angle, reach)}`} />
            <text class="polar-label" x=${x} y=${y} text-anchor="middle">${Math.abs(angle)}°${angle > 0 ? "L" : angle < 0 ? "R" : ""}</text>`;
        })}
        ${
          Array.isArray(space)
            ? space.map((action, k) => {
                if (!isNumber(action?.steering_angle) || !isNumber(action?.speed)) return null;
                const [x, y] = at(action.steering_angle, action.speed);
                return html`<path class="polar-ray" d=${`M ${center} L ${x.toFixed(1)} ${y.toFixed(1)}`} />
            <circle class=${`polar-dot${k === chosen ? " chosen" : ""}`} cx=${x} cy=${y} r=${k === chosen ? 9 : 6.5} onClick=${choose && (() => choose(k))}>
              <title>Action ${k}: ${steering(action.steering_angle)}, ${number(action.speed, 2, "m/s")}</title>
            </circle>
            ${space.length <= 40 && html`<text class="polar-number" x=${x} y=${y - 10} text-anchor="middle">${k}</text>`}`;
              })
            : html`<path class="polar-range" d=${rangeOf(corners, { arc, point, radius })} />`
        }
      </svg>
      <figcaption class="readout">${text} Direction: steering; distance: speed in m/s.${Array.isArray(space) && " The table has all of them."}</figcaption>
    </figure>`;
}

function rangeOf(corners, { arc, point, radius }) {
  if (corners.length < 2) return "";
  const [[right, slow], [left, fast]] = corners;
  if (right >= left || slow >= fast) return "";
  return `M ${arc(fast, right, left)} L ${point(left, slow)} A ${radius(slow)} ${radius(slow)} 0 0 1 ${point(right, slow)} Z`;
}

function textOf(space, corners, fastest) {
  if (Array.isArray(space)) {
    const widest = Math.max(...corners.map(([angle]) => Math.abs(angle)));
    return `${space.length} actions${corners.length ? `, up to ${steering(widest)} and ${number(fastest, 2, "m/s")}` : ""}.`;
  }
  if (corners.length < 2) return "";
  const [[right, slow], [left, fast]] = corners;
  return `Any steering from ${steering(right)} to ${steering(left)}, any speed from ${number(slow, 2)} to ${number(fast, 2, "m/s")}.`;
}
