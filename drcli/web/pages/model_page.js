// One model: numbers, reward graph, checkpoints, evaluations, files, notes, and what can be done with it.

import { get } from "/api.js";
import {
  bytes,
  duration,
  empty,
  failure,
  fill,
  fillButtons,
  h,
  lapTime,
  moment,
  number,
  tiles,
} from "/dom.js";
import { tabs } from "/form_dialog.js";
import { modelActions } from "/model_actions.js";
import { drawCheckpoints } from "/model_checkpoints.js";
import { evaluationPart } from "/model_evaluations.js";
import { filesPart } from "/model_files.js";
import { analysis, rewardGraph } from "/model_overview.js";
import { drawNotes } from "/model_notes.js";
import { act } from "/model_tasks.js";
import { badges, checkpointText, modelLink } from "/models_page.js";
import { follow } from "/socket.js";

export const title = "Model";

const STATES = {
  running: "is being trained",
  finished: "has finished its training",
  stopped: "was stopped",
  interrupted: "was interrupted",
  failed: "failed",
  lost: "ended without saying why",
  unknown: "",
};

export async function show(main, params, { signal, query }) {
  const prefix = query.get("prefix") ?? "";
  const path = (name = "") =>
    `/api/model${name ? `/${name}` : ""}?prefix=${encodeURIComponent(prefix)}`;
  const page = { about: null, checkpoints: null, changes: null, models: { models: [] } };
  document.title = `${prefix} – DeepRacer console`;

  const heading = h("p", { class: "state", role: "status" }, "Reading the model …");
  const marks = h("span");
  const [figures, setFigures] = tiles([
    "Best clean lap",
    "Best checkpoint",
    "Last checkpoint",
    "Iterations",
    "Training time",
    "Size",
  ]);
  const buttons = h("div", {
    class: "actions",
    role: "group",
    "aria-label": "What to do with this model",
  });
  const graph = rewardGraph(signal);
  const checkpoints = h("div"),
    notes = h("div");
  const actions = modelActions({ prefix, page, path, showTab: (tab) => parts.show(tab), signal });
  const evaluations = evaluationPart(prefix, { signal, evaluate: actions.evaluate });
  const files = filesPart(prefix, {
    signal,
    names: () => page.models.models.map((each) => each.model.prefix),
  });
  const overview = h("div", {}, graph.element, analysis(prefix, signal));
  const parts = tabs(
    `Parts of ${prefix}`,
    [
      ["overview", "Overview", overview],
      ["checkpoints", "Checkpoints", checkpoints],
      ["evaluations", "Evaluations", evaluations.element],
      ["files", "Settings and files", files.element],
      ["notes", "Notes", notes],
    ],
    query.get("tab") ?? "overview",
    (tab) => {
      history.replaceState(null, "", modelLink(prefix, tab === "overview" ? "" : tab));
      if (tab === "overview" && page.curve) graph.update(page.curve);
    },
  );

  const read = {
    async about() {
      page.about = await get(path(), signal);
      drawHead();
    },
    async checkpoints() {
      page.checkpoints = await get(path("checkpoints"), signal);
      drawCheckpoints(checkpoints, page.checkpoints);
    },
    async curve() {
      page.curve = await get(path("curve"), signal);
      if (graph.element.isConnected) graph.update(page.curve);
    },
    async evaluations() {
      evaluations.update(await get(path("evaluations"), signal));
    },
    files: () => files.update(),
    async notes() {
      drawNotes(notes, await get(path("notes"), signal), path("notes"), signal);
    },
  };
  const places = { checkpoints, notes, evaluations: evaluations.element };
  async function reread(name) {
    try {
      await read[name]();
    } catch (error) {
      if (error.name === "AbortError") return;
      const problem =
        error.code === 3 && name === "checkpoints"
          ? empty(error.message, error.remedy)
          : failure(error);
      if (places[name]) fill(places[name], problem);
      else if (name === "about") fill(heading, problem);
    }
  }

  fill(
    main,
    h("h1", {}, prefix || "No model"),
    h("p", { role: "status" }, "Reading the model ..."),
  );
  try {
    page.about = await get(path(), signal);
  } catch (error) {
    if (error.name === "AbortError") return;
    fill(
      main,
      h("h1", {}, prefix || "No model"),
      failure(error),
      h("p", {}, h("a", { class: "button", href: "#/models" }, "All models")),
    );
    return;
  }
  fill(
    main,
    h("p", { class: "fine" }, h("a", { href: "#/models" }, "All models")),
    h("h1", {}, prefix, " ", marks),
    heading,
    figures,
    buttons,
    parts.element,
  );
  drawHead();
  parts.start();
  for (const name of ["checkpoints", "curve", "evaluations", "files", "notes"]) reread(name);

  follow(
    "models",
    (value) => {
      if (value.error) return;
      const first = !page.models.bucket;
      page.models = value;
      const own = value.models.find((each) => each.model.prefix === prefix);
      if (own && page.about)
        Object.assign(page.about, {
          model: own.model,
          training: own.training ?? page.about.training,
        });
      if (page.about) drawHead();
      if (first) files.update();
    },
    signal,
  );
  follow(
    `model:${prefix}`,
    (value) => {
      if (value.error) {
        delete heading.dataset.state;
        fill(heading, failure(value.error));
        return;
      }
      const before = page.changes;
      page.changes = value;
      if (!value.exists) {
        delete heading.dataset.state;
        delete buttons.dataset.state;
        fill(
          heading,
          h(
            "div",
            { class: "problem" },
            h("p", {}, "This model was deleted."),
            h("p", {}, h("a", { href: "#/models" }, "All models")),
          ),
        );
        fillButtons(buttons);
        return;
      }
      evaluations.running(value.evaluations, (button) =>
        act("stop-evaluation", { prefix }, { button, signal }),
      );
      drawHead();
      const changed = (name) =>
        before && JSON.stringify(before.parts[name]) !== JSON.stringify(value.parts[name]);
      if (before)
        for (const name of ["checkpoints", "curve", "evaluations", "files", "notes"])
          if (changed(name)) reread(name);
      if (
        before &&
        (["checkpoints", "curve", "evaluations", "notes"].some(changed) ||
          before.training !== value.training ||
          before.current !== value.current)
      )
        reread("about");
    },
    signal,
  );

  function drawHead() {
    const { model, training, bucket, current } = page.about,
      now = page.changes;
    fill(
      marks,
      badges(
        prefix,
        {
          trainings: now?.training_here ? [{ prefix }] : [],
          evaluations: (now?.evaluations ?? []).map(() => ({ prefix })),
          current: (now ? now.current : current) ? prefix : "",
        },
        now ? now.training : model?.training,
      ),
    );
    const parent = training?.parent,
      trains = now ? now.training : model?.training;
    const facts = training
      ? [
          training.world,
          training.race_type.toLowerCase().replaceAll("_", " "),
          training.algorithm,
          training.action_space?.replace(/^discrete, (\d+)$/, "discrete, $1 actions"),
        ]
          .filter(Boolean)
          .join(", ")
      : "";
    const line = [
      training
        ? [
            facts ? `${facts}. ` : "Track and algorithm of its training are not recorded. ",
            trains
              ? "It is being trained. "
              : [
                  STATES[training.state]
                    ? `It ${STATES[training.state]}${training.ended_at ? ` (${moment(Date.parse(training.ended_at) / 1000)})` : ""}. `
                    : "",
                  training.message ? `${training.message} ` : "",
                ],
          ]
        : "There is no record of its training. ",
      parent
        ? [
            "It began with the weights of ",
            page.models.models.some((each) => each.model.prefix === parent)
              ? h("a", { href: modelLink(parent) }, parent)
              : parent,
            `, checkpoint ${training.parent_checkpoint.split("_")[0]}. `,
          ]
        : null,
      model?.note ? h("q", {}, model.note) : null,
      model?.damaged?.length
        ? h("span", { class: "model-badge bad" }, model.damaged.join(" "))
        : null,
    ];
    const state = JSON.stringify([training, model, trains, page.models.models.length, bucket]);
    if (heading.dataset.state !== state) {
      heading.dataset.state = state;
      fill(heading, line);
    }
    setFigures([
      lapTime(training?.best_lap_s),
      checkpointText(model?.best),
      checkpointText(model?.last),
      number(training?.iterations),
      duration(training?.elapsed_s),
      bytes(model?.size_bytes),
    ]);
    const key = JSON.stringify([trains, now?.training_here, now?.evaluations.length > 0]);
    if (buttons.dataset.state === key) return;
    buttons.dataset.state = key;
    const button = (text, click, kind = null) =>
      h(
        "button",
        { type: "button", class: kind, click: (event) => click(event.currentTarget) },
        text,
      );
    fillButtons(
      buttons,
      trains
        ? button("Stop the training", actions.stop, "danger")
        : button("Resume the training", actions.resume),
      button("Evaluate", actions.evaluate, "main"),
      now?.evaluations.length
        ? button("Stop the evaluation", (it) =>
            act("stop-evaluation", { prefix }, { button: it, signal }),
          )
        : null,
      button("Clone", actions.clone),
      button("Download", actions.download),
      button("Upload", actions.upload),
      button("Delete", actions.removeModel),
    );
  }
}
