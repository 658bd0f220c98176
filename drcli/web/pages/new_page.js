// New training: everything that a training needs, in order, each step saved by itself.

import { get, post } from "/api.js";
import { actionSteps } from "/action_space_form.js";
import { confirmed, failure, fill, h, notify, prose } from "/dom.js";
import { guardLeaving, settingsStep } from "/edit_step.js";
import { hyperparameterStep } from "/hyperparameter_form.js";
import { rewardStep } from "/reward_form.js";
import { KIND_NOTES, OBJECT_SETTINGS } from "/race_words.js";
import { problemList } from "/setting_fields.js";
import { startSteps } from "/start_form.js";
import { trackPicker } from "/track_picker.js";

export const title = "New training";

const RACE = [
  ["DR_TRAIN_WORLDS", "Further tracks that are trained"],
  ["DR_TRAIN_EVAL_WORLD", "Tracks for evaluation only"],
  ["DR_RACE_TYPE", "Race type"],
  ["DR_TRAIN_REVERSE_DIRECTION", "Against the direction of the track"],
  ["DR_TRAIN_ALTERNATE_DRIVING_DIRECTION", "Turn round after every episode"],
  ["DR_TRAIN_CHANGE_START_POSITION", "Start each episode further along the track"],
  ["DR_OA_NUMBER_OF_OBSTACLES", "Number of boxes"],
  ["DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES", "Least distance between boxes, m"],
  ["DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS", "Move the boxes in each episode"],
  ["DR_OA_IS_OBSTACLE_BOT_CAR", "Parked cars instead of boxes"],
  ["DR_OA_OBJECT_POSITIONS", "Fixed positions"],
  ["DR_H2B_NUMBER_OF_BOT_CARS", "Number of bots"],
  ["DR_H2B_BOT_CAR_SPEED", "Speed of the bots, m/s"],
  ["DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS", "Least distance between bots, m"],
  ["DR_H2B_RANDOMIZE_BOT_CAR_LOCATIONS", "Put bots elsewhere in each episode"],
  ["DR_H2B_IS_LANE_CHANGE", "Bots change lanes"],
  ["DR_H2B_LOWER_LANE_CHANGE_TIME", "Least time between lane changes, s"],
  ["DR_H2B_UPPER_LANE_CHANGE_TIME", "Greatest time between lane changes, s"],
];
const MODEL = [
  ["DR_LOCAL_S3_MODEL_PREFIX", "Name of the model"],
  ["DR_MODEL_DESCRIPTION", "Description"],
  ["DR_LOCAL_S3_PRETRAINED", "Begin with the weights of another model"],
  ["DR_LOCAL_S3_PRETRAINED_PREFIX", "That model"],
  ["DR_LOCAL_S3_PRETRAINED_CHECKPOINT", "Its checkpoint"],
];
const STOP = [
  ["DR_TRAIN_MAX_MINUTES", "Minutes"],
  ["DR_TRAIN_MAX_ITERATIONS", "Iterations"],
  ["DR_TRAIN_MAX_EPISODES", "Training episodes"],
  ["DR_TRAIN_MAX_STEPS", "Steps"],
  ["DR_TRAIN_STOP_PROGRESS", "Mean progress of evaluations, %"],
  ["DR_TRAIN_STOP_EVALUATIONS", "For so many evaluations in a row"],
  ["DR_TRAIN_STOP_LAP_TIME", "Mean lap time of evaluations, s"],
  ["DR_MAX_COST", "Cost, USD"],
  ["DR_SPOT_PRICE", "Price of this machine, USD per hour"],
  ["DR_TRAIN_EVAL_LAPS", "Evaluation laps per checkpoint"],
];

export async function show(main, params, { signal, query }) {
  fill(main, h("h1", {}, title), h("p", { role: "status" }, "Reading the folder ..."));
  const folder = await get("/api/new-folder", signal);
  if (!folder.exists) {
    offerFolder(main, folder, () => show(main, params, { signal, query }), signal);
    return;
  }
  let parts;
  try {
    parts = await Promise.all([
      get("/api/settings", signal),
      get("/api/track-list", signal),
      get("/api/metadata", signal),
      get("/api/hyperparameters", signal),
      get("/api/reward", signal),
      get("/api/reward/templates", signal),
    ]);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    fill(
      main,
      h("h1", {}, title),
      h("p", {}, "Correct the settings first; then this page goes on."),
      error.problems ? problemList(error.problems, toSettings) : failure(error),
      h(
        "p",
        { class: "actions" },
        h("a", { class: "button main", href: "#/settings" }, "Open the settings"),
        h(
          "button",
          { type: "button", click: () => show(main, params, { signal, query }) },
          "Try again",
        ),
      ),
    );
    return;
  }
  build(main, parts, { signal, query });
}

function toSettings(problem) {
  location.hash = problem.key?.startsWith("DR_") ? `#/settings?name=${problem.key}` : "#/settings";
}

function build(
  main,
  [form, tracks, metadata, hyperparameters, reward, templates],
  { signal, query },
) {
  const store = {
    versions: form.versions,
    settings: new Map(
      form.groups.flatMap((group) => group.settings).map((each) => [each.name, each]),
    ),
  };

  const model = settingsStep(
    {
      id: "model",
      title: "Model",
      hint: "The name is the folder of the model in the bucket: letters, digits and . _ - /. Give each training a new name.",
      store,
      names: MODEL,
      saved: () => launch.refresh(),
      changed: () => {
        for (const name of MODEL.slice(3))
          model.fields.get(name[0]).element.hidden =
            model.fields.get("DR_LOCAL_S3_PRETRAINED").value !== "True";
      },
    },
    signal,
  );

  const world = h("div", {}),
    raceNote = h("p", { role: "status" });
  const race = settingsStep(
    {
      id: "race",
      title: "Track and race",
      store,
      names: [["DR_WORLD_NAME", "Name of the track"], ...RACE],
      head: [world],
      foot: [raceNote],
      changed: () => {
        showRace();
        showTracks();
      },
      saved: () => {
        rewardFunction.refresh();
        launch.refresh();
      },
    },
    signal,
  );
  const picker = trackPicker(tracks, {
    choose: (name) => {
      race.fields.get("DR_WORLD_NAME").value = name;
    },
    setFurther: (words) => {
      race.fields.get("DR_TRAIN_WORLDS").value = words;
    },
  });
  const showTracks = () =>
    picker.set(race.fields.get("DR_WORLD_NAME").value, race.fields.get("DR_TRAIN_WORLDS").value);
  fill(world, picker.element);
  function showRace() {
    const type = race.fields.get("DR_RACE_TYPE").value;
    for (const [name, field] of race.fields) {
      for (const [kind, prefix] of Object.entries(OBJECT_SETTINGS))
        if (name.startsWith(prefix)) field.element.hidden = type !== kind;
    }
    raceNote.textContent = KIND_NOTES[type] ?? "";
  }

  const { sensors, actions, algorithm } = actionSteps(
    metadata,
    {
      saved: () => {
        learning.refresh();
        launch.refresh();
      },
      algorithmChanged: () => learning.refresh(),
    },
    signal,
  );
  const learning = hyperparameterStep(hyperparameters, { algorithm, saved: () => {} }, signal);
  const rewardFunction = rewardStep(reward, templates, { saved: () => {} }, signal);
  const stop = settingsStep(
    {
      id: "stop",
      title: "Stop conditions",
      hint: "The training ends as soon as one of them is met; 0 or empty is no limit. It can be stopped by hand at any time, and resumed. A number of laps is asked for at the start, in step 9.",
      store,
      names: STOP,
    },
    signal,
  );

  const edited = [model, race, sensors, learning, actions, rewardFunction, stop];
  const unsaved = () => edited.filter((each) => each.dirty);
  const { check, launch: startStep, refresh } = startSteps({ unsaved, lead }, signal);
  const launch = { refresh };
  const steps = [...edited, check, startStep];

  const marks = new Map(steps.map((step) => [step, h("span", { class: "step-mark" })]));
  const list = h(
    "nav",
    { class: "steps", "aria-label": "Steps" },
    h(
      "ol",
      {},
      steps.map((step) =>
        h(
          "li",
          {},
          h(
            "button",
            {
              type: "button",
              class: "link",
              click: () => {
                step.element.scrollIntoView({ block: "start" });
                document.getElementById(`title-${step.id}`).focus({ preventScroll: true });
              },
            },
            step.title,
          ),
          marks.get(step),
        ),
      ),
    ),
  );
  for (const step of edited)
    step.onChange = () => {
      marks.get(step).textContent = step.dirty ? " not saved" : "";
    };
  steps.forEach((step, k) => {
    step.element.querySelector("h2").prepend(`${k + 1}. `);
  });

  function lead(problem) {
    const name = (problem.file || "").split("/").at(-1);
    const at = {
      "reward_function.py": rewardFunction,
      "hyperparameters.json": learning,
      "model_metadata.json": actions,
    }[name];
    if (at?.lead(problem)) return;
    if ([model, race, stop].some((step) => step.lead(problem))) return;
    toSettings(problem);
  }

  fill(
    main,
    h("h1", {}, title),
    h(
      "p",
      { class: "quiet" },
      `Folder ${form.directory}, settings in ${form.run_file}. Each step is saved by itself.`,
    ),
    h(
      "div",
      { class: "new-training" },
      list,
      h(
        "div",
        { class: "step-list" },
        steps.map((step) => step.element),
      ),
    ),
  );
  race.fields.get("DR_WORLD_NAME").element.hidden = false;
  showTracks();
  for (const name of MODEL.slice(3))
    model.fields.get(name[0]).element.hidden =
      model.fields.get("DR_LOCAL_S3_PRETRAINED").value !== "True";
  showRace();
  refresh();
  guardLeaving(() => unsaved().length > 0, signal);
  const wanted = steps.find((step) => step.id === query.get("step"));
  if (wanted) wanted.element.scrollIntoView({ block: "start" });
}

/** A folder without run.env: write the files that `dr-init` writes, then go on. */
function offerFolder(main, folder, next, signal) {
  const name = h("input", {
    type: "text",
    id: "first-name",
    value: "first-model",
    autocomplete: "off",
    "aria-describedby": "first-help",
  });
  const option = (kind) => (each) =>
    h("option", { value: `${kind}:${each.name}` }, `${each.name}: ${each.about}`);
  const begin = h(
    "select",
    { id: "begin" },
    h("option", { value: "preset:" }, "The usual start: stay near the middle of the road"),
    h(
      "optgroup",
      { label: "Settings and files for a purpose" },
      folder.presets.map(option("preset")),
    ),
    h(
      "optgroup",
      { label: "A trained model, to drive at once or to train on" },
      folder.models.map(option("model")),
    ),
  );
  const state = h("div", { role: "status" }),
    button = h("button", { type: "submit", class: "main" }, "Create the working folder");
  async function create(event) {
    event?.preventDefault();
    button.disabled = true;
    await write(false);
    button.disabled = false;
  }
  async function write(replace) {
    const [kind, chosen] = begin.value.split(":");
    try {
      const made = await post(
        "/api/new-folder",
        { values: { DR_LOCAL_S3_MODEL_PREFIX: name.value.trim() }, [kind]: chosen, replace },
        signal,
      );
      notify(
        `${made.written.length} files written to ${made.folder}.${made.model ? ` ${made.model} is the trained model.` : ""}`,
      );
      for (const warning of made.warnings) notify(warning, "warn");
      await next();
      main.focus({ preventScroll: true });
    } catch (error) {
      if (error.name === "AbortError") return;
      if (error.clashes && !replace) {
        if (
          await confirmed(`Replace ${error.clashes.join(", ")}?`, {
            action: "Replace",
            detail: error.message + " The old files are kept as .bak.",
          })
        )
          await write(true);
        return;
      }
      fill(state, failure(error));
    }
  }
  fill(
    main,
    h("h1", {}, title),
    h(
      "div",
      { class: "empty" },
      h("p", {}, `${folder.directory} is not a working folder yet: it has no run.env.`),
      h(
        "p",
        {},
        prose(
          "Create one here. It gets run.env, system.env, your three files in custom_files/, and bin/activate.sh, as `dr-init` writes them.",
        ),
      ),
    ),
    h(
      "form",
      { class: "fields", submit: create },
      h(
        "div",
        { class: "field" },
        h("label", { for: "first-name" }, "Name of the first model"),
        name,
        h(
          "p",
          { class: "help", id: "first-help" },
          "Letters, digits and . _ - /. It can be changed in the next step.",
        ),
      ),
      h("div", { class: "field" }, h("label", { for: "begin" }, "Begin with"), begin),
      h("div", { class: "actions" }, button),
    ),
    state,
  );
}
