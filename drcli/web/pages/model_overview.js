// The reward graph of a training as consoles draw it, and what dr-analyze says about it.

import { get } from "/api.js";
import { chart } from "/charts.js";
import { empty, failure, fill, h, lapTime, moment, number } from "/dom.js";
import { act } from "/model_tasks.js";

/** The reward graph: episodes as dots, means as lines, the best checkpoint as a mark. */
export function rewardGraph(signal) {
  let curve = null,
    points = [];
  const words = (at) => points[at]?.text ?? "";
  const graph = chart(
    {
      title: "Reward graph",
      hint: "Dots are episodes, lines are means of an iteration. Drag to enlarge, double-click for all.",
      x: "Iteration",
      height: 320,
      series: [
        { name: "Reward of episodes", color: "c1", dots: true, faint: true },
        { name: "Mean reward", color: "c1", digits: 1 },
        { name: "Progress of episodes", color: "c2", dots: true, faint: true, axis: "right" },
        { name: "Mean progress", color: "c2", unit: "%", digits: 1, axis: "right" },
        {
          name: "Evaluation progress",
          color: "c3",
          unit: "%",
          digits: 1,
          axis: "right",
          dash: [6, 4],
        },
      ],
      limits: { right: [0, 105] },
      axes: { left: "Reward", right: "Progress, % of a lap" },
      mark: () =>
        curve?.best_iteration == null
          ? null
          : { x: curve.best_iteration, text: `best checkpoint ${curve.best_iteration}` },
      readout: words,
    },
    signal,
  );
  return {
    element: graph.element,
    update(value) {
      curve = value;
      points = pointsOf(value);
      graph.update([0, 1, 2, 3, 4, 5].map((k) => points.map((point) => point.row[k])));
    },
  };
}

function pointsOf({ iterations, episodes }) {
  const driven = new Map();
  for (const each of episodes) {
    if (each.evaluation) continue;
    if (!driven.has(each.iteration)) driven.set(each.iteration, []);
    driven.get(each.iteration).push(each);
  }
  const points = [];
  // Episodes come before the mean of their iteration, as they were driven.
  for (const [iteration, list] of driven)
    list.forEach((each, k) =>
      points.push({
        row: [
          iteration - 0.9 + (0.8 * (k + 0.5)) / list.length,
          each.reward,
          null,
          each.progress,
          null,
          null,
        ],
        text: `Iteration ${iteration}, an episode: reward ${number(each.reward)}, progress ${number(each.progress)} %`,
      }),
    );
  for (const each of iterations)
    points.push({
      row: [each.iteration, null, each.reward, null, each.progress, each.evaluation_progress],
      text:
        `Iteration ${each.iteration}: mean reward ${number(each.reward, 1)}, mean progress ${number(each.progress, 1)} %, evaluation ${number(each.evaluation_progress, 1)} % with ${number(each.evaluation_laps)} of ${number(each.evaluation_episodes)} laps clean` +
        (each.evaluation_reward == null ? "" : ` and reward ${number(each.evaluation_reward, 1)}`),
    });
  return points.sort((a, b) => a.row[0] - b.row[0]);
}

/** Verdict and advice; a button reads the training again. */
export function analysis(prefix, signal) {
  const result = h("div", { role: "status" });
  const links = h("span", { class: "actions" });
  const button = h("button", { type: "button", click: run }, "Analyse");
  const query = `prefix=${encodeURIComponent(prefix)}`;

  async function run() {
    fill(
      result,
      h(
        "p",
        { class: "quiet" },
        "The training is read and analysed. This takes some seconds; a long training takes longer.",
      ),
    );
    const found = await act("analyse", { prefix }, { button, signal });
    if (signal.aborted) return;
    if (found) fill(result, verdict(found));
    else fill(result);
    look();
  }

  async function look() {
    try {
      const { written, analysis: known } = await get(`/api/model/report/about?${query}`, signal);
      button.textContent = written ? "Analyse again" : "Analyse";
      fill(
        links,
        written
          ? [
              h(
                "a",
                {
                  class: "button",
                  href: `/api/model/report?${query}`,
                  target: "_blank",
                  rel: "noopener",
                },
                "Open the full report",
              ),
              h(
                "a",
                { class: "button", href: `/api/model/report?${query}&download`, download: "" },
                "Download it",
              ),
              h("span", { class: "quiet fine" }, `written ${moment(written)}`),
            ]
          : null,
      );
      if (!result.childNodes.length && known) fill(result, verdict(known));
      if (!result.childNodes.length)
        fill(
          result,
          written
            ? null
            : empty(
                "A verdict and advice are worked out from traces, curves and evaluations, with a report of graphs, map and laps.",
              ),
        );
    } catch (error) {
      if (error.name !== "AbortError") fill(links, failure(error));
    }
  }
  look();
  return h(
    "section",
    { "aria-labelledby": "analysis" },
    h("h2", { id: "analysis" }, "Verdict and advice"),
    result,
    h("p", { class: "actions" }, button, links),
  );
}

function verdict(found) {
  return [
    h("p", { class: "model-verdict" }, h("strong", {}, found.verdict.sentence)),
    h(
      "p",
      { class: "quiet" },
      `${number(found.episodes)} episodes, ${number(found.complete_laps)} clean laps` +
        (found.best_lap_s == null ? "." : `, the best in ${lapTime(found.best_lap_s)}.`) +
        (found.limit ? ` ${found.limit}.` : ""),
    ),
    found.advice.length
      ? h(
          "ol",
          { class: "model-advice" },
          found.advice.map((each) =>
            h(
              "li",
              {},
              h("strong", {}, each.title),
              h("p", {}, each.evidence),
              each.setting ? h("p", { class: "fine quiet" }, `Setting: ${each.setting}`) : null,
              each.command ? h("p", {}, h("code", {}, each.command)) : null,
            ),
          ),
        )
      : h("p", {}, "There is no advice: nothing stands out."),
    found.problems.length
      ? h(
          "details",
          {},
          h("summary", {}, `${found.problems.length} remarks about the files`),
          h(
            "ul",
            {},
            found.problems.map((each) => h("li", {}, each)),
          ),
        )
      : null,
  ];
}
