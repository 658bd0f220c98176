// What can be done with a model: train on, evaluate, clone, submit, download, upload, delete. Each asks first.

import { api, get, post } from "/api.js";
import { ask } from "/ask.js";
import { confirmed } from "/dialogs.js";
import { Diff } from "/model_files.js";
import { runTask, save } from "/model_tasks.js";
import { notify } from "/notices.js";
import { setQuery } from "/store.js";
import { bytes, number } from "/text.js";
import { html } from "/ui.js";

const spoken = (word) => word.toLowerCase().replaceAll("_", " ");
const OWN_FILES = {
  "reward_function.py": "its reward function",
  "hyperparameters.json": "its hyperparameters",
  "model_metadata.json": "its actions and sensors",
};

/** Checkpoints to choose from, with how each drove. */
export function checkpointOptions(checkpoints) {
  const all = [...checkpoints].reverse();
  const drove = ({ episodes, laps, best_lap_s: best }) =>
    episodes
      ? `${laps} of ${episodes} laps clean${best === null ? "" : `, best ${number(best, 2, "s")}`}`
      : "never evaluated";
  const chosen = (word) => {
    const found = all.find((each) => each.words.includes(word));
    return found ? `: ${found.number}, ${drove(found)}` : "";
  };
  const marks = ({ words }) => (words.length ? ` (${words.join(", ")})` : "");
  return [
    ["best", `the best${chosen("best")}`],
    ["last", `the newest${chosen("last")}`],
    ...all.map((each) => [String(each.number), `${each.number}${marks(each)}: ${drove(each)}`]),
  ];
}

/** What a clone can take from its model, with what would change in the folder. */
const Differences = ({ files }) =>
  files.map(
    ({
      name,
      diff,
    }) => html`<details><summary>${name} of the model differs from the folder's</summary>
    <${Diff} lines=${diff} /></details>`,
  );

/**
 * The actions of a model; each rejects with what went wrong, and does nothing where its question is left.
 * @param {{prefix: string, path: (name?: string) => string, about: Object, checkpoints: Object[], names: string[]}} model
 */
export function modelActions({ prefix, path, about, checkpoints, names }) {
  const act = (name, body = {}) => runTask(`/api/model/${name}`, { prefix, ...body });
  const checkpoint = (value, help = "") => ({
    ...{
      name: "checkpoint",
      label: "Checkpoint",
      value: String(value),
      help,
      options: checkpointOptions(checkpoints),
    },
  });

  async function resume() {
    const values = await ask({
      title: `Resume the training of ${prefix}`,
      action: "Start",
      intro: html`<p>It goes on with its newest checkpoint, the files of custom_files/ and the settings of run.env. Everything is checked first.</p>`,
      fields: [
        {
          name: "minutes",
          label: "Stop after (minutes)",
          value: "",
          more: { type: "number", min: "1", step: "any" },
          help: "Empty: it runs until it is stopped, or until a goal of run.env is reached.",
        },
      ],
    });
    if (!values) return;
    const started = await act("start", {
      max_minutes: values.minutes ? Number(values.minutes) : null,
    });
    for (const sentence of started.warnings) notify(sentence, "warn");
    notify(started.ends);
  }

  async function stop() {
    const detail = "What was learned so far is kept, and the training can be continued.";
    if (await confirmed(`Stop the training of ${prefix}?`, { action: "Stop the training", detail }))
      await act("stop");
  }

  async function evaluate(first = null) {
    const choices = await get(path("choices"));
    const named = (world) => (world === choices.trained_on ? `${world} (trained on)` : world);
    const values = await ask({
      title: `Evaluate ${prefix}`,
      action: "Evaluate",
      fields: [
        {
          name: "world",
          label: "Track",
          options: choices.worlds.map((each) => [each, named(each)]),
          value: choices.worlds.includes(choices.trained_on) ? choices.trained_on : choices.world,
        },
        {
          name: "reverse",
          label: "Direction",
          options: [
            ["False", "as the track was built"],
            ["True", "in reverse"],
          ],
          value: choices.reverse ? "True" : "False",
        },
        {
          name: "race_type",
          label: "Race type",
          options: choices.race_types.map((each) => [each, spoken(each)]),
          value: choices.race_type,
        },
        {
          name: "opponent",
          label: "Opponent",
          options: names,
          value: choices.opponent,
          hidden: ({ race_type: kind }) => kind !== "HEAD_TO_MODEL",
        },
        {
          name: "laps",
          label: "Laps",
          value: String(choices.laps),
          more: { type: "number", min: "1", max: "1000", required: true },
        },
        checkpoint(first ?? choices.checkpoint),
        {
          name: "video",
          label: "Make videos of it, which takes some minutes more",
          value: Boolean(choices.video),
          help: "All other rules are those of the DR_EVAL_ settings. The model may be training at the same time.",
        },
      ],
    });
    if (!values) return;
    setQuery({ tab: "evaluations" }, true);
    const { opponent, ...others } = values;
    const rival = values.race_type === "HEAD_TO_MODEL" ? { opponent } : {};
    await act("evaluate", { ...others, ...rival, video: values.video ? "True" : "False" });
  }

  async function clone(first = "best") {
    const plan = await get(path("clone-plan"));
    const files = plan.files.filter((each) => each.diff.length);
    const world = plan.world && plan.world !== plan.folder_world && plan.world;
    const values = await ask({
      title: `Clone ${prefix}`,
      action: "Clone",
      intro: html`<p>The next training starts a new model with these weights. run.env is changed, and a copy is kept as run.env.bak.</p><${Differences} files=${files} />`,
      fields: [
        {
          name: "to",
          label: "Name of the new model",
          value: about.next_name,
          more: { required: true },
        },
        checkpoint(first),
        ...files.map(({ name }) => ({
          name,
          label: `Take ${OWN_FILES[name]}; the folder's file is kept as .bak`,
          value: true,
        })),
        world && {
          name: "world",
          label: `Take its track, ${world}, instead of ${plan.folder_world}`,
          value: true,
        },
        {
          name: "description",
          label: "What is it for?",
          value: "",
          more: { maxlength: "250" },
          help: "A note that stays with the new model.",
        },
      ],
    });
    if (!values) return;
    const take = files.map(({ name }) => name).filter((name) => values[name]);
    const { to, checkpoint: chosen, description } = values;
    const step = await post("/api/model/clone", {
      prefix,
      to,
      checkpoint: chosen,
      description,
      take,
      world: values.world ? world : "",
    });
    notify(
      `Your next training is ${step.after}; it begins with the weights of ${prefix}. ${[step.file, ...take].join(", ")} was changed.`,
    );
    location.hash = "#/new";
  }

  async function submit(first = "best") {
    const { races } = await get("/api/races");
    const open = races.filter((each) => each.state === "open");
    if (!open.length) {
      notify(
        "There is no race that takes models now.",
        "warn",
        "Create one, or wait until it opens.",
        { text: "Races", href: "#/races" },
      );
      return;
    }
    const values = await ask({
      title: `Submit ${prefix} to a race`,
      action: "Submit",
      fields: [
        {
          name: "race",
          label: "Race",
          options: open.map((each) => [each.race, each.name]),
          value: open[0].race,
        },
        { name: "racer", label: "Name of the racer", value: "", more: { required: true } },
        checkpoint(first),
      ],
    });
    if (!values) return;
    const { race, ...body } = values;
    await post(api("race", race, "submit"), { prefix, ...body });
    location.hash = `#/race/${encodeURIComponent(race)}`;
  }

  async function download(first = "best") {
    const values = await ask({
      title: `Download ${prefix}`,
      action: "Download",
      fields: [
        {
          name: "kind",
          label: "What",
          value: "car",
          options: [
            ["car", "Archive for the physical car (.tar.gz)"],
            ["onnx", "Policy as ONNX with its metadata (.zip)"],
            ["model", "Model: checkpoints, files and metrics (.tar.gz)"],
            ["everything", "Model with traces and videos (.tar.gz)"],
            ["logs", "Logs (.tar.gz)"],
          ],
        },
        checkpoint(
          first,
          "For the car and for ONNX; the file is checked against the weights first.",
        ),
      ],
    });
    if (!values) return;
    const made = await act("download", values);
    for (const problem of made.report?.problems ?? [])
      notify(problem.message ?? String(problem), "warn");
    save(made);
  }

  async function upload() {
    const { upload_bucket: target, upload_to: to, next_name: next } = about;
    const values = await ask({
      title: `Upload ${prefix}`,
      action: "Upload",
      intro: html`<p>${
        target
          ? `A checkpoint and all files that belong to it are copied to s3://${target}.`
          : "No upload bucket is set (DR_UPLOAD_S3_BUCKET). You can still make a copy in the local bucket."
      }</p>`,
      fields: [
        checkpoint("best"),
        {
          name: "to",
          label: "Name at the target",
          value: target ? to : next,
          more: { required: true },
        },
        { name: "local", label: "Copy to the local bucket instead", value: !target },
      ],
    });
    if (!values) return;
    const report = await act("upload", values);
    notify(`${report.checkpoint} is at ${report.target}.`);
  }

  async function remove() {
    const planned = await get(path("removal"));
    const [one] = planned.models;
    const values = await ask({
      title: `Delete ${prefix}?`,
      action: "Delete",
      danger: true,
      ready: ({ confirm }) => confirm === prefix,
      intro: html`<p>${number(one.objects)} objects (${bytes(one.size_bytes)}) with ${number(one.checkpoints)} checkpoints, and ${number(one.files.length)} files on this machine. It cannot be undone.
        ${one.warning && html`<strong> Note: ${one.warning}.</strong>`}</p>`,
      fields: [
        { name: "confirm", label: `Type ${prefix} to confirm`, value: "" },
        planned.records && {
          name: "forget",
          label: "Delete the records of its trainings, too",
          value: false,
        },
      ],
    });
    if (!values) return;
    await act("delete", values);
    location.hash = "#/models";
  }

  return {
    resume,
    stop,
    evaluate,
    stopEvaluation: () => act("stop-evaluation"),
    clone,
    submit,
    download,
    upload,
    remove,
  };
}
