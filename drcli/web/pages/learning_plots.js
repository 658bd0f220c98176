// What a training has learned: the reward graph as consoles draw it, and the curves of its losses.

import { Plot, aligned } from "/plot.js";
import { mean } from "/text.js";
import { html, useMemo } from "/ui.js";

const MOST_DOTS = 6000;
const DOT = 4;
const LIMITS = { right: [0, 105] };
const AXES = { left: "Reward", right: "Progress, % of a lap" };

const known = (value) => (Number.isFinite(value) ? value : null);

/**
 * Columns of the reward graph and what its curves are: dots are episodes, lines are means of iterations.
 * @param {Object[]} iterations
 * @param {number[][]} episodes iteration, 1 for an evaluation, reward, progress
 */
export function rewardGraph(iterations, episodes) {
  const every = Math.max(1, Math.ceil(episodes.length / MOST_DOTS));
  const line = (value) => ({
    x: iterations.map((row) => row.iteration),
    y: iterations.map(value),
  });
  /** Episodes of an iteration lie beside each other. @param {number} kind @param {number} column */
  const dots = (kind, column) => {
    const groups = Object.groupBy(
      episodes.filter((each) => each[1] === kind),
      ([iteration]) => iteration,
    );
    const points = Object.values(groups)
      .flatMap((group) =>
        group.map((each, k) => [each[0] - 0.4 + (0.8 * (k + 0.5)) / group.length, each[column]]),
      )
      .filter((_, k) => k % every === 0);
    return { x: points.map(([x]) => x), y: points.map(([, y]) => y) };
  };
  const progress = { axis: /** @type {"right"} */ ("right"), unit: "%", digits: 1 };
  const series = [
    { name: "Reward of an episode", color: "dots1", dots: DOT, ...dots(0, 2) },
    { name: "Mean reward", color: "c1", ...line((row) => row.mean_reward) },
    { name: "Progress of an episode", color: "dots2", dots: DOT, ...progress, ...dots(0, 3) },
    { name: "Mean progress", color: "c2", ...progress, ...line((row) => row.mean_progress) },
    { name: "Progress of a trial", color: "dots3", dots: DOT, ...progress, ...dots(1, 3) },
    {
      ...{ name: "Mean progress in evaluations", color: "c3", dash: [6, 4], ...progress },
      ...line((row) => mean(row.evaluation_progress)),
    },
  ];
  return { data: aligned(series), series: series.map(({ x, y, ...look }) => look) };
}

/** @param {{iterations: Object[], episodes: number[][], best: string | null, height?: number}} props best: name of a checkpoint */
export function RewardPlot({ iterations, episodes, best, height = 300 }) {
  const graph = useMemo(() => rewardGraph(iterations, episodes), [iterations, episodes]);
  const marked = /^(\d+)_/.exec(best ?? "")?.[1];
  return html`<${Plot} title="Reward graph" hint="Dots are episodes, lines are means of an iteration. Drag to enlarge, double-click for all."
    height=${height} ...${graph} limits=${LIMITS} axes=${AXES}
    marks=${marked ? [{ x: Number(marked), label: `best checkpoint ${marked}` }] : []}
    nothing="The graph begins with the first finished iteration." />`;
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
