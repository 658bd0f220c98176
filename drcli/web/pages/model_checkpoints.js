// The checkpoints of a model, and how each of them drove.

import { bytes, fill, h, lapTime, number, table } from "/dom.js";

const WORDS = {
  last: "the newest",
  best: "the best",
  "first-lap": "of the first lap",
  "three-laps": "of three laps in one evaluation",
  "best-lap": "of the best lap",
};

/** Show checkpoints, the newest first; `found` is the answer of /api/model/checkpoints. */
export function drawCheckpoints(element, found) {
  fill(
    element,
    found.damaged.map((each) => h("div", { class: "problem" }, h("p", {}, each))),
    table(
      "Checkpoints",
      [
        "Number",
        "Marks",
        "Clean laps",
        "Progress",
        "Median lap",
        "Best lap",
        "Size",
        ...(found.checkpoints.some((each) => each.problem) ? ["Problem"] : []),
      ],
      found.checkpoints
        .slice()
        .reverse()
        .map((each) => [
          String(each.number),
          [
            each.words.map((word) =>
              h("span", { class: "model-badge", title: `Checkpoint ${WORDS[word] ?? word}` }, word),
            ),
            each.untaught
              ? h(
                  "span",
                  { class: "model-badge", title: "Until there, only the teacher has learned" },
                  "untaught",
                )
              : null,
            each.every ? h("span", { class: "model-badge" }, "kept every n") : null,
            each.form === "tensorflow"
              ? h(
                  "span",
                  { class: "model-badge", title: "Of DeepRacer-for-Cloud or a console" },
                  "TensorFlow",
                )
              : null,
          ]
            .flat()
            .reduce((cell, mark) => (mark && cell.append(mark, " "), cell), h("span")),
          each.episodes ? `${each.laps} of ${each.episodes}` : "–",
          each.progress == null ? "–" : number(each.progress, 1, "%"),
          lapTime(each.median_s),
          lapTime(each.best_lap_s),
          bytes(each.size_bytes),
          ...(each.problem ? [each.problem] : []),
        ]),
    ),
    h(
      "p",
      { class: "quiet fine" },
      `Laps are those of evaluations during the training, which end at the first violation. Together ${bytes(found.size_bytes)}. A training keeps the newest four checkpoints, the best one and the milestones.`,
      found.not_reached.length ? ` Not reached yet: ${found.not_reached.join(", ")}.` : "",
    ),
    found.milestones.some((each) => !each.kept)
      ? h(
          "p",
          { class: "quiet fine" },
          `Milestones whose checkpoints are gone: ${found.milestones
            .filter((each) => !each.kept)
            .map((each) => `${each.word} (${each.checkpoint})`)
            .join(", ")}.`,
        )
      : null,
  );
}
