// Entropy, losses, KL and speed of a training, by iteration.

import { chart } from "/charts.js";
import { h } from "/dom.js";

const known = (value) => (Number.isFinite(value) ? value : null);

/** `update` takes the iterations. */
export function lossCurves(signal) {
  const small = (spec) => chart({ x: "Iteration", height: 150, ...spec }, signal);
  const charts = [
    [
      small({
        title: "Entropy",
        hint: "Falls slowly while the policy becomes sure.",
        series: [{ name: "Entropy, nats", color: "c4", digits: 3 }],
      }),
      ["entropy"],
    ],
    [
      small({
        title: "Losses",
        hint: "Of the policy and of the value.",
        series: [
          { name: "Policy", color: "c1", digits: 4 },
          { name: "Value", color: "c2", digits: 3, axis: "right" },
        ],
      }),
      [
        ["surrogate_loss", "actor_loss"],
        ["value_loss", "critic_loss"],
      ],
    ],
    [
      small({
        title: "KL divergence",
        hint: "How far an update moves the policy.",
        series: [{ name: "KL", color: "c5", digits: 4 }],
      }),
      ["kl"],
    ],
    [
      small({
        title: "Speed",
        hint: "Driving and learning together.",
        series: [{ name: "Steps/s", color: "c6", digits: 0 }],
      }),
      ["steps_per_s"],
    ],
  ];
  const alpha = small({
    title: "Temperature of SAC",
    hint: "Weight of the entropy.",
    series: [{ name: "Alpha", color: "c3", digits: 4 }],
  });
  const imitation = small({
    title: "Imitation loss",
    hint: "How far the student is from its teacher, while it learns from it.",
    series: [{ name: "Loss", color: "c3", digits: 4 }],
  });
  alpha.element.hidden = imitation.element.hidden = true;
  const pick = (row, names) =>
    [names]
      .flat()
      .map((name) => known(row[name]))
      .find((value) => value !== null) ?? null;
  return {
    element: h(
      "div",
      { class: "live-curves" },
      charts.map(([each]) => each.element),
      alpha.element,
      imitation.element,
    ),
    update(rows) {
      const x = rows.map((row) => row.iteration);
      for (const [each, columns] of charts)
        each.update([x, ...columns.map((names) => rows.map((row) => pick(row, names)))]);
      for (const [each, name] of [
        [alpha, "alpha"],
        [imitation, "imitation_loss"],
      ])
        if (rows.some((row) => known(row[name]) !== null)) {
          each.element.hidden = false;
          each.update([x, rows.map((row) => known(row[name]))]);
        }
    },
  };
}
