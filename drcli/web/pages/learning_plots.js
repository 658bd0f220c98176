// What a training has learned: the reward graph as consoles draw it, and the curves of its losses.

import { Plot } from "/plot.js";
import { mean, number } from "/text.js";
import { html, useMemo } from "/ui.js";

const MOST_DOTS = 6000;
const SERIES = [
  { name: "Reward of an episode", group: "Reward", color: "c1", dots: "dots1" },
  { name: "Reward", color: "c1" },
  {
    name: "Progress of an episode",
    group: "Progress in training",
    color: "c2",
    dots: "dots2",
    axis: "right",
  },
  { name: "Progress in training", color: "c2", axis: "right" },
  {
    name: "Progress of a trial",
    group: "Progress in evaluations",
    color: "c3",
    dots: "dots3",
    axis: "right",
  },
  { name: "Progress in evaluations", color: "c3", axis: "right", dash: [6, 4] },
];

const known = (value) => (Number.isFinite(value) ? value : null);

/**
 * Points of the reward graph from left to right: x, a value for each series, and the row that it is about.
 * @param {Object[]} iterations
 * @param {number[][]} episodes iteration, 1 for an evaluation, reward, progress
 */
export function rewardPoints(iterations, episodes) {
  const every = Math.max(1, Math.ceil(episodes.length / MOST_DOTS));
  /** @param {number[]} episode */
  const key = ([iteration, evaluation]) => 2 * iteration + evaluation;
  const counts = new Map();
  for (const each of episodes) counts.set(key(each), (counts.get(key(each)) ?? 0) + 1);
  const seen = new Map();
  const points = [];
  episodes.forEach((episode, k) => {
    const [iteration, evaluation, reward, progress] = episode;
    const at = seen.get(key(episode)) ?? 0;
    seen.set(key(episode), at + 1);
    if (k % every) return;
    const x = iteration - 0.4 + (0.8 * (at + 0.5)) / counts.get(key(episode));
    const values = evaluation
      ? [null, null, null, null, progress, null]
      : [reward, null, progress, null, null, null];
    points.push([x, ...values, episode]);
  });
  for (const row of iterations) {
    const values = [
      null,
      known(row.mean_reward),
      null,
      known(row.mean_progress),
      null,
      mean(row.evaluation_progress),
    ];
    points.push([row.iteration, ...values, row]);
  }
  return points.sort((a, b) => a[0] - b[0]);
}

function readPoint(point) {
  if (!point) return "";
  const about = point[7];
  if (Array.isArray(about))
    return `Iteration ${number(about[0])}, ${about[1] ? "an evaluation" : "an episode"}: reward ${number(about[2])}, progress ${number(about[3])} %`;
  const best = about.best_lap_s ?? null;
  const trials = about.evaluation_progress?.length ?? 0;
  return [
    `Iteration ${number(about.iteration)}: mean reward ${number(known(about.mean_reward), 1)}`,
    `mean progress ${number(known(about.mean_progress), 1, "%")}`,
    trials &&
      `evaluation ${number(mean(about.evaluation_progress), 1, "%")} with ${number(about.evaluation_lap_s?.length ?? 0)} of ${number(trials)} laps clean`,
    best !== null && `best training lap ${number(best, 2, "s")}`,
  ]
    .filter(Boolean)
    .join(", ");
}

/** @param {{iterations: Object[], episodes: number[][], best: string | null, height?: number}} props best: name of a checkpoint */
export function RewardPlot({ iterations, episodes, best, height = 300 }) {
  const points = useMemo(() => rewardPoints(iterations, episodes), [iterations, episodes]);
  const data = useMemo(
    () => [0, 1, 2, 3, 4, 5, 6].map((k) => points.map((point) => point[k])),
    [points],
  );
  const marked = /^(\d+)_/.exec(best ?? "")?.[1];
  return html`<${Plot} title="Reward graph" hint="Dots are episodes, lines are means of an iteration. Drag to enlarge, double-click for all."
    height=${height} series=${SERIES} data=${data} limits=${{ right: [0, 105] }}
    axes=${{ left: "Reward", right: "Progress, % of a lap" }}
    mark=${marked ? { x: Number(marked), text: `best checkpoint ${marked}` } : null}
    nothing="The graph begins with the first finished iteration."
    read=${(index) => readPoint(index === null ? points.findLast((each) => !Array.isArray(each[7])) : points[index])} />`;
}

/** @type {[string, string, (string | number)[][]][]} */
const LOSSES = [
  [
    "Entropy",
    "Falls slowly while the policy becomes sure.",
    [["Entropy, nats", "c4", 3, "entropy"]],
  ],
  [
    "Losses",
    "Of the policy and of the value.",
    [
      ["Policy", "c1", 4, "surrogate_loss", "actor_loss"],
      ["Value", "c2", 3, "value_loss", "critic_loss"],
    ],
  ],
  ["KL divergence", "How far an update moves the policy.", [["KL", "c5", 4, "kl"]]],
  ["Speed", "Driving and learning together.", [["Steps/s", "c6", 0, "steps_per_s"]]],
  ["Temperature of SAC", "Weight of the entropy.", [["Alpha", "c3", 4, "alpha"]]],
  [
    "Imitation loss",
    "How far the student is from its teacher, while it learns from it.",
    [["Loss", "c3", 4, "imitation_loss"]],
  ],
];

/** Curves of everything that the algorithm of this training has. @param {{rows: Object[]}} props */
export function LossPlots({ rows }) {
  const pick = (row, keys) =>
    keys.map((key) => known(row[key])).find((value) => value !== null) ?? null;
  const plots = useMemo(() => {
    const x = rows.map((row) => row.iteration);
    return LOSSES.map(([title, hint, parts]) => ({
      title,
      hint,
      series: parts.map(([name, color, digits], k) => ({
        name,
        color,
        digits,
        ...(k && { axis: "right" }),
      })),
      data: [x, ...parts.map(([, , , ...keys]) => rows.map((row) => pick(row, keys)))],
    })).filter(({ data }) =>
      data.slice(1).some((column) => column.some((value) => value !== null)),
    );
  }, [rows]);
  return html`<div class="live-curves">
    ${plots.map((each) => html`<${Plot} key=${each.title} height=${150} ...${each} />`)}
    ${!plots.length && html`<p class="quiet">The curves begin with the first finished iteration.</p>`}
  </div>`;
}
