// What can be done with a model: train on, evaluate, clone, download, upload, delete. Each asks first.

import { get, post } from "/api.js";
import { bytes, confirmed, h, notify, number } from "/dom.js";
import { ask, check, field, select } from "/form_dialog.js";
import { act, save } from "/model_tasks.js";

/**
 * The actions of a model, as functions of the button that was pressed.
 * @param {{prefix: string, page: Object, path: function(string): string, showTab: function(string), signal: AbortSignal}} model
 *   `page` is what is known of the model, and changes.
 */
export function modelActions({ prefix, page, path, showTab, signal }) {
  const checkpointChoices = () => {
    const all = (page.checkpoints?.checkpoints ?? []).slice().reverse();
    const drove = (each) =>
      each.episodes
        ? `${each.laps} of ${each.episodes} laps clean${each.best_lap_s === null ? "" : `, best ${number(each.best_lap_s, 2, "s")}`}`
        : "never evaluated";
    const chosen = (word) => {
      const each = all.find((one) => one.words.includes(word));
      return each ? `: ${each.number}, ${drove(each)}` : "";
    };
    return [
      ["best", `the best${chosen("best")}`],
      ["last", `the newest${chosen("last")}`],
      ...all.map((each) => [
        String(each.number),
        `${each.number}${each.words.length ? ` (${each.words.join(", ")})` : ""}: ${drove(each)}`,
      ]),
    ];
  };

  async function resume(button) {
    const values = await ask({
      title: `Resume the training of ${prefix}`,
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
    for (const sentence of started?.warnings ?? []) notify(sentence, "warn");
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
    showTab("evaluations");
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
        field("Start with checkpoint", select("checkpoint", checkpointChoices(), "best")),
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
      notify(problem.message ?? String(problem), "warn");
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

  return { resume, stop, evaluate, clone, download, upload, removeModel };
}
