// One model: numbers, reward graph, checkpoints, evaluations, files, notes, and what can be done with it.

import { get, post, put, remove } from "/api.js";
import {
  bytes,
  confirmed,
  duration,
  empty,
  failure,
  fill,
  fillButtons,
  h,
  lapTime,
  moment,
  notify,
  number,
  table,
  tiles,
} from "/dom.js";
import { ask, check, field, select, tabs } from "/form_dialog.js";
import { evaluationPart } from "/model_evaluations.js";
import { filesPart } from "/model_files.js";
import { analysis, rewardGraph } from "/model_overview.js";
import { act, save } from "/model_tasks.js";
import { badges, modelLink } from "/models_page.js";
import { follow } from "/socket.js";

export const title = "Model";

const WORDS = {
  last: "the newest",
  best: "the best",
  "first-lap": "of the first lap",
  "three-laps": "of three laps in a row",
  "best-lap": "of the best lap",
};
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
    "Best lap",
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
  const evaluations = evaluationPart(prefix, { signal, evaluate });
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
      drawCheckpoints();
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
      drawNotes(await get(path("notes"), signal));
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
    const score = (entry) =>
      entry
        ? `${entry.name.split("_")[0]}${entry.metric == null ? "" : ` (${number(entry.metric, 1)})`}`
        : "–";
    setFigures([
      lapTime(training?.best_lap_s),
      score(model?.best),
      score(model?.last),
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
        ? button("Stop the training", stop, "danger")
        : button("Continue the training", resume),
      button("Evaluate", evaluate, "main"),
      now?.evaluations.length
        ? button("Stop the evaluation", (it) =>
            act("stop-evaluation", { prefix }, { button: it, signal }),
          )
        : null,
      button("Clone", clone),
      button("Download", download),
      button("Upload", upload),
      button("Delete", removeModel),
    );
  }

  const checkpointChoices = () => [
    ["last", "the newest"],
    ["best", "the best"],
    ...(page.checkpoints?.checkpoints ?? [])
      .slice()
      .reverse()
      .map((each) => [
        String(each.number),
        `${each.number}${each.words.length ? ` (${each.words.join(", ")})` : ""}`,
      ]),
  ];

  async function resume(button) {
    const values = await ask({
      title: `Continue the training of ${prefix}`,
      action: "Start",
      intro: h(
        "p",
        {},
        "It goes on with its newest checkpoint, the files of custom_files/ and the settings of run.env, as ",
        h("code", {}, "dr-start-training --resume"),
        " does. Everything is checked first.",
      ),
      fields: [
        field(
          "Stop after (minutes)",
          h("input", {
            name: "minutes",
            type: "number",
            min: "1",
            step: "any",
            inputmode: "decimal",
          }),
          "Empty: it runs until it is stopped, or until a goal of run.env is reached.",
        ),
      ],
    });
    if (!values) return;
    const started = await act(
      "start",
      { prefix, max_minutes: values.minutes ? Number(values.minutes) : null },
      { button, signal },
    );
    for (const sentence of started?.warnings ?? []) notify(sentence, "bad");
    if (started) notify(started.ends);
  }

  async function stop(button) {
    if (
      await confirmed(`Stop the training of ${prefix}?`, {
        action: "Stop the training",
        detail: "What was learned so far is kept, and the training can be continued.",
      })
    )
      await act("stop", { prefix }, { button, signal });
  }

  async function evaluate(button) {
    let choices;
    try {
      choices = await get(path("choices"), signal);
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
      return;
    }
    const world = choices.worlds.includes(choices.trained_on) ? choices.trained_on : choices.world;
    const opponent = field(
      "Opponent",
      select(
        "opponent",
        page.models.models.map((each) => each.model.prefix),
        choices.opponent,
      ),
    );
    const race = select(
      "race_type",
      choices.race_types.map((each) => [each, each.toLowerCase().replaceAll("_", " ")]),
      choices.race_type,
    );
    const toggle = () => {
      opponent.hidden = race.value !== "HEAD_TO_MODEL";
    };
    race.addEventListener("change", toggle);
    toggle();
    const values = await ask({
      title: `Evaluate ${prefix}`,
      action: "Evaluate",
      fields: [
        field(
          "Track",
          select(
            "world",
            choices.worlds.map((each) => [
              each,
              each === choices.trained_on ? `${each} (trained on)` : each,
            ]),
            world,
          ),
        ),
        field(
          "Direction",
          select(
            "reverse",
            [
              ["False", "as the track was built"],
              ["True", "in reverse"],
            ],
            choices.reverse ? "True" : "False",
          ),
        ),
        field("Race type", race),
        opponent,
        field(
          "Laps",
          h("input", {
            name: "laps",
            type: "number",
            min: "1",
            max: "1000",
            required: true,
            value: choices.laps,
          }),
        ),
        field("Checkpoint", select("checkpoint", checkpointChoices(), choices.checkpoint)),
        h(
          "p",
          {},
          check("Make videos of it, which takes some minutes more", "video", choices.video),
        ),
        h(
          "p",
          { class: "quiet fine" },
          "All other rules are those of the DR_EVAL_ settings. The model may be training at the same time.",
        ),
      ],
    });
    if (!values) return;
    parts.show("evaluations");
    const body = { prefix, ...values, video: values.video ? "True" : "False" };
    if (values.race_type !== "HEAD_TO_MODEL") delete body.opponent;
    await act("evaluate", body, { button: button instanceof HTMLElement ? button : null, signal });
  }

  async function clone() {
    const values = await ask({
      title: `Clone ${prefix}`,
      action: "Clone",
      intro: h(
        "p",
        {},
        "The next training starts a new model with these weights: run.env is changed as by ",
        h("code", {}, "dr-increment-training"),
        ", and a copy is kept as run.env.bak.",
      ),
      fields: [
        field(
          "Name of the new model",
          h("input", {
            name: "to",
            required: true,
            autocomplete: "off",
            value: page.about.next_name,
          }),
        ),
        field("Start with checkpoint", select("checkpoint", checkpointChoices(), "last")),
        field(
          "What is it for?",
          h("input", { name: "description", autocomplete: "off", maxlength: "250" }),
          "A note that stays with the new model.",
        ),
      ],
    });
    if (!values) return;
    try {
      const step = await post(path("clone").split("?")[0], { prefix, ...values }, signal);
      notify(
        `Your next training is ${step.after}; it begins with the weights of ${prefix}. ${step.file} was changed.`,
      );
      location.hash = "#/new";
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
    }
  }

  async function download(button) {
    const values = await ask({
      title: `Download ${prefix}`,
      action: "Download",
      fields: [
        field(
          "What",
          select(
            "kind",
            [
              ["car", "Archive for the physical car (.tar.gz)"],
              ["onnx", "Policy as ONNX with its metadata (.zip)"],
              ["model", "Model: checkpoints, files and metrics (.tar.gz)"],
              ["everything", "Model with traces and videos (.tar.gz)"],
              ["logs", "Logs (.tar.gz)"],
            ],
            "car",
          ),
        ),
        field(
          "Checkpoint",
          select("checkpoint", checkpointChoices(), "best"),
          "For the car and for ONNX; the file is checked against the weights first.",
        ),
      ],
    });
    if (!values) return;
    const made = await act("download", { prefix, ...values }, { button, signal });
    if (!made) return;
    for (const problem of made.report?.problems ?? [])
      notify(problem.message ?? String(problem), "bad");
    save(made);
  }

  async function upload(button) {
    const { upload_bucket: target, upload_to: to } = page.about;
    const values = await ask({
      title: `Upload ${prefix}`,
      action: "Upload",
      intro: h(
        "p",
        {},
        target
          ? `A checkpoint and all files that belong to it are copied to s3://${target}, as by dr-upload-model.`
          : "No upload bucket is set (DR_UPLOAD_S3_BUCKET in system.env). You can still make a copy in the local bucket.",
      ),
      fields: [
        field("Checkpoint", select("checkpoint", checkpointChoices(), "last")),
        field(
          "Name at the target",
          h("input", {
            name: "to",
            required: true,
            autocomplete: "off",
            value: target ? to : page.about.next_name,
          }),
        ),
        h("p", {}, check("Copy to the local bucket instead", "local", !target)),
      ],
    });
    if (!values) return;
    const report = await act("upload", { prefix, ...values }, { button, signal });
    if (report) notify(`${report.checkpoint} is at ${report.target}.`);
  }

  async function removeModel(button) {
    let planned;
    try {
      planned = await get(path("removal"), signal);
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
      return;
    }
    const [one] = planned.models;
    const values = await ask({
      title: `Delete ${prefix}?`,
      action: "Delete",
      danger: true,
      ready: (form) => form.get("confirm") === prefix,
      intro: h(
        "p",
        {},
        `${number(one.objects)} objects (${bytes(one.size_bytes)}) with ${number(one.checkpoints)} checkpoints, and ${number(one.files.length)} files on this machine. It cannot be undone.`,
        one.warning ? h("strong", {}, ` Note: ${one.warning}.`) : null,
      ),
      fields: [
        field(
          `Type ${prefix} to confirm`,
          h("input", { name: "confirm", autocomplete: "off", spellcheck: "false" }),
        ),
        planned.records
          ? h("p", {}, check("Delete the records of its trainings, too", "forget"))
          : null,
      ],
    });
    if (!values) return;
    if (await act("delete", { prefix, ...values }, { button, signal })) location.hash = "#/models";
  }

  function drawCheckpoints() {
    const found = page.checkpoints;
    fill(
      checkpoints,
      found.damaged.map((each) => h("div", { class: "problem" }, h("p", {}, each))),
      table(
        "Checkpoints",
        [
          "Number",
          "Marks",
          "Evaluation laps",
          "Progress",
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
                h(
                  "span",
                  { class: "model-badge", title: `Checkpoint ${WORDS[word] ?? word}` },
                  word,
                ),
              ),
              each.every ? h("span", { class: "model-badge" }, "kept every n") : null,
            ]
              .flat()
              .reduce((cell, mark) => (mark && cell.append(mark, " "), cell), h("span")),
            each.episodes ? `${each.laps} of ${each.episodes}` : "–",
            each.progress == null ? "–" : number(each.progress, 1, "%"),
            lapTime(each.best_lap_s),
            bytes(each.size_bytes),
            ...(each.problem ? [each.problem] : []),
          ]),
      ),
      h(
        "p",
        { class: "quiet fine" },
        `Together ${bytes(found.size_bytes)}. A training keeps the newest four checkpoints, the best one and the milestones.`,
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

  function drawNotes(found) {
    const writing = document.activeElement?.name === "note" ? document.activeElement.value : "";
    const area = h("textarea", { name: "note", rows: "3", maxlength: "2000", value: writing });
    const send = async (action) => {
      try {
        drawNotes(await action());
      } catch (error) {
        if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
      }
    };
    const edit = async (note) => {
      const values = await ask({
        title: note.number === 0 ? "Describe the model" : `Edit note ${note.number}`,
        action: "Save",
        fields: [
          field(
            "Text",
            h("textarea", { name: "text", rows: "5", value: note.text, required: true }),
          ),
        ],
      });
      if (values)
        send(() => put(path("notes"), { number: note.number, text: values.text }, signal));
    };
    const drop = async (note) => {
      if (await confirmed("Remove this note?", { action: "Remove", detail: note.text }))
        send(() => remove(`${path("notes")}&number=${note.number}`, signal));
    };
    fill(
      notes,
      found.notes.length
        ? h(
            "ul",
            { class: "model-notes" },
            found.notes.map((note) =>
              h(
                "li",
                {},
                h("p", { class: "note-text" }, note.text),
                h(
                  "p",
                  { class: "actions fine quiet" },
                  note.number === 0
                    ? "Description"
                    : `Note ${note.number}, ${moment(note.at)}${note.checkpoint == null ? "" : `, at checkpoint ${note.checkpoint}`}${note.edited_at ? ", edited" : ""}`,
                  h(
                    "button",
                    {
                      type: "button",
                      class: "fine",
                      "aria-label": `Edit note ${note.number}`,
                      click: () => edit(note),
                    },
                    "Edit",
                  ),
                  h(
                    "button",
                    {
                      type: "button",
                      class: "fine",
                      "aria-label": `Remove note ${note.number}`,
                      click: () => drop(note),
                    },
                    "Remove",
                  ),
                ),
              ),
            ),
          )
        : empty("There is no note yet. Notes stay with the model, also in copies of it."),
      found.notes.some((note) => note.number === 0)
        ? null
        : h(
            "p",
            {},
            h(
              "button",
              { type: "button", click: () => edit({ number: 0, text: "" }) },
              "Describe the model",
            ),
          ),
      h(
        "form",
        {
          submit: (event) => {
            event.preventDefault();
            const text = area.value;
            area.value = "";
            send(() => post(path("notes"), { text }, signal));
          },
        },
        field("New note", area),
        h("p", { class: "actions" }, h("button", { class: "main" }, "Add the note")),
      ),
    );
    if (writing) notes.querySelector("[name=note]").focus();
  }
}
