// Check everything, and start the training.

import { get, post } from "/api.js";
import { confirmed, failure, fill, h, notify, prose } from "/dom.js";
import { follow } from "/socket.js";
import { problemList } from "/setting_fields.js";

/** The last two steps; `unsaved` gives the steps that are not saved, `lead` leads to a problem. */
export function startSteps({ unsaved, lead }, signal) {
  const validated = h("div", { class: "validated" }),
    checkState = h("p", { class: "step-state", role: "status" }, " ");
  const compatible = h("input", { type: "checkbox", id: "compatible" });
  const checkButton = h("button", { type: "button", click: validate }, "Validate now");
  const check = {
    id: "validate",
    title: "Validate",
    element: h(
      "section",
      { class: "step", id: "step-validate", "aria-labelledby": "title-validate" },
      h("h2", { id: "title-validate", tabindex: "-1" }, "Validate"),
      h(
        "p",
        { class: "quiet" },
        prose(
          "Checks settings, your three files, the bucket and this machine, as `dr-validate` does. Nothing is changed.",
        ),
      ),
      h(
        "p",
        { class: "actions" },
        compatible,
        h("label", { for: "compatible" }, "Also apply the limits of the DeepRacer console"),
      ),
      h("div", { class: "actions" }, checkButton, checkState),
      validated,
    ),
  };

  const goals = new Map(),
    goalFields = h("div", { class: "fields narrow" });
  const seed = h("input", {
    type: "text",
    inputmode: "numeric",
    id: "seed",
    placeholder: "drawn",
    autocomplete: "off",
  });
  const about = h("div", {}),
    startState = h("p", { class: "step-state", role: "status" }, " "),
    result = h("div", {});
  const buttons = {
    new: h(
      "button",
      { type: "button", class: "main", click: () => start("new") },
      "Start the training",
    ),
    resume: h("button", { type: "button", click: () => start("resume") }, "Resume this model"),
    wipe: h(
      "button",
      { type: "button", class: "danger", click: () => start("wipe") },
      "Delete the model and start over",
    ),
  };
  const launch = {
    id: "start",
    title: "Start",
    element: h(
      "section",
      { class: "step", id: "step-start", "aria-labelledby": "title-start" },
      h("h2", { id: "title-start", tabindex: "-1" }, "Start"),
      about,
      goalFields,
      h(
        "div",
        { class: "fields narrow" },
        h(
          "div",
          { class: "field" },
          h("label", { for: "seed" }, "Seed (this start only)"),
          seed,
          h(
            "p",
            { class: "help" },
            "Repeats a training exactly. Empty: DR_TRAIN_SEED, or a new one.",
          ),
        ),
      ),
      h("div", { class: "actions" }, Object.values(buttons), startState),
      result,
    ),
  };
  let facts = null,
    busy = false,
    mine = 0;

  async function saveAll(what) {
    const open = unsaved();
    if (!open.length) return true;
    const names = open.map((step) => step.title).join(", ");
    if (
      !(await confirmed(`${names}: not saved yet. Save and ${what}?`, {
        action: "Save all",
        detail: "The check and the training read the saved files.",
      }))
    )
      return false;
    for (const step of open)
      if (!(await step.save())) {
        step.element.scrollIntoView({ block: "start" });
        return false;
      }
    return true;
  }
  async function validate() {
    if (!(await saveAll("validate"))) return;
    checkButton.disabled = true;
    checkState.textContent = "Checking settings, files, bucket and this machine ...";
    fill(validated);
    try {
      const found = await post("/api/validate", { console_compatible: compatible.checked }, signal);
      const all = [...found.errors, ...found.warnings, ...found.notes],
        plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
      checkState.textContent = found.ok
        ? `A training can start. ${plural(found.warnings.length, "warning")}.`
        : `A training cannot start: ${plural(found.errors.length, "error")}, ${plural(found.warnings.length, "warning")}.`;
      fill(
        validated,
        problemList(all, lead),
        found.skipped.length
          ? h(
              "ul",
              { class: "problems" },
              found.skipped.map((each) =>
                h(
                  "li",
                  {},
                  h("strong", {}, "Not checked "),
                  `${each.rules.join(", ")}: ${each.reason}`,
                ),
              ),
            )
          : null,
      );
    } catch (error) {
      if (error.name === "AbortError") return;
      checkState.textContent = "Not checked.";
      fill(validated, failure(error));
    }
    checkButton.disabled = false;
  }
  async function refresh() {
    try {
      facts = await get("/api/start", signal);
    } catch (error) {
      if (error.name !== "AbortError") {
        facts = null;
        fill(about, failure(error));
        enable();
      }
      return;
    }
    if (!goals.size) fill(goalFields, facts.goals.map(goalField));
    const texts = [`The model is called ${facts.model}.`];
    if (facts.pretrained) texts.push(`It begins with the weights of ${facts.pretrained}.`);
    if (facts.trains)
      texts.push(
        `Run ${facts.run_id} is training ${facts.trains} now. Stop it first, or choose another DR_RUN_ID in the settings.`,
      );
    else if (facts.checkpoint)
      texts.push(
        `The bucket has a model of this name, with checkpoint ${facts.checkpoint}. Resume this one, or give the new model another name in step 1.`,
      );
    else if (facts.used)
      texts.push(
        "The bucket has files under this name, but no checkpoint. Give the new model another name in step 1.",
      );
    if (facts.fetch.length) texts.push(`${facts.fetch.join(", ")} will be downloaded first.`);
    if (facts.bucket_error) texts.push(`The bucket cannot be read now: ${facts.bucket_error}`);
    fill(
      about,
      texts.map((text) => h("p", {}, text)),
    );
    enable();
  }
  function enable() {
    const idle = facts !== null && !facts.trains && !busy;
    buttons.new.disabled = !idle || facts.used;
    buttons.resume.hidden = !facts?.checkpoint;
    buttons.wipe.hidden = !facts?.used;
    buttons.resume.disabled = buttons.wipe.disabled = !idle;
  }
  const whole = (control, name) => {
    const text = control.value.trim();
    if (!text) return null;
    if (!/^\d+$/.test(text)) {
      control.focus();
      throw Object.assign(new Error(`${name} ${text} is not a whole number.`), {
        remedy: "Write digits only, or leave it empty.",
      });
    }
    return Number(text);
  };
  function goalField(goal) {
    const id = goal.key.replaceAll("_", "-");
    const control = h("input", {
      type: "text",
      inputmode: goal.whole ? "numeric" : "decimal",
      id,
      placeholder: "no limit",
      autocomplete: "off",
    });
    goals.set(goal, control);
    return h(
      "div",
      { class: "field" },
      h("label", { for: id }, goal.label),
      control,
      h("p", { class: "help" }, goal.hint),
    );
  }
  const number = (control, { noun, unit }) => {
    const text = control.value.trim();
    if (!text) return null;
    if (!/^\d+(\.\d+)?$/.test(text)) {
      control.focus();
      throw Object.assign(new Error(`${noun} ${text} is not a number of ${unit}.`), {
        remedy: "Write a number such as 8.5, or leave it empty.",
      });
    }
    return Number(text);
  };
  async function start(how) {
    fill(result);
    let wanted;
    try {
      wanted = { seed: whole(seed, "Seed") };
      for (const [goal, control] of goals)
        wanted[goal.key] = goal.whole ? whole(control, goal.noun) : number(control, goal);
    } catch (error) {
      startState.textContent = "Not started.";
      fill(result, failure(error));
      return;
    }
    if (!(await saveAll("start"))) return;
    await refresh();
    if (!facts) return;
    if (
      how === "wipe" &&
      !(await confirmed(`Delete the model ${facts.model} and start over?`, {
        action: "Delete and start",
        detail: "All its checkpoints, traces and videos in the bucket are lost.",
      }))
    )
      return;
    if (
      how === "resume" &&
      !(await confirmed(`Resume the training of ${facts.model}?`, {
        action: "Resume",
        detail: `It goes on from checkpoint ${facts.checkpoint}.`,
      }))
    )
      return;
    let fetch = false;
    if (facts.fetch.length && facts.fetch_allowed === "ask") {
      fetch = await confirmed(
        `Download the track ${facts.fetch.join(", ")} from the address DR_TRACKS_URL?`,
        {
          action: "Download and start",
          detail: "It is a track of the community that is not installed.",
        },
      );
      if (!fetch) return;
    }
    busy = true;
    enable();
    startState.textContent = "Starting ...";
    try {
      const task = await post(
        "/api/start",
        { how, confirmed: facts.model, fetch, ...wanted },
        signal,
      );
      mine = task.id;
      watch(task);
    } catch (error) {
      if (error.name === "AbortError") return;
      failed(error);
    }
  }
  function failed(error) {
    busy = false;
    mine = 0;
    startState.textContent = "Not started.";
    fill(result, error.problems ? problemList(error.problems, lead) : failure(error));
    refresh();
  }
  function watch(task) {
    if (task.state === "failed") failed(task.error);
    else if (task.state === "done") {
      busy = false;
      mine = 0;
      startState.textContent = "The training runs.";
      notify(`The training of ${task.result.model} runs. ${task.result.ends}`);
      for (const text of task.result.warnings) notify(text, "warn");
      location.hash = "#/";
    } else startState.textContent = task.text || "Starting ...";
  }
  follow(
    "tasks",
    ({ tasks = [] }) => {
      const task = mine && tasks.find((each) => each.id === mine);
      if (task) watch(task);
    },
    signal,
  );
  follow(
    "run",
    (run) => {
      if (facts && !busy && (run.state === "running") !== Boolean(facts.trains)) refresh();
    },
    signal,
  );
  enable();
  return { check, launch, refresh };
}
