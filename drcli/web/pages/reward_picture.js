// The picture of a reward function: reward at each place of the track, and along the lap.

import { chart } from "/charts.js";
import { fill, h, number, table } from "/dom.js";

// Colours of viridis at equal steps, as in the picture of `dr-reward plot`.
const VIRIDIS = [
  "440154",
  "482475",
  "414487",
  "355f8d",
  "2a788e",
  "21918c",
  "22a884",
  "44bf70",
  "7ad151",
  "bddf26",
  "fde725",
].map((code) => [0, 2, 4].map((k) => parseInt(code.slice(k, k + 2), 16)));
const COLORS = ["c1", "c2", "c3", "c4", "c5", "c6"];
const UNKNOWN = "#b9bcc0";

function colorOf(part) {
  const at = Math.max(0, Math.min(1, part)) * (VIRIDIS.length - 1),
    k = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return `rgb(${VIRIDIS[k].map((value, c) => Math.round(value + (VIRIDIS[k + 1][c] - value) * (at - k))).join(",")})`;
}
const short = (value) =>
  value === null || value === undefined
    ? "–"
    : Math.abs(value) >= 1e4 || (value && Math.abs(value) < 1e-3)
      ? value.toExponential(2)
      : String(Number(value.toPrecision(4)));

export function rewardPicture(signal) {
  const canvas = h("canvas", {
    class: "reward-map",
    role: "img",
    "aria-label": "Map of rewards; the tables below have the numbers",
  });
  const scale = h("div", { class: "reward-scale", "aria-hidden": "true" }),
    low = h("span", {}),
    high = h("span", {});
  const about = h("p", { class: "readout" }, " ");
  const curves = h("div", { class: "reward-curves" }),
    tables = h("div", {});
  const element = h(
    "figure",
    { class: "reward-picture" },
    h(
      "figcaption",
      {},
      h("strong", {}, "Reward on the track"),
      " for a car at this place that points along the track",
    ),
    canvas,
    h("div", { class: "reward-legend" }, low, scale, high),
    about,
    curves,
    tables,
  );
  let course = null,
    picture = null,
    plot = null,
    names = "";
  for (let k = 0; k < 40; k++) {
    const piece = h("i", {});
    piece.style.setProperty("background", colorOf(k / 39));
    scale.append(piece);
  }

  function draw() {
    if (!course || !picture || !canvas.clientWidth) return;
    const ratio = Math.min(devicePixelRatio || 1, 2),
      wide = canvas.clientWidth,
      tall = canvas.clientHeight;
    canvas.width = wide * ratio;
    canvas.height = tall * ratio;
    const context = canvas.getContext("2d");
    const xs = course.edges.map(([x]) => x),
      ys = course.edges.map(([, y]) => y);
    const [left, right, bottom, top] = [
      Math.min(...xs),
      Math.max(...xs),
      Math.min(...ys),
      Math.max(...ys),
    ];
    const zoom = Math.min((wide - 16) / (right - left), (tall - 16) / (top - bottom));
    const px = (x) => (wide - zoom * (right - left)) / 2 + zoom * (x - left),
      py = (y) => (tall - zoom * (top - bottom)) / 2 + zoom * (top - y);
    context.scale(ratio, ratio);
    const { rows, columns, edges } = course,
      span = picture.high - picture.low;
    const corner = (row, column) => edges[row * columns + (column % columns)];
    // From the outside in: where parts of the track are close together, the road is on top.
    const order = Array.from({ length: rows }, (_, k) => k).sort(
      (a, b) => Math.abs(b - (rows >> 1)) - Math.abs(a - (rows >> 1)),
    );
    for (const row of order) {
      for (let column = 0; column < (course.closed ? columns : columns - 1); column++) {
        const value = picture.rewards[row * columns + column];
        context.fillStyle = context.strokeStyle =
          value === null ? UNKNOWN : colorOf(span > 0 ? (value - picture.low) / span : 0.5);
        context.lineWidth = 0.7;
        context.beginPath();
        [
          [row, column],
          [row, column + 1],
          [row + 1, column + 1],
          [row + 1, column],
        ].forEach(([r, c], k) => {
          const [x, y] = corner(r, c);
          if (k) context.lineTo(px(x), py(y));
          else context.moveTo(px(x), py(y));
        });
        context.closePath();
        context.fill();
        context.stroke();
      }
    }
    const line = (points, closed) => {
      context.beginPath();
      points.forEach(([x, y], k) =>
        k ? context.lineTo(px(x), py(y)) : context.moveTo(px(x), py(y)),
      );
      if (closed) context.closePath();
    };
    for (const border of [course.inner, course.outer]) {
      line(border, course.closed);
      context.strokeStyle = "#fff";
      context.lineWidth = 2.6;
      context.stroke();
      context.strokeStyle = "#1b1f24";
      context.lineWidth = 1.1;
      context.stroke();
    }
    for (const corners of course.objects) {
      line(corners, true);
      context.fillStyle = "#fff";
      context.fill();
      context.strokeStyle = "#1b1f24";
      context.lineWidth = 1.6;
      context.stroke();
    }
    const [x, y, yaw] = course.start,
      size = 13;
    context.save();
    context.translate(px(x), py(y));
    context.rotate(-yaw);
    context.beginPath();
    context.moveTo(size, 0);
    context.lineTo(-size * 0.6, size * 0.6);
    context.lineTo(-size * 0.6, -size * 0.6);
    context.closePath();
    context.fillStyle = "#fff";
    context.fill();
    context.strokeStyle = "#1b1f24";
    context.lineWidth = 1.8;
    context.stroke();
    context.restore();
  }
  const resize = new ResizeObserver(draw);
  resize.observe(canvas);
  signal.addEventListener("abort", () => resize.disconnect(), { once: true });

  return {
    element,
    get known() {
      return course?.key ?? "";
    },
    /** Show an answer of /api/reward/check. */
    show(report) {
      if (report.course) course = report.course;
      element.classList.toggle("old", !report.picture);
      if (!report.picture) {
        about.textContent = picture ? "This is the picture of an earlier version." : " ";
        return;
      }
      picture = report.picture;
      low.textContent = short(picture.low);
      high.textContent = short(picture.high);
      about.textContent = `${course.world}, ${course.race_type}; the car requests ${number(course.speed_mps, 1, "m/s")}. The arrow is the start. Reward per step.`;
      draw();
      const now = picture.curves.map((each) => each.name).join();
      if (now !== names) {
        names = now;
        plot = chart(
          {
            title: "Reward along the lap",
            hint: "of scripted drivers, per step",
            x: "Progress, %",
            height: 220,
            series: picture.curves.map((each, k) => ({
              name: each.name,
              color: COLORS[k % 6],
              digits: 3,
            })),
          },
          signal,
        );
        fill(curves, plot.element);
      }
      plot.update([picture.progress, ...picture.curves.map((each) => each.rewards)]);
      const { report: whole } = report;
      fill(
        tables,
        h(
          "details",
          {},
          h("summary", {}, "Numbers of the check"),
          table(
            "Drivers",
            ["Driver", "Drives", "Progress, %", "Time, s", "Sum of rewards", "Mean"],
            whole.drivers.map((each) => [
              each.name,
              each.about,
              number(each.progress, 1),
              number(each.seconds, 1),
              short(each.total),
              short(each.mean),
            ]),
          ),
          h(
            "p",
            {},
            `${number(whole.calls)} calls. Least reward ${whole.least ? `${short(whole.least.reward)} (${whole.least.place})` : "–"}, greatest ${whole.greatest ? `${short(whole.greatest.reward)} (${whole.greatest.place})` : "–"}.`,
            whole.time
              ? ` A call takes ${number(whole.time.median_us, 1)} µs (median), which makes the simulation ${number(whole.time.slower_percent, 1)} % slower.`
              : "",
          ),
          table(
            "Parameters",
            ["Parameter", "Least", "Greatest", "Read"],
            whole.parameters.map((each) => [
              each.name,
              short(each.least),
              short(each.greatest),
              each.read ? "yes" : "no",
            ]),
          ),
        ),
      );
    },
  };
}
