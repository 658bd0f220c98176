// The polar picture of an action space: steering is the direction, speed the distance.

import { fill, h, number } from "/dom.js";
import { svg as s } from "/svg.js";

const RADIUS = 250,
  CENTER = 220,
  BOTTOM = 290,
  WIDTH = 440,
  HEIGHT = 320;

/** Steering as text: degrees and the side. */
export const steering = (angle) =>
  `${number(Math.abs(angle), Math.abs(angle) % 1 ? 1 : 0)}°${angle > 0 ? " left" : angle < 0 ? " right" : ""}`;

/**
 * A picture of actions.
 * @param {{choose?: function(number): void}} options choose is called with the number of an action that was clicked
 * @returns {{element: HTMLElement, show: function(Object, number=): void}} show takes `action_space` of the file
 */
export function polar({ choose } = {}) {
  const drawing = s("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "polar", role: "img" });
  const caption = h("figcaption", { class: "readout" });
  const element = h("figure", { class: "polar-figure" }, drawing, caption);

  function show(space, chosen = -1) {
    const list = Array.isArray(space);
    const good = (value) => Number.isFinite(value);
    const corners = list
      ? space
          .filter((each) => good(each?.steering_angle) && good(each?.speed))
          .map((each) => [each.steering_angle, each.speed])
      : [
          ["low", "low"],
          ["high", "high"],
        ]
          .map(([a, b]) => [space?.steering_angle?.[a], space?.speed?.[b]])
          .filter((pair) => pair.every(good));
    const widest = Math.min(90, Math.max(30, ...corners.map(([angle]) => Math.abs(angle))));
    const fastest = Math.max(0.1, ...corners.map(([, speed]) => speed));
    const reach = 1.08 * fastest;
    const at = (angle, speed) => {
      const turn = (Math.max(-90, Math.min(90, angle)) * Math.PI) / 180,
        away = (Math.max(speed, 0) / reach) * RADIUS;
      return [CENTER - away * Math.sin(turn), BOTTOM - away * Math.cos(turn)];
    };
    const point = (angle, speed) =>
      at(angle, speed)
        .map((each) => each.toFixed(1))
        .join(" ");
    const arc = (speed, from, to) => {
      const away = ((speed / reach) * RADIUS).toFixed(1);
      return `${point(from, speed)} A ${away} ${away} 0 0 0 ${point(to, speed)}`;
    };
    const edge = widest + 3,
      parts = [];
    parts.push(
      s("path", {
        class: "polar-field",
        d: `M ${CENTER} ${BOTTOM} L ${arc(reach, -edge, edge)} Z`,
      }),
    );
    const step = fastest > 2.4 ? 1 : fastest > 1.2 ? 0.5 : 0.25;
    for (let speed = step; speed <= reach; speed += step) {
      parts.push(s("path", { class: "polar-grid", d: `M ${arc(speed, -edge, edge)}` }));
      const [x, y] = at(-edge, speed);
      parts.push(
        s(
          "text",
          { class: "polar-label", x: x + 5, y: y + 12 },
          `${number(speed, speed % 1 ? 2 : 0).replace(/0$/, "")}`,
        ),
      );
    }
    const spread = widest > 30 ? 15 : 10;
    for (let angle = -Math.floor(widest / spread) * spread; angle <= widest; angle += spread) {
      parts.push(
        s("path", { class: "polar-grid", d: `M ${CENTER} ${BOTTOM} L ${point(angle, reach)}` }),
      );
      const [x, y] = at(angle, reach * 1.05);
      parts.push(
        s(
          "text",
          { class: "polar-label", x, y, "text-anchor": "middle" },
          `${Math.abs(angle)}°${angle > 0 ? "L" : angle < 0 ? "R" : ""}`,
        ),
      );
    }
    if (list) {
      space.forEach((action, k) => {
        if (!good(action?.steering_angle) || !good(action?.speed)) return;
        const [x, y] = at(action.steering_angle, action.speed);
        parts.push(
          s("path", {
            class: "polar-ray",
            d: `M ${CENTER} ${BOTTOM} L ${x.toFixed(1)} ${y.toFixed(1)}`,
          }),
        );
        const dot = s(
          "circle",
          {
            class: k === chosen ? "polar-dot chosen" : "polar-dot",
            cx: x,
            cy: y,
            r: k === chosen ? 9 : 6.5,
          },
          s(
            "title",
            {},
            `Action ${k}: ${steering(action.steering_angle)}, ${number(action.speed, 2, "m/s")}`,
          ),
        );
        if (choose) dot.addEventListener("click", () => choose(k));
        parts.push(dot);
        if (space.length <= 40)
          parts.push(
            s("text", { class: "polar-number", x, y: y - 10, "text-anchor": "middle" }, String(k)),
          );
      });
    } else if (
      corners.length === 2 &&
      corners[0][0] < corners[1][0] &&
      corners[0][1] < corners[1][1]
    ) {
      const [[right, slow], [left, fast]] = corners;
      const inner = ((Math.max(slow, 0) / reach) * RADIUS).toFixed(1);
      parts.push(
        s("path", {
          class: "polar-range",
          d: `M ${arc(fast, right, left)} L ${point(left, slow)} A ${inner} ${inner} 0 0 1 ${point(right, slow)} Z`,
        }),
      );
    }
    fill(drawing, parts);
    const text = list
      ? `${space.length} actions${corners.length ? `, up to ${steering(widestOf(corners))} and ${number(fastest, 2, "m/s")}` : ""}.`
      : corners.length === 2
        ? `Any steering from ${steering(corners[0][0])} to ${steering(corners[1][0])}, any speed from ${number(corners[0][1], 2)} to ${number(corners[1][1], 2, "m/s")}.`
        : "";
    drawing.setAttribute("aria-label", `Polar picture of the action space: ${text}`);
    caption.textContent = `${text} Direction: steering; distance: speed in m/s.${list ? " The table has all of them." : ""}`;
  }
  return { element, show };
}

const widestOf = (corners) => Math.max(...corners.map(([angle]) => Math.abs(angle)));
