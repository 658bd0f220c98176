// Stored evaluations: their trials, two side by side, and their videos.

import { empty, fill, fillButtons, h, lapTime, number, stampText, table } from "/dom.js";
import { ask, check, field, select } from "/form_dialog.js";
import { act, save } from "/model_tasks.js";

const label = (each) =>
  [
    stampText(each.stamp),
    each.world,
    each.reverse ? "reverse" : "",
    each.checkpoint ? `checkpoint ${each.checkpoint.split("_")[0]}` : "",
    `${each.clean_laps} of ${each.trials.length} laps clean`,
    each.best_lap_s == null ? "" : lapTime(each.best_lap_s),
  ]
    .filter(Boolean)
    .join(" · ");
/** How a trial ended; a finished lap may have resets and penalties. */
const ended = (trial) =>
  trial.clean ? "Clean lap" : trial.status === "Lap complete" ? "Finished" : trial.status;
const sum = (each, name) => each.trials.reduce((total, trial) => total + trial[name], 0);

export function evaluationPart(prefix, { signal, evaluate }) {
  const running = h("div", { role: "status" });
  const body = h("div");
  const element = h("div", {}, running, body);
  const chosen = { one: "", other: "", video: "" };
  let list = null,
    shown = "";

  function update(value) {
    list = value;
    if (!list.evaluations.some((each) => each.stamp === chosen.one)) chosen.one = "";
    const newest = list.evaluations[0]?.stamp;
    // A new result is shown at once, unless an older one was chosen.
    if (newest && newest !== chosen.newest) {
      if (!chosen.one || chosen.one === chosen.newest) chosen.one = newest;
      chosen.newest = newest;
    }
    draw();
  }

  function draw() {
    const state = JSON.stringify([list, chosen]);
    if (state === shown) return;
    shown = state;
    if (!list.evaluations.length) {
      fill(
        body,
        empty(
          "This model has no stored evaluation yet.",
          h("button", { type: "button", class: "main", click: evaluate }, "Evaluate it"),
        ),
      );
      return;
    }
    const one = list.evaluations.find((each) => each.stamp === chosen.one) ?? list.evaluations[0];
    const other = list.evaluations.find((each) => each.stamp === chosen.other);
    const options = list.evaluations.map((each) => [each.stamp, label(each)]);
    const pick = (name, extra) => {
      const control = select(
        name,
        [...extra, ...options],
        name === "one" ? one.stamp : chosen.other,
      );
      control.addEventListener("change", () => {
        chosen[name] = control.value;
        chosen.video = "";
        draw();
        body.querySelector(`[name=${name}]`)?.focus();
      });
      return control;
    };
    fill(
      body,
      h(
        "div",
        { class: "model-tools" },
        field("Evaluation", pick("one", [])),
        list.evaluations.length > 1
          ? field("Compare with", pick("other", [["", "nothing"]]))
          : null,
      ),
      list.total > list.evaluations.length
        ? h(
            "p",
            { class: "quiet" },
            `The newest ${list.evaluations.length} of ${list.total} evaluations are listed.`,
          )
        : null,
      other && other !== one ? comparison(one, other) : single(one),
      player(one),
    );
  }

  function single(one) {
    if (one.problem) return h("div", { class: "problem" }, h("p", {}, one.problem));
    const off = one.off_track_penalty_s,
      hit = one.collision_penalty_s;
    const rows = one.trials.map((trial) => [
      String(trial.trial),
      trial.time_text,
      `${number(trial.progress)} %`,
      ended(trial),
      String(trial.off_track),
      String(trial.crashes),
      String(trial.resets),
    ]);
    return [
      h(
        "p",
        {},
        [
          one.world && `Track ${one.world}${one.reverse ? ", in reverse" : ""}`,
          one.race_type && one.race_type.toLowerCase().replaceAll("_", " "),
          one.checkpoint && `checkpoint ${one.checkpoint}`,
          one.summary,
        ]
          .filter(Boolean)
          .join("; "),
        ".",
      ),
      table(
        "Trials",
        ["Trial", "Time", "Completed", "Status", "Off-tracks", "Crashes", "Resets"],
        rows,
      ),
      h(
        "p",
        { class: "quiet fine" },
        "Times are those of the simulation, penalties included.",
        off == null
          ? ""
          : ` Leaving the track costs ${number(off, 1)} s, a crash ${number(hit, 1)} s.`,
      ),
    ];
  }

  function comparison(one, other) {
    const figures = [
      ["Track", (each) => each.world || "–"],
      ["Direction", (each) => (each.reverse == null ? "–" : each.reverse ? "reverse" : "as built")],
      ["Checkpoint", (each) => each.checkpoint || "–"],
      ["Clean laps", (each) => `${each.clean_laps} of ${each.trials.length}`],
      ["Finished laps", (each) => `${each.complete_laps} of ${each.trials.length}`],
      ["Best clean lap", (each) => lapTime(each.best_lap_s), (each) => each.best_lap_s],
      [
        "Mean of finished laps, with penalties",
        (each) => lapTime(each.mean_lap_s),
        (each) => each.mean_lap_s,
      ],
      ["Off-tracks", (each) => String(sum(each, "off_track"))],
      ["Crashes", (each) => String(sum(each, "crashes"))],
      ["Resets", (each) => String(sum(each, "resets"))],
    ];
    const difference = (value) => {
      const [a, b] = [value?.(one), value?.(other)];
      return a == null || b == null
        ? ""
        : `${a - b > 0 ? "+" : "−"}${number(Math.abs(a - b), 3, "s")}`;
    };
    const trials = Array.from(
      { length: Math.max(one.trials.length, other.trials.length) },
      (_, k) => [
        String(k + 1),
        ...[one, other].map((each) =>
          each.trials[k]
            ? `${each.trials[k].time_text}, ${ended(each.trials[k]).toLowerCase()}`
            : "–",
        ),
      ],
    );
    const names = [stampText(one.stamp), stampText(other.stamp)];
    return [
      table(
        "Two evaluations",
        ["Figure", ...names, "Difference"],
        figures.map(([name, text, value]) => [name, text(one), text(other), difference(value)]),
      ),
      table("Their trials", ["Trial", ...names], trials),
      one.world && other.world && one.world !== other.world
        ? h("p", { class: "quiet" }, "The tracks differ, so times cannot be compared.")
        : null,
    ];
  }

  function player(one) {
    const own = list.videos.filter((name) => name === `evaluation-${one.stamp}/video.mp4`);
    const others = list.videos.filter((name) => name.startsWith("mp4/"));
    const names = [...own, ...(one === list.evaluations[0] ? others : [])];
    const make = h(
      "button",
      { type: "button", disabled: !one.trace, click: () => filming(one, make) },
      own.length ? "Make another video" : "Make a video",
    );
    if (!names.length)
      return [
        h("h2", {}, "Video"),
        empty(
          one.trace
            ? "There is no video of this evaluation yet; it can be made from its stored steps."
            : "There is no video of this evaluation, and its steps are not stored.",
          one.trace ? make : null,
          steps(one),
        ),
      ];
    const name = names.includes(chosen.video) ? chosen.video : names[0];
    const source = `/api/model/video?prefix=${encodeURIComponent(prefix)}&name=${encodeURIComponent(name)}`;
    const views = {
      "camera-pip": "from behind, with the camera",
      "camera-45degree": "from behind",
      "camera-topview": "from above",
    };
    const control = select(
      "video",
      names.map((each) => [
        each,
        each.startsWith("mp4/")
          ? `newest evaluation, ${views[each.split("/")[1]] ?? each}`
          : "this evaluation",
      ]),
      name,
    );
    control.addEventListener("change", () => {
      chosen.video = control.value;
      draw();
      body.querySelector("[name=video]")?.focus();
    });
    return [
      h("h2", {}, "Video"),
      names.length > 1 ? field("View", control) : null,
      film(source, one),
      h(
        "p",
        { class: "actions" },
        h("a", { class: "button", href: `${source}&download`, download: "" }, "Download the video"),
        make,
        steps(one),
      ),
    ];
  }

  /** A link to the player of stored episodes. */
  function steps(one) {
    const query = new URLSearchParams({
      model: prefix,
      trace: `evaluation-${one.stamp}/evaluation-simtrace/0-iteration.csv`,
      episode: "0",
    });
    return one.trace ? h("a", { class: "button", href: `#/play?${query}` }, "Step by step") : null;
  }

  // The same element again, so that a video goes on playing when the rest is drawn anew.
  let playing = { source: "", element: null };
  function film(source, one) {
    if (playing.source !== source)
      playing = {
        source,
        element: h("video", {
          class: "model-video",
          controls: true,
          preload: "metadata",
          src: source,
          "aria-label": `Video of the evaluation of ${stampText(one.stamp)}`,
        }),
      };
    return playing.element;
  }

  async function filming(one, button) {
    const values = await ask({
      title: `Make a video of the evaluation of ${stampText(one.stamp)}`,
      action: "Make the video",
      intro: h(
        "p",
        {},
        "The video is drawn from the stored steps; a minute of driving takes some minutes.",
      ),
      fields: [
        field(
          "What",
          select(
            "episode",
            [
              ["best", "the best lap"],
              ["all", "all laps"],
              ...one.trials.slice(0, 100).map((trial, k) => [String(k), `trial ${trial.trial}`]),
            ],
            "best",
          ),
        ),
        field("Size", select("size", ["640x480", "1280x720"], "640x480")),
        field("Ghosts of other laps", select("ghosts", ["0", "1", "2", "3", "4"], "0")),
        h("p", {}, check("Show which pixels move the action", "explain")),
        h("p", {}, check("Only download it; the stored video stays", "download")),
      ],
    });
    if (!values) return;
    const made = await act(
      "film",
      { prefix, stamp: one.stamp, ...values, ghosts: Number(values.ghosts) },
      { button, signal },
    );
    if (made?.url) save(made);
    else if (made) playing = { source: "", element: null };
  }

  return {
    element,
    update,
    running(evaluations, stop) {
      fillButtons(
        running,
        evaluations.map((each) =>
          h(
            "p",
            { class: "empty" },
            `An evaluation has been running since ${new Date(each.started_at * 1000).toLocaleTimeString("en-GB")}: ${each.checkpoint} on ${each.world}. Its result appears here. `,
            h("button", { type: "button", click: (event) => stop(event.currentTarget) }, "Stop it"),
          ),
        ),
      );
    },
  };
}
