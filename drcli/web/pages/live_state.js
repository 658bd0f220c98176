// The run in a sentence, what to do next, its figures, and what its watches say.

import { failure, fill, fillButtons, h, duration, number, prose, tiles } from "/dom.js";
import { act } from "/model_tasks.js";
import { get } from "/api.js";

const WORDS = {
  starting: "starts",
  running: "runs",
  finished: "has finished",
  stopped: "was stopped",
  interrupted: "was interrupted",
  failed: "failed",
  lost: "ended without saying why",
};
const DOTS = {
  starting: "warn",
  running: "good",
  finished: "good",
  failed: "bad",
  lost: "bad",
  interrupted: "warn",
};

const modelLink = (prefix) => `#/model?prefix=${encodeURIComponent(prefix)}`;

/** The element, and functions that take what is known. */
export function runState(runId, signal) {
  const sentence = h("p", { class: "live-sentence" }, "The state of the run is being read.");
  const next = h("p", { class: "quiet" }, " ");
  const actions = h("p", { class: "actions" });
  const said = h("div", { class: "live-said" });
  const [figures, setFigures] = tiles([
    "Iteration",
    "Steps",
    "Steps a second",
    "Time of training",
    "Cost",
    "Requests to the bucket",
    "Best checkpoint",
    "Newest evaluation",
  ]);
  const element = h(
    "section",
    { class: "live-state", "aria-label": "State of the run" },
    h("div", { role: "status" }, sentence, next),
    actions,
    figures,
    said,
  );
  const stop = h(
    "button",
    { type: "button", class: "danger", click: () => stopRun() },
    "Stop the training",
  );
  const resume = h(
    "button",
    { type: "button", class: "main", click: () => resumeRun() },
    "Resume the training",
  );
  let run = null,
    rows = [],
    elsewhere = null,
    shown = "",
    told = "",
    about = null,
    busy = false,
    broken = false;

  const readFolder = () =>
    get("/api/folder", signal).then(
      (value) => {
        about = value;
        draw();
      },
      () => {},
    );
  readFolder();

  async function stopRun() {
    busy = true;
    draw();
    await act("stop", { prefix: run.prefix }, { button: stop, signal });
    busy = false;
    draw();
  }
  async function resumeRun() {
    busy = true;
    draw();
    await act("start", { prefix: run.prefix }, { button: resume, signal });
    busy = false;
    draw();
  }

  function draw() {
    if (!run) return;
    const [text, hint, buttons] = describe();
    const key = JSON.stringify([text, hint, buttons.map((each) => each.textContent), busy]);
    if (key !== shown) {
      shown = key;
      fill(
        sentence,
        h("span", { class: `dot ${elsewhere?.host ? "good" : (DOTS[run.state] ?? "")}` }),
        text,
      );
      fill(next, prose(hint || " "));
      fillButtons(actions, buttons);
    }
    drawFigures();
    drawSaid();
  }

  function describe() {
    const link = (text, href, main = false) =>
      h("a", { class: main ? "button main" : "button", href }, text);
    if (elsewhere?.host && run.state !== "running" && run.state !== "starting") {
      return [
        `The training of ${elsewhere.prefix} runs on ${elsewhere.host}, last heard from ${duration(elsewhere.heard_s)} ago.`,
        "This page reads the bucket: figures and maps of finished iterations come every few seconds. Live pictures are shown on that machine only; stop the training there.",
        [link("Open the model", modelLink(elsewhere.prefix))],
      ];
    }
    if (run.state === "none" && run.unreachable) {
      return [
        `Nothing runs here. Whether ${run.prefix} was trained, or another machine trains it, is unknown.`,
        run.unreachable,
        [],
      ];
    }
    if (run.state === "none") {
      return [
        "There is no training yet.",
        "Set one up: name, track, reward function and actions. It takes some minutes; everything can be changed later.",
        [link("New training", "#/new", true), link("Models", "#/models")],
      ];
    }
    const head = `The training of ${run.prefix} on ${run.world} ${WORDS[run.state] ?? run.state}.`;
    const open = link("Open the model", modelLink(run.prefix));
    if (run.state === "starting")
      return [
        `${head} The workers load and check everything; the first pictures come in some seconds.`,
        busy ? "It is being stopped." : "",
        [stop, open],
      ];
    if (run.state === "running")
      return [
        `${head} ${progress()}`,
        busy ? "It is being stopped: it saves the checkpoint of this moment first." : ends(),
        [stop, open],
      ];
    const own = about && about.run_id === runId;
    const hint = [
      run.message,
      run.remedy,
      own || !about
        ? ""
        : `Resume it with \`DR_RUN_ID=${runId} dr-start-training --resume\`: in the settings, DR_RUN_ID is ${about.run_id}.`,
    ]
      .filter(Boolean)
      .join(" ");
    return [
      `${head} ${rows.length ? (rows.length === 1 ? "1 iteration is done." : `${number(rows.length)} iterations are done.`) : ""}`,
      busy ? "It is being started." : hint,
      [own ? resume : null, open, link("New training", "#/new")].filter(Boolean),
    ];
  }

  function progress() {
    const last = rows.at(-1);
    if (run.phase) return run.phase.text.replace(/^./, (letter) => letter.toUpperCase()) + ".";
    if (!last) return "The first iteration is being driven.";
    const laps = last.full_laps
      ? `${number(last.full_laps)} of ${number(last.episodes)} episodes completed a clean lap`
      : `the cars got ${number(last.mean_progress, 0, "%")} of the lap on average`;
    return `In iteration ${number(last.iteration)}, ${laps}.`;
  }

  function ends() {
    const left = [];
    if (run.iterations_left !== null) left.push(`${number(run.iterations_left)} iterations`);
    if (run.time_left_s !== null) left.push(duration(run.time_left_s));
    if (run.money_left !== null) left.push(number(run.money_left, 2, "USD"));
    return left.length
      ? `It stops by itself after ${left.join(", or ")} more, or earlier.`
      : "It has no limit: it runs until you stop it.";
  }

  function drawFigures() {
    const last = rows.at(-1),
      evaluated = rows.findLast((row) => row.evaluation_progress?.length);
    const most =
      run.iterations_left !== null ? ` of ${number(run.iterations + run.iterations_left)}` : "";
    const { spending, requests } = run;
    setFigures([
      rows.length ? `${number(last.iteration)}${most}` : "–",
      number(last?.total_steps),
      last ? `${number(last.steps_per_s)} (${number(last.real_time_factor, 0)}× real time)` : "–",
      rows.length ? duration(run.elapsed_s || last.elapsed_s) : "–",
      spending
        ? `${spending.usd !== null ? number(spending.usd, 2, "USD") : "no price set"}, ${number(spending.hours, 2, "h")}`
        : "–",
      requests && requests.hours >= 0.1
        ? `${number((requests.puts + requests.gets) / requests.hours)} an hour`
        : "–",
      run.best && run.best.metric !== null
        ? [run.best.text, run.limit].filter(Boolean).join("; ")
        : "–",
      evaluated && run.newest_laps
        ? `${run.newest_laps.checkpoint}: ${run.newest_laps.text}, progress ${number(mean(evaluated.evaluation_progress), 0, "%")}`
        : "–",
    ]);
  }

  function drawSaid() {
    const errors = run.reward_errors;
    const list = [
      ...(run.dead ?? []).map((name) => [
        "bad",
        `${name} does not run; its supervisor starts it again.`,
        "",
      ]),
      ...(run.watches ?? []).map((text) => ["bad", text, ""]),
      ...(run.damaged ?? []).map((text) => ["bad", text, ""]),
      ...(run.warning
        ? [["warn", `Learning curve: ${run.warning}.`, (run.advice ?? []).join(" ")]]
        : []),
      ...(errors?.failed
        ? [
            [
              "bad",
              `The reward function failed in ${number(errors.failed)} of ${number(errors.calls)} calls: ${errors.errors.at(-1)?.message ?? "see the log"}`,
              "Read the prints of the reward function in the log below, and correct it.",
            ],
          ]
        : []),
      ...(errors?.discarded
        ? [["warn", `The reward function discarded ${number(errors.discarded)} episodes.`, ""]]
        : []),
      ...(run.budget?.damaged
        ? [["warn", "Some files of the daily budget cannot be read, so hours may be missing.", ""]]
        : []),
      ...(run.convergence?.reached
        ? [
            [
              "good",
              `Training (${number(run.convergence.training)} %) and evaluations (${number(run.convergence.evaluation)} %) have converged: there is little left to learn here.`,
              "Stop, or go on with a harder track or reward.",
            ],
          ]
        : []),
      ...(run.milestones ?? []).map((each) => [
        "good",
        `Milestone ${each.word}: ${each.checkpoint.replace(".ckpt", "")}, ${number(each.laps)} of ${number(each.episodes)} evaluation laps clean, best ${number(each.best_lap_s, 2, "s")}.`,
        "",
      ]),
    ];
    const key = JSON.stringify(list);
    if (key === told) return;
    told = key;
    fill(
      said,
      list.length
        ? h(
            "ul",
            {},
            list.map(([kind, text, remedy]) =>
              h(
                "li",
                {},
                h("span", { class: `dot ${kind}` }),
                prose(text),
                remedy ? h("span", { class: "remedy" }, " ", prose(remedy)) : null,
              ),
            ),
          )
        : null,
    );
  }

  return {
    element,
    setRun(value) {
      if (value.error) {
        shown = told = "";
        run = null;
        broken = true;
        fill(
          sentence,
          h("span", { class: "dot bad" }),
          "The state of the run cannot be read. The page goes on by itself when it can.",
        );
        next.textContent = " ";
        fillButtons(actions);
        fill(said, failure(value.error));
        return;
      }
      run = value;
      if (broken) {
        broken = false;
        readFolder();
      }
      draw();
    },
    setRows(value) {
      rows = value;
      draw();
    },
    setElsewhere(value) {
      elsewhere = value;
      draw();
    },
  };
}

export function mean(values) {
  return values?.length ? values.reduce((sum, value) => sum + value, 0) / values.length : null;
}
