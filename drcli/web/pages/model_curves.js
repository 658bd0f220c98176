// The learning curves of two trainings over each other, with what chance alone would do.

import { Plot } from "/plot.js";
import { useGet } from "/store.js";
import { number } from "/text.js";
import { html, useMemo } from "/ui.js";

const Z = 1.96; // 95 % of a normal distribution
const COLORS = ["c1", "c2"];

/**
 * The share of clean laps in percent, and the range in which the true share lies with 95 % (E. B. Wilson, 1927).
 * @param {number} clean
 * @param {number} laps
 * @returns {[number, number, number]} share, low, high
 */
export function cleanShare(clean, laps) {
  const share = clean / laps;
  const scale = 1 + Z ** 2 / laps;
  const middle = (share + Z ** 2 / (2 * laps)) / scale;
  const half = (Z / scale) * Math.sqrt((share * (1 - share)) / laps + Z ** 2 / (4 * laps ** 2));
  return [100 * share, 100 * Math.max(0, middle - half), 100 * Math.min(1, middle + half)];
}

/** Columns of numbers by iteration, where each training has its own iterations. */
function columns(rows, iterations, pick) {
  const known = new Map(rows.map((row) => [row.iteration, pick(row)]));
  return iterations.map((iteration) => known.get(iteration) ?? null);
}

/** @param {{prefix: string, other: string, sameReward: boolean}} props `sameReward`: whether their rewards can be compared */
export function BothCurves({ prefix, other, sameReward }) {
  const path = (name) => `/api/model/curve?prefix=${encodeURIComponent(name)}`;
  const names = [other, prefix];
  const curves = [useGet(path(other)).value, useGet(path(prefix)).value];
  const found = useMemo(() => {
    if (!curves.every(Boolean)) return null;
    const rows = curves.map((each) => each.iterations);
    const x = [...new Set(rows.flat().map((row) => row.iteration))].sort((a, b) => a - b);
    const share = (k) => (row) =>
      row.evaluation_episodes ? cleanShare(row.evaluation_laps, row.evaluation_episodes)[k] : null;
    const clean = rows.flatMap((each) => [0, 1, 2].map((k) => columns(each, x, share(k))));
    const rewards = rows.map((each) => columns(each, x, (row) => row.reward));
    return { clean: [x, ...clean], rewards: [x, ...rewards] };
  }, curves);
  if (!found) return null;
  const shares = names.flatMap((name, k) => [
    { name, color: COLORS[k], unit: "%", digits: 0 },
    { name: `${name}, low`, group: name, color: COLORS[k], hidden: true },
    { name: `${name}, high`, group: name, color: COLORS[k], hidden: true },
  ]);
  const at = (index) => {
    const last =
      index ??
      found.clean[0].findLastIndex((_, k) =>
        [1, 4].some((column) => found.clean[column][k] !== null),
      );
    if (last < 0) return "None of them was evaluated.";
    const said = names.map((name, k) => {
      const [share, low, high] = [1, 2, 3].map((part) => found.clean[3 * k + part][last]);
      return share === null || share === undefined
        ? `${name} was not evaluated`
        : `${name} ${number(share, 0, "%")} (${number(low)} to ${number(high)})`;
    });
    return `Iteration ${number(found.clean[0][last])}: ${said.join(", ")}`;
  };
  return html`
    <${Plot} title="Clean laps in evaluations" hint="The band is where the true share lies with 95 %: bands that overlap may differ by chance alone."
      series=${shares} data=${found.clean} limits=${{ y: [0, 105] }} axes=${{ left: "% of the laps" }} read=${at}
      bands=${[
        [3, 2, "c1"],
        [6, 5, "c2"],
      ]} />
    ${
      sameReward
        ? html`<${Plot} title="Mean reward" series=${names.map((name, k) => ({ name, color: COLORS[k], digits: 1 }))} data=${found.rewards} axes=${{ left: "Reward" }} />`
        : html`<p class="quiet">Their reward functions differ, so their rewards cannot be compared.</p>`
    }`;
}
