// The picture of a reward function: reward at each place of the track, and along the lap.

import { Plot } from "/plot.js";
import { theme } from "/store.js";
import { number } from "/text.js";
import { Table, html, useEffect, useMemo, useRef, useState } from "/ui.js";

// Colours of viridis at equal steps, as in the picture of `dr-reward plot`.
const VIRIDIS = [
  ...["440154", "482475", "414487", "355f8d", "2a788e", "21918c"],
  ...["22a884", "44bf70", "7ad151", "bddf26", "fde725"],
].map((code) => [0, 2, 4].map((k) => parseInt(code.slice(k, k + 2), 16)));
const COLORS = ["c1", "c2", "c3", "c4", "c5", "c6"];
const UNKNOWN = "#b9bcc0";
const WHITE = "#fff";
const BLACK = "#1b1f24";

function colorOf(part) {
  const at = Math.max(0, Math.min(1, part)) * (VIRIDIS.length - 1);
  const k = Math.min(Math.floor(at), VIRIDIS.length - 2);
  const mixed = VIRIDIS[k].map((value, c) =>
    Math.round(value + (VIRIDIS[k + 1][c] - value) * (at - k)),
  );
  return `rgb(${mixed.join(",")})`;
}

const short = (value) => {
  if ((value ?? null) === null) return "–";
  const size = Math.abs(value);
  return size >= 1e4 || (value && size < 1e-3)
    ? value.toExponential(2)
    : String(Number(value.toPrecision(4)));
};

/** Draw rewards of places, borders, objects and the start. */
function paint(canvas, course, picture) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const { clientWidth: wide, clientHeight: tall } = canvas;
  if (!wide) return;
  Object.assign(canvas, { width: wide * ratio, height: tall * ratio });
  const pen = canvas.getContext("2d");
  const { rows, columns, edges } = course;
  const xs = edges.map(([x]) => x);
  const ys = edges.map(([, y]) => y);
  const [left, right, bottom, top] = [
    Math.min(...xs),
    Math.max(...xs),
    Math.min(...ys),
    Math.max(...ys),
  ];
  const zoom = Math.min((wide - 16) / (right - left), (tall - 16) / (top - bottom));
  const at = ([x, y]) => [
    (wide - zoom * (right - left)) / 2 + zoom * (x - left),
    (tall - zoom * (top - bottom)) / 2 + zoom * (top - y),
  ];
  const trace = (points, closed) => {
    pen.beginPath();
    points.forEach((point, k) => (k ? pen.lineTo(...at(point)) : pen.moveTo(...at(point))));
    if (closed) pen.closePath();
  };
  const stroke = (color, width) => {
    Object.assign(pen, { strokeStyle: color, lineWidth: width });
    pen.stroke();
  };
  pen.scale(ratio, ratio);
  const corner = (row, column) => edges[row * columns + (column % columns)];
  const span = picture.high - picture.low;
  // From the outside in: where parts of the track are close together, the road is on top.
  const middle = rows >> 1;
  const order = Array.from({ length: rows }, (_, k) => k).sort(
    (a, b) => Math.abs(b - middle) - Math.abs(a - middle),
  );
  for (const row of order)
    for (let column = 0; column < (course.closed ? columns : columns - 1); column += 1) {
      const value = picture.rewards[row * columns + column];
      const color =
        value === null ? UNKNOWN : colorOf(span > 0 ? (value - picture.low) / span : 0.5);
      trace(
        [
          corner(row, column),
          corner(row, column + 1),
          corner(row + 1, column + 1),
          corner(row + 1, column),
        ],
        true,
      );
      pen.fillStyle = color;
      pen.fill();
      stroke(color, 0.7);
    }
  for (const border of [course.inner, course.outer]) {
    trace(border, course.closed);
    stroke(WHITE, 2.6);
    stroke(BLACK, 1.1);
  }
  pen.fillStyle = WHITE;
  for (const corners of course.objects) {
    trace(corners, true);
    pen.fill();
    stroke(BLACK, 1.6);
  }
  const [x, y, yaw] = course.start;
  const size = 13 / zoom;
  const arrow = [
    [1, 0],
    [-0.6, 0.6],
    [-0.6, -0.6],
  ].map(([along, across]) => [
    x + size * (along * Math.cos(yaw) - across * Math.sin(yaw)),
    y + size * (along * Math.sin(yaw) + across * Math.cos(yaw)),
  ]);
  trace(arrow, true);
  pen.fill();
  stroke(BLACK, 1.8);
}

/** @param {{course: any, report: any}} props the answer of /api/reward/check, and the newest course that one had */
export function RewardPicture({ course, report }) {
  const canvas = useRef(null);
  const kept = useRef(null);
  const curved = useRef(null); // the map is there before the curves
  const [width, setWidth] = useState(0);
  if (report?.picture) kept.current = report;
  const { picture, report: numbers } = kept.current ?? {};
  if (picture?.curves.length) curved.current = picture;
  useEffect(() => {
    const resize = new ResizeObserver(() => setWidth(canvas.current?.clientWidth ?? 0));
    resize.observe(canvas.current);
    return () => resize.disconnect();
  }, []);
  useEffect(() => {
    if (course && picture) paint(canvas.current, course, picture);
  }, [course, picture, width, theme.value]);
  const plot = useMemo(() => {
    const { curves, progress } = curved.current ?? {};
    return (
      curves && {
        series: curves.map((each, k) => ({ name: each.name, color: COLORS[k % 6], digits: 3 })),
        data: [progress, ...curves.map((each) => each.rewards)],
      }
    );
  }, [curved.current]);
  const old = report && !report.picture && picture;
  const about = old
    ? "This is the picture of an earlier version."
    : picture && course
      ? `${course.world}, ${course.race_type}; the car requests ${number(course.speed_mps, 1, "m/s")}. The arrow is the start. Reward per step.`
      : "";
  return html`
    <figure class=${`reward-picture${old ? " old" : ""}`}>
      <figcaption><strong>Reward on the track</strong> for a car at this place that points along the track</figcaption>
      <canvas class="reward-map" ref=${canvas} role="img" aria-label="Map of rewards; the tables below have the numbers"></canvas>
      <div class="reward-legend">
        <span>${picture && short(picture.low)}</span>
        <div class="reward-scale" aria-hidden="true">${Array.from({ length: 40 }, (_, k) => html`<i style=${{ background: colorOf(k / 39) }}></i>`)}</div>
        <span>${picture && short(picture.high)}</span>
      </div>
      <p class="readout">${about}</p>
      <div class="reward-curves">${plot && html`<${Plot} title="Reward along the lap" hint="of scripted drivers, per step" x="Progress, %" height=${220} ...${plot} />`}</div>
      ${numbers && html`<${Numbers} report=${numbers} />`}
    </figure>`;
}

function Numbers({ report }) {
  const place = (extreme) => (extreme ? `${short(extreme.reward)} (${extreme.place})` : "–");
  const drivers = report.drivers.map((each) => [
    ...[
      each.name,
      each.about,
      number(each.progress, 1),
      number(each.seconds, 1),
      short(each.total),
      short(each.mean),
    ],
  ]);
  const time =
    report.time &&
    `A call takes ${number(report.time.median_us, 1)} µs (median), which makes the simulation ${number(report.time.slower_percent, 1)} % slower.`;
  return html`
    <details>
      <summary>Numbers of the check</summary>
      <${Table} caption="Drivers" heads=${["Driver", "Drives", "Progress, %", "Time, s", "Sum of rewards", "Mean"]} rows=${drivers} />
      <p>${number(report.calls)} calls. Least reward ${place(report.least)}, greatest ${place(report.greatest)}. ${time}</p>
      <${Table} caption="Parameters" heads=${["Parameter", "Least", "Greatest", "Read"]}
        rows=${report.parameters.map((each) => [each.name, short(each.least), short(each.greatest), each.read ? "yes" : "no"])} />
    </details>`;
}
