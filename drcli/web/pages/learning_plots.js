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

/** Title, hint, colour, digits, and what the rows of an algorithm call it. @type {[string, string, string, number, ...string[]][]} */
const LOSSES = [
  ["Entropy", "In nats. Falls slowly while the policy becomes sure.", "c4", 3, "entropy"],
  ["Loss of the policy", "", "c1", 4, "surrogate_loss", "actor_loss"],
  ["Loss of the value", "", "c2", 3, "value_loss", "critic_loss"],
  ["KL divergence", "How far an update moves the policy.", "c5", 4, "kl"],
  ["Steps per second", "Driving and learning together.", "c6", 0, "steps_per_s"],
  ["Temperature of SAC", "Weight of the entropy.", "c3", 4, "alpha"],
  ["Imitation loss", "How far the student is from its teacher.", "c3", 4, "imitation_loss"],
];

/** Curves of everything that the algorithm of this training has. @param {{rows: Object[]}} props */
export function LossPlots({ rows }) {
  const plots = useMemo(() => {
    const x = rows.map((row) => row.iteration);
    return LOSSES.map(([title, hint, color, digits, ...names]) => {
      const values = rows.map((row) => known(names.map((name) => row[name]).find(Number.isFinite)));
      return { title, hint, series: [{ name: title, color, digits }], data: [x, values] };
    }).filter(({ data }) => data[1].some(Number.isFinite));
  }, [rows]);
  return html`<div class="live-curves">
    ${plots.map((each) => html`<${Plot} key=${each.title} height=${150} ...${each} />`)}
    ${!plots.length && html`<p class="quiet">The curves begin with the first finished iteration.</p>`}
  </div>`;
}
