// Chooses a stored episode: model, training or evaluation, iteration, worker, episode; all with numbers.

import {
  andResets,
  duration,
  empty,
  failure,
  fill,
  h,
  lapTime,
  moment,
  number,
  stampText,
} from "/dom.js";
import { openTrace, storedModels, storedTraces } from "/episode_data.js";

export const STATUS = {
  lap_complete: "Lap complete",
  off_track: "Off track",
  crashed: "Crashed",
  immobilized: "Did not move",
  reversed: "Drove backwards",
  in_progress: "In progress",
  pause: "Waits",
  prepare: "Starts",
  park: "Parked",
  time_up: "Time is up",
  discarded: "Discarded",
};

const KINDS = { training: "Training", evaluation: "Evaluations", opponent: "Race as the opponent" };

/** What a trace is called on the page. */
export function traceTitle({ kind, iteration, worker, stamp }, workers = 1) {
  if (kind === "training")
    return `Iteration ${iteration}${workers > 1 || worker ? `, worker ${worker}` : ""}`;
  return kind === "evaluation" ? `Evaluation of ${stampText(stamp)}` : "Last race as the opponent";
}

/**
 * The chooser as an element.
 * @param {{chosen: {model?: string, trace?: string, episode?: string}, link: function(Object): string, action: string}} spec
 *   link gives the address of a chosen episode, action is what its link is called.
 */
export function episodeChooser({ chosen, link, action }, signal) {
  const state = {
    models: [],
    model: chosen.model ?? "",
    traces: [],
    kind: "",
    worker: 0,
    trace: chosen.trace ?? "",
  };
  const selects = h("div", { class: "chooser-selects" }),
    list = h("div", { class: "chooser-episodes", "aria-live": "polite" });
  const element = h("div", { class: "chooser" }, selects, list);
  let turn = 0;

  const select = (label, options, value, change) =>
    h(
      "label",
      { class: "pick" },
      h("span", {}, label),
      h(
        "select",
        { value, change: (event) => change(event.currentTarget.value) },
        options.map(([each, text]) => h("option", { value: each, selected: each === value }, text)),
      ),
    );

  function show() {
    const { traces, kind } = state,
      kinds = [...new Set(traces.map((each) => each.kind))];
    const ofKind = traces.filter((each) => each.kind === kind);
    const workers = [...new Set(ofKind.map((each) => each.worker))].sort((a, b) => a - b);
    const shown =
      kind === "training"
        ? ofKind.filter((each) => each.worker === state.worker)
        : [...ofKind].reverse();
    fill(
      selects,
      select(
        "Model",
        state.models.map((each) => [each, each]),
        state.model,
        (value) => {
          state.model = value;
          state.trace = "";
          readTraces();
        },
      ),
      kinds.length > 1
        ? select(
            "Driven in",
            kinds.map((each) => [each, KINDS[each]]),
            kind,
            (value) => {
              pick(traces.filter((each) => each.kind === value).at(-1));
            },
          )
        : null,
      workers.length > 1
        ? select(
            "Worker",
            workers.map((each) => [String(each), `Worker ${each}`]),
            String(state.worker),
            (value) => {
              const before = traces.find((each) => each.name === state.trace),
                own = ofKind.filter((each) => each.worker === Number(value));
              pick(own.find((each) => each.iteration === before?.iteration) ?? own.at(-1));
            },
          )
        : null,
      shown.length
        ? select(
            kind === "training" ? "Iteration" : "Drive",
            shown.map((each) => [each.name, optionText(each, kind)]),
            state.trace,
            (value) => pick(traces.find((each) => each.name === value)),
          )
        : null,
    );
  }

  function pick(trace) {
    if (!trace) return;
    Object.assign(state, { kind: trace.kind, worker: trace.worker, trace: trace.name });
    const focused = selects.contains(document.activeElement)
      ? [...selects.querySelectorAll("select")].indexOf(document.activeElement)
      : -1;
    show();
    if (focused >= 0) selects.querySelectorAll("select")[focused]?.focus();
    readEpisodes();
  }

  async function guarded(read) {
    const mine = ++turn;
    try {
      const value = await read();
      return mine === turn && !signal.aborted ? value : null;
    } catch (error) {
      if (mine === turn && !signal.aborted && error.name !== "AbortError") {
        fill(
          list,
          failure(error),
          h(
            "p",
            {},
            h(
              "button",
              {
                type: "button",
                click: () =>
                  state.models.length
                    ? state.traces.length
                      ? readEpisodes()
                      : readTraces()
                    : start(),
              },
              "Try again",
            ),
          ),
        );
      }
      return null;
    }
  }

  async function start() {
    fill(list, h("p", { class: "quiet" }, "The models in the bucket are listed …"));
    const found = await guarded(() => storedModels(signal));
    if (!found) return;
    state.models = found.models;
    if (!found.models.length) {
      fill(
        list,
        empty(
          "There is no model in the bucket yet. Train one, and every episode that it drives can be played here.",
          h("a", { class: "button", href: "#/" }, "Open the live page"),
        ),
      );
      return;
    }
    if (!state.models.includes(state.model))
      state.model = chosen.model
        ? state.models[0]
        : state.models.includes(found.own)
          ? found.own
          : state.models[0];
    if (chosen.model && state.model !== chosen.model) state.trace = "";
    readTraces();
  }

  async function readTraces() {
    state.traces = [];
    show();
    fill(list, h("p", { class: "quiet" }, `The stored episodes of ${state.model} are listed …`));
    const found = await guarded(() => storedTraces(state.model, signal));
    if (!found) return;
    state.traces = found.traces;
    if (!found.traces.length) {
      fill(
        list,
        empty(
          `${state.model} has no stored episodes: it was neither trained nor evaluated here, or its traces were deleted (DR_TRAIN_TRACES_MAX_MB).`,
          h(
            "a",
            { class: "button", href: `#/model?${new URLSearchParams({ prefix: state.model })}` },
            "Open the model",
          ),
          "to evaluate it, or run ",
          h("code", {}, "dr-evaluate"),
        ),
      );
      return;
    }
    const training = found.traces.filter((each) => each.kind === "training");
    const newest = training.at(-1);
    pick(
      found.traces.find((each) => each.name === state.trace) ??
        found.traces.filter((each) => each.kind === "evaluation").at(-1) ??
        training.find((each) => each.iteration === newest?.iteration) ??
        found.traces.at(-1),
    );
  }

  async function readEpisodes() {
    fill(
      list,
      h("p", { class: "quiet" }, "The episodes are read; the first time this takes some seconds …"),
    );
    const facts = await guarded(() => openTrace(state.model, state.trace, signal));
    if (!facts) return;
    fill(
      list,
      facts.notes.map((note) => h("p", { class: "problem" }, note)),
      episodeTable(
        facts,
        (index) => link({ model: state.model, trace: state.trace, episode: index }),
        action,
        chosen.trace === state.trace ? Number(chosen.episode) : -1,
      ),
    );
  }

  start();
  return element;
}

function optionText(trace, kind) {
  const numbers = [
    trace.mean_progress !== null ? `progress ${number(trace.mean_progress, 0)} %` : null,
    trace.mean_reward !== null ? `reward ${number(trace.mean_reward, 1)}` : null,
    trace.clean_laps == null ? null : `${trace.clean_laps} clean laps${andResets(trace.resets)}`,
    trace.clean_laps == null && trace.full_laps ? `${trace.full_laps} clean laps` : null,
    trace.best_lap_s != null ? `best ${number(trace.best_lap_s, 2)} s` : null,
  ]
    .filter(Boolean)
    .join(", ");
  const name =
    kind === "training"
      ? `Iteration ${trace.iteration}`
      : kind === "evaluation"
        ? `${stampText(trace.stamp)}${trace.iteration ? ` (${trace.iteration})` : ""}`
        : moment(trace.modified);
  return numbers ? `${name}: ${numbers}` : name;
}

function episodeTable(facts, link, action, current) {
  const heads = ["", "Episode", "Reward", "Progress", "Time", "Ended", "Resets", "Start", "Steps"];
  const marks = {
    best: h("strong", { class: "mark good-mark" }, "best"),
    worst: h("strong", { class: "mark bad-mark" }, "worst"),
  };
  const rows = facts.episodes.map((each) =>
    h(
      "tr",
      { class: each.index === current ? "current" : null },
      h(
        "td",
        {},
        each.index === current
          ? "shown"
          : h(
              "a",
              {
                class: "button short",
                href: link(each.index),
                "aria-label": `${action} episode ${each.number}`,
              },
              action,
            ),
      ),
      h("th", { scope: "row" }, `${each.number} `, marks[each.mark] ?? null),
      h("td", { class: "number" }, number(each.reward, 1)),
      h("td", { class: "number" }, number(each.progress, 1, "%")),
      h("td", { class: "number" }, each.completed ? lapTime(each.seconds) : duration(each.seconds)),
      h("td", {}, each.text),
      h("td", { class: "number" }, each.resets),
      h(
        "td",
        { class: "number" },
        each.start_percent === null
          ? "–"
          : `${number(Math.round(each.start_percent) % 100, 0)} % of the lap`,
      ),
      h("td", { class: "number" }, each.steps),
    ),
  );
  return h(
    "div",
    { class: "scroll", tabindex: "0", role: "region", "aria-label": "Episodes" },
    h(
      "table",
      {},
      h("caption", {}, `${traceTitle(facts)}${facts.world ? ` on ${facts.world}` : ""}`),
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          heads.map((head) =>
            h("th", { scope: "col" }, head || h("span", { class: "unseen" }, "Action")),
          ),
        ),
      ),
      h("tbody", {}, rows),
    ),
  );
}
