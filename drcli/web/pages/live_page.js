// What runs now: state, pictures and maps of the workers, curves, machine, logs.

import { get } from "/api.js";
import { fill, h } from "/dom.js";
import { lossCurves } from "/live_curves.js";
import { logPanel } from "/live_log.js";
import { machinePanel } from "/live_machine.js";
import { runState } from "/live_state.js";
import { workerCards } from "/live_workers.js";
import { rewardGraph } from "/reward_graph.js";
import { follow, followRows } from "/socket.js";

export const title = "Live";

/** Where the run is: its topics are known before the list of runs is. */
async function chosenRun(query, signal) {
  const wanted = query.get("run");
  if (/^\d{1,2}$/.test(wanted ?? "")) return Number(wanted);
  try {
    return (await get("/api/folder", signal)).run_id;
  } catch (error) {
    if (error.name === "AbortError") throw error;
    return 0; // the topic of the run says what is wrong with the settings
  }
}

export async function show(main, params, { signal, query }) {
  const runId = await chosenRun(query, signal);
  const choose = h("select", {
    id: "live-run",
    change: () => {
      location.hash = `#/?run=${choose.value}`;
    },
  });
  const chooser = h(
    "p",
    { class: "live-chooser", hidden: true },
    h("label", { for: "live-run" }, "Run "),
    choose,
  );
  const state = runState(runId, signal);
  const cards = workerCards(runId, signal);
  const reward = rewardGraph(signal);
  const curves = lossCurves(signal);
  fill(
    main,
    h("div", { class: "live-head" }, h("h1", {}, "Live"), chooser),
    state.element,
    cards.element,
    h(
      "section",
      { "aria-labelledby": "live-learning" },
      h("h2", { id: "live-learning" }, "Learning"),
      reward.element,
      curves.element,
    ),
    machinePanel(signal),
    logPanel(runId, signal, cards),
  );

  follow(
    `run:${runId}`,
    (run) => {
      state.setRun(run);
      if (run.error) return;
      reward.setBest(run.best?.name ?? null);
      cards.setRun(run);
    },
    signal,
  );
  followRows(
    `iterations:${runId}`,
    (rows, error) => {
      if (error) return; // the state says it
      state.setRows(rows);
      reward.setIterations(rows);
      curves.update(rows);
    },
    signal,
  );
  followRows(`episodes:${runId}`, (rows, error) => reward.setEpisodes(rows, error), signal);
  follow(
    `elsewhere:${runId}`,
    (elsewhere) => {
      if (elsewhere.error) return;
      state.setElsewhere(elsewhere);
      cards.setElsewhere(elsewhere);
    },
    signal,
  );
  follow(
    "workers",
    (present) => {
      if (present.error) return;
      cards.setPresent(present);
      const runs = present.runs.length ? present.runs : [];
      const known = runs.some((run) => run.run_id === runId)
        ? runs
        : [...runs, { run_id: runId, prefix: "nothing yet", state: "none" }];
      chooser.hidden = known.length < 2;
      const texts = known
        .map((run) => `${run.run_id}: ${run.prefix}${run.alive ? ", runs" : ""}`)
        .join("|");
      if (choose.dataset.texts === texts) return;
      choose.dataset.texts = texts;
      fill(
        choose,
        known.map((run) =>
          h(
            "option",
            { value: String(run.run_id) },
            `${run.run_id}: ${run.prefix}${run.alive ? ", runs" : ""}`,
          ),
        ),
      );
      choose.value = String(runId);
    },
    signal,
  );
}
