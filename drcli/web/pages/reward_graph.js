// The reward graph as consoles draw it: episodes as dots, means of the iterations as lines.

import { h, number } from "/dom.js";
import { WHOLE_STEPS, drawMark } from "/graph_parts.js";
import { ink } from "/theme_colors.js";

const MOST_DOTS = 6000;
const HEIGHT = 320;

// Series of the plot after x, and the toggle of each.
const SERIES = [
  { group: 0, color: "c1", dots: "dots1" },
  { group: 0, color: "c1", line: true },
  { group: 1, color: "c2", dots: "dots2", right: true },
  { group: 1, color: "c2", line: true, right: true },
  { group: 2, color: "c3", dots: "dots3", right: true },
  { group: 2, color: "c3", line: true, right: true, dash: [6, 4] },
];
const GROUPS = [
  ["Reward", "c1"],
  ["Progress in training", "c2"],
  ["Progress in evaluations", "c3"],
  ["Episodes as dots", null],
];

const known = (value) => (Number.isFinite(value) ? value : null);

/** The element, and functions that take iterations, episodes (rows of four numbers) and the name of the best checkpoint. */
export function rewardGraph(signal) {
  const shown = GROUPS.map(() => true);
  const toggles = h(
    "div",
    { class: "toggles", role: "group", "aria-label": "Curves of the reward graph" },
    GROUPS.map(([name, swatch], k) =>
      h(
        "button",
        {
          type: "button",
          class: "toggle",
          "aria-pressed": "true",
          click: (event) => {
            shown[k] = !shown[k];
            event.currentTarget.setAttribute("aria-pressed", String(shown[k]));
            SERIES.forEach((each, at) => plot?.setSeries(at + 1, { show: isShown(each) }, false));
            plot?.redraw(true, true);
          },
        },
        swatch ? h("span", { class: `swatch ink-${swatch}` }) : null,
        name,
      ),
    ),
  );
  const place = h("div", { class: "plot live-reward-plot" });
  const readout = h(
      "p",
      { class: "readout live-reward-readout", role: "status", "aria-live": "off" },
      "The graph begins with the first finished iteration.",
    ),
    note = h("p", { class: "quiet live-reward-note" }, " ");
  const element = h(
    "figure",
    { class: "chart" },
    h(
      "figcaption",
      {},
      h("strong", {}, "Reward graph"),
      " Dots are episodes, lines are means of an iteration. Drag to enlarge, double-click for all.",
    ),
    toggles,
    place,
    readout,
    note,
  );
  place.style.setProperty("min-height", `${HEIGHT}px`);
  let plot = null,
    points = [],
    iterations = [],
    episodes = [],
    best = null,
    waiting = false,
    visible = true,
    late = false;

  const isShown = (each) => shown[each.group] && (!each.dots || shown[3]);

  // Drawn at most once in a frame, and not at all while it cannot be seen.
  const watcher = new IntersectionObserver(
    (entries) => {
      visible = entries.at(-1).isIntersecting;
      if (visible && late) schedule();
    },
    { rootMargin: "100px" },
  );
  watcher.observe(place);

  function schedule() {
    if (!visible) {
      late = true;
      return;
    }
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      late = false;
      if (!signal.aborted) draw();
    });
  }

  function pointsNow() {
    const all = [],
      every = Math.max(1, Math.ceil(episodes.length / MOST_DOTS));
    const counts = new Map(),
      seen = new Map();
    for (const [iteration, evaluation] of episodes)
      counts.set(2 * iteration + evaluation, (counts.get(2 * iteration + evaluation) ?? 0) + 1);
    episodes.forEach(([iteration, evaluation, reward, progress], k) => {
      const key = 2 * iteration + evaluation,
        at = seen.get(key) ?? 0;
      seen.set(key, at + 1);
      if (k % every) return;
      const x = iteration - 0.4 + (0.8 * (at + 0.5)) / counts.get(key);
      all.push(
        evaluation
          ? [x, null, null, null, null, progress, null, episodes[k]]
          : [x, reward, null, progress, null, null, null, episodes[k]],
      );
    });
    for (const row of iterations)
      all.push([
        row.iteration,
        null,
        known(row.mean_reward),
        null,
        known(row.mean_progress),
        null,
        mean(row.evaluation_progress),
        row,
      ]);
    all.sort((a, b) => a[0] - b[0]);
    note.textContent =
      every > 1 ? `Every ${every}th of ${number(episodes.length)} episodes is drawn.` : " ";
    return all;
  }

  function draw() {
    points = pointsNow();
    const columns = [0, 1, 2, 3, 4, 5, 6].map((k) => points.map((point) => point[k]));
    // A part that somebody looks at stays as it is.
    const zoomed = plot && zoom !== null;
    if (!plot && place.isConnected) build(columns);
    else plot?.setData(columns, !zoomed);
    if (zoomed) plot.redraw(false, false);
    if ((plot && plot.cursor.idx === null) || plot?.cursor.left < 0) read(null);
  }

  let zoom = null;
  function read(index) {
    const point =
      index === null || index === undefined
        ? points.findLast((each) => !Array.isArray(each[7]))
        : points[index];
    if (!point) return;
    const about = point[7];
    readout.textContent = Array.isArray(about)
      ? `Iteration ${number(about[0])}, ${about[1] ? "an evaluation" : "an episode"}: reward ${number(about[2])}, progress ${number(about[3])} %`
      : `Iteration ${number(about.iteration)}: mean reward ${number(known(about.mean_reward), 1)}, mean progress ${number(known(about.mean_progress), 1)} %, evaluation ${number(mean(about.evaluation_progress), 1)} % with ${number(about.evaluation_lap_s?.length ?? 0)} of ${number(about.evaluation_progress?.length ?? 0)} laps clean` +
        (about.best_lap_s === null || about.best_lap_s === undefined
          ? ""
          : `, best training lap ${number(about.best_lap_s, 2)} s`);
  }

  function drawBest(self) {
    const found = /^(\d+)_/.exec(best ?? "");
    if (!found) return;
    drawMark(self, Number(found[1]), `best checkpoint ${found[1]}`, {
      ink: ink("good"),
      paper: ink("paper"),
    });
  }

  function build(columns) {
    plot?.destroy();
    const axis = {
      stroke: ink("quiet"),
      grid: { stroke: ink("line"), width: 1 },
      ticks: { stroke: ink("line") },
      font: "12px system-ui",
      labelFont: "12px system-ui",
      labelSize: 18,
    };
    zoom = null;
    plot = new uPlot(
      {
        width: Math.max(place.clientWidth, 200),
        height: HEIGHT,
        legend: { show: false },
        cursor: { drag: { x: true, y: false } },
        scales: {
          x: {
            time: false,
            range: (self, low, high) => (low === high ? [low - 1, high + 1] : [low, high]),
          },
          right: { range: [0, 105] },
        },
        axes: [
          { ...axis, incrs: WHOLE_STEPS },
          { ...axis, size: 50, label: "Reward" },
          {
            ...axis,
            scale: "right",
            side: 1,
            grid: { show: false },
            size: 44,
            label: "Progress, % of a lap",
          },
        ],
        series: [
          {},
          ...SERIES.map((each) => ({
            scale: each.right ? "right" : "y",
            show: isShown(each),
            spanGaps: true,
            stroke: ink(each.color),
            width: each.dots ? 0 : 2,
            dash: each.dash,
            paths: each.dots ? () => null : undefined,
            points: {
              show: each.dots ? true : () => iterations.length < 2,
              size: each.dots ? 4 : 8,
              width: 0,
              fill: ink(each.dots ?? each.color),
              stroke: ink(each.dots ?? each.color),
            },
          })),
        ],
        hooks: {
          setCursor: [(self) => read(self.cursor.left < 0 ? null : self.cursor.idx)],
          draw: [drawBest],
          setSelect: [
            (self) => {
              if (self.select.width > 0) zoom = true;
            },
          ],
        },
      },
      columns,
      place,
    );
    plot.over.addEventListener("dblclick", () => {
      zoom = null;
    });
  }

  const resize = new ResizeObserver(() => {
    if (plot && place.clientWidth) plot.setSize({ width: place.clientWidth, height: HEIGHT });
  });
  resize.observe(place);
  addEventListener(
    "themechange",
    () => {
      if (plot) {
        const data = plot.data;
        build(data);
      }
    },
    { signal },
  );
  signal.addEventListener(
    "abort",
    () => {
      watcher.disconnect();
      resize.disconnect();
      plot?.destroy();
      plot = null;
    },
    { once: true },
  );
  return {
    element,
    setIterations(rows) {
      iterations = rows;
      schedule();
    },
    setEpisodes(rows, error) {
      if (error) {
        note.textContent = `${error.message} The dots are older.`;
        return;
      }
      episodes = rows;
      schedule();
    },
    setBest(name) {
      if (name !== best) {
        best = name;
        schedule();
      }
    },
  };
}

function mean(values) {
  return values?.length ? values.reduce((sum, value) => sum + value, 0) / values.length : null;
}
