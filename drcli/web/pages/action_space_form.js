// Sensors, algorithm, network and actions: model_metadata.json.

import { get, post } from "/api.js";
import { failure, fill, h } from "/dom.js";
import { brokenFile, editStep, savedText, writeOwnFile } from "/edit_step.js";
import { polar } from "/polar.js";
import { debounced } from "/setting_fields.js";

const PATH = "/api/metadata";
const WORDS = {
  DEEP_CONVOLUTIONAL_NETWORK_SHALLOW: "shallow, of the reference",
  DEEP_CONVOLUTIONAL_NETWORK: "middle, of the reference",
  DEEP_CONVOLUTIONAL_NETWORK_DEEP: "deep, of the reference",
  COMPACT_CONVOLUTIONAL_NETWORK: "compact: learns fastest",
};
let count = 0;

function field(label, control, help = "") {
  control.id ||= `action-${++count}`;
  return h(
    "div",
    { class: "field" },
    h("label", { for: control.id }, label),
    control,
    help ? h("p", { class: "help" }, help) : null,
  );
}
const choice = (values, change, words = WORDS) =>
  h(
    "select",
    { change },
    values.map((value) => h("option", { value }, words[value] ?? value)),
  );
const figure = (value, change) =>
  h("input", {
    type: "text",
    inputmode: "decimal",
    autocomplete: "off",
    value: String(value),
    input: change,
  });
const read = (control) =>
  /^\s*[-+]?(\d+\.?\d*|\.\d+)\s*$/.test(control.value)
    ? Number(control.value)
    : control.value.trim();

/** Two steps, "sensors" with the algorithm and "actions", which are one file. */
export function actionSteps(facts, { saved, algorithmChanged }, signal) {
  let space,
    chosen = -1;
  const later = debounced(check, 400, signal);
  const changed = () => {
    for (const step of steps) step.mark(isChanged(step.keys), isChanged(step.keys) ? null : "");
    later();
  };

  const camera = choice(
    facts.cameras.filter(
      (name) => !facts.old_names.includes(name) || facts.values.sensor?.includes(name),
    ),
    changed,
    facts.words,
  );
  const lidar = h(
    "select",
    { change: changed },
    h("option", { value: "" }, "none"),
    facts.lidars.map((value) => h("option", { value }, facts.words[value])),
  );
  const algorithm = choice(
    facts.algorithms,
    () => {
      changed();
      algorithmChanged();
      draw();
    },
    facts.words,
  );
  const network = choice(facts.networks, changed);
  const sensors = editStep(
    {
      id: "sensors",
      title: "Sensors, network and algorithm",
      hint: "What the car sees, and how it learns. These cannot change later in the same model.",
      save: () => save(sensors),
    },
    h(
      "div",
      { class: "fields" },
      field("Camera", camera),
      field(
        "Lidar",
        lidar,
        "Sees other cars and boxes behind and beside the car; a time trial does not need it.",
      ),
      field(
        "Algorithm",
        algorithm,
        "PPO is steady and the usual choice. SAC learns from every step again and needs a continuous action space.",
      ),
      field("Network", network),
    ),
  );
  sensors.keys = ["sensor", "training_algorithm", "neural_network"];

  const kind = h(
    "select",
    {
      change: () => {
        switchKind();
        changed();
        draw();
      },
    },
    h("option", { value: "discrete" }, "Discrete: a list of actions"),
    h("option", { value: "continuous" }, "Continuous: ranges"),
  );
  const picture = polar({
    choose: (k) => {
      chosen = k;
      draw();
      body.querySelector(`[data-row="${k}"] input`)?.focus();
    },
  });
  const body = h("div", { class: "action-table" });
  const generated = h("p", { class: "field-problem", role: "status" });
  const generator = {
    max_angle: figure(30, () => {}),
    angles: figure(5, () => {}),
    max_speed: figure(1, () => {}),
    speeds: figure(2, () => {}),
  };
  const maker = h(
    "fieldset",
    { class: "maker" },
    h("legend", {}, "Generate a list"),
    h(
      "div",
      { class: "fields narrow" },
      field("Maximum steering, degrees", generator.max_angle, "0.5 to 30"),
      field("Steering granularity", generator.angles, "Number of angles; 3, 5 or 7 are usual"),
      field("Maximum speed, m/s", generator.max_speed, "0.1 to 4"),
      field("Speed granularity", generator.speeds, "Number of speeds; 1, 2 or 3 are usual"),
    ),
    h("div", { class: "actions" }, h("button", { type: "button", click: generate }, "Generate")),
    generated,
  );
  const actions = editStep(
    {
      id: "actions",
      title: "Action space",
      hint: "What the car can do in each step. Steering to the left is positive.",
      save: () => save(actions),
    },
    field("Kind", kind),
    h("div", { class: "split" }, picture.element, h("div", {}, maker, body)),
  );
  actions.keys = ["action_space"];
  const steps = [sensors, actions];

  function take(values) {
    facts.values = values;
    camera.value =
      values.sensor?.find((name) => facts.cameras.includes(name)) ?? "FRONT_FACING_CAMERA";
    lidar.value = values.sensor?.find((name) => facts.lidars.includes(name)) ?? "";
    algorithm.value = String(values.training_algorithm ?? "clipped_ppo").toLowerCase();
    network.value = values.neural_network ?? "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW";
    space = structuredClone(values.action_space ?? []);
    kind.value = Array.isArray(space) ? "discrete" : "continuous";
    chosen = -1;
  }
  function present() {
    return {
      sensor: [camera.value, lidar.value].filter(Boolean),
      training_algorithm: algorithm.value,
      neural_network: network.value,
      action_space: space,
    };
  }
  function changes(keys) {
    const now = present(),
      before = {
        sensor: ["FRONT_FACING_CAMERA"],
        training_algorithm: "clipped_ppo",
        neural_network: "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
        ...facts.values,
      };
    return Object.fromEntries(
      keys
        .filter((key) => JSON.stringify(now[key]) !== JSON.stringify(before[key]))
        .map((key) => [key, now[key]]),
    );
  }
  const isChanged = (keys) => Object.keys(changes(keys)).length > 0;

  function switchKind() {
    const listed = Array.isArray(space);
    if ((kind.value === "discrete") === listed) return;
    if (listed) {
      const angles = space.map((each) => each.steering_angle).filter(Number.isFinite),
        speeds = space.map((each) => each.speed).filter(Number.isFinite);
      const [low, high] = [Math.min(...speeds, 4), Math.max(...speeds, 0.1)];
      space = {
        steering_angle: { low: Math.min(...angles, -5), high: Math.max(...angles, 5) },
        speed: { low: low < high ? low : high / 2, high },
      };
    } else {
      const { steering_angle: turn, speed } = space,
        fast = Number.isFinite(speed?.high) ? speed.high : 1,
        wide = Number.isFinite(turn?.high) ? turn.high : 30;
      space = [-1, -0.5, 0, 0.5, 1].map((part) => ({
        steering_angle: part * wide,
        speed: Math.round(fast * (1 - 0.4 * Math.abs(part)) * 100) / 100,
      }));
    }
  }
  async function generate() {
    try {
      const wanted = Object.fromEntries(
        Object.entries(generator).map(([key, control]) => [key, read(control)]),
      );
      const made = await post(`${PATH}/generate`, wanted, signal);
      space = made.actions;
      chosen = -1;
      generated.textContent = made.note || `${made.actions.length} actions.`;
      changed();
      draw();
    } catch (error) {
      if (error.name !== "AbortError")
        fill(generated, h("span", { class: "bad" }, `${error.message} ${error.remedy}`));
    }
  }
  function draw() {
    maker.hidden = kind.value !== "discrete";
    picture.show(space, chosen);
    if (kind.value === "continuous") {
      const one = (name, unit, end, word) =>
        field(
          `${word} ${name}, ${unit[0]}`,
          figure(space[unit[1]]?.[end] ?? "", (event) => {
            space[unit[1]] = { ...space[unit[1]], [end]: read(event.currentTarget) };
            picture.show(space);
            changed();
          }),
        );
      fill(
        body,
        h(
          "div",
          { class: "fields narrow" },
          one("steering", ["degrees", "steering_angle"], "low", "Rightmost"),
          one("steering", ["degrees", "steering_angle"], "high", "Leftmost"),
          one("speed", ["m/s", "speed"], "low", "Least"),
          one("speed", ["m/s", "speed"], "high", "Greatest"),
        ),
        h(
          "p",
          { class: "help" },
          "Steering from -30 (right) to 30 (left) degrees, speed from 0.1 to 4 m/s.",
        ),
      );
      return;
    }
    const edit = (k, key, label) =>
      h("input", {
        type: "text",
        inputmode: "decimal",
        autocomplete: "off",
        "aria-label": `${label} of action ${k}`,
        value: String(space[k][key] ?? ""),
        "data-key": key,
        focus: () => {
          chosen = k;
          picture.show(space, chosen);
        },
        input: (event) => {
          space[k] = { ...space[k], [key]: read(event.currentTarget) };
          picture.show(space, chosen);
          changed();
        },
      });
    fill(
      body,
      h(
        "div",
        { class: "scroll", tabindex: "0", role: "region", "aria-label": "Actions" },
        h(
          "table",
          {},
          h("caption", {}, "Actions, as the network numbers them"),
          h(
            "thead",
            {},
            h(
              "tr",
              {},
              ["No.", "Steering, degrees", "Speed, m/s", "Remove"].map((head) =>
                h("th", { scope: "col" }, head),
              ),
            ),
          ),
          h(
            "tbody",
            {},
            space.map((_, k) =>
              h(
                "tr",
                { "data-row": k },
                h("td", {}, String(k)),
                h("td", {}, edit(k, "steering_angle", "Steering")),
                h("td", {}, edit(k, "speed", "Speed")),
                h(
                  "td",
                  {},
                  h(
                    "button",
                    {
                      type: "button",
                      class: "plain",
                      "aria-label": `Remove action ${k}`,
                      disabled: space.length < 2,
                      click: () => {
                        space.splice(k, 1);
                        chosen = -1;
                        changed();
                        draw();
                        body
                          .querySelector(`[data-row="${Math.min(k, space.length - 1)}"] input`)
                          ?.focus();
                      },
                    },
                    "×",
                  ),
                ),
              ),
            ),
          ),
        ),
      ),
      h(
        "div",
        { class: "actions" },
        h(
          "button",
          {
            type: "button",
            click: () => {
              space.push({ steering_angle: 0, speed: 1 });
              chosen = space.length - 1;
              changed();
              draw();
              body.querySelector(`[data-row="${chosen}"] input`)?.focus();
            },
          },
          "Add an action",
        ),
      ),
    );
  }
  function show(found) {
    const ofSensors = (each) =>
      /^(sensor|lidar|training_algorithm|neural_network|version|exploration)/.test(each.key);
    sensors.problems(found.filter(ofSensors));
    actions.problems(
      found.filter((each) => !ofSensors(each)),
      lead,
    );
  }
  async function check() {
    try {
      show(
        (
          await post(
            `${PATH}/check`,
            { values: changes([...sensors.keys, ...actions.keys]) },
            signal,
          )
        ).problems,
      );
    } catch (error) {
      if (error.name !== "AbortError") fill(generated, failure(error));
    }
  }
  async function save(step) {
    // PPO with ranges may become SAC only together with them: what belongs together is saved together.
    const both = changes([...sensors.keys, ...actions.keys]),
      alone = changes(step.keys);
    const together = "training_algorithm" in both && "action_space" in both;
    const values = together ? both : alone;
    const answer = await writeOwnFile(
      PATH,
      { values, version: facts.version },
      {
        mine: JSON.stringify({ ...facts.values, ...values }, null, 2),
        read: () => get(PATH, signal),
        signal,
      },
    );
    if (!answer) {
      step.mark(true, "Not saved.");
      return;
    }
    const kept =
      together || answer.disk
        ? null
        : { step: steps.find((each) => each !== step), now: present() };
    Object.assign(facts, answer.disk ?? answer);
    const text = answer.disk ? "Taken from the disk." : savedText(answer);
    if (kept) {
      // The other step keeps what was edited there.
      facts.values = answer.values;
      space = kept.now.action_space;
    } else {
      take(facts.values);
      draw();
    }
    for (const each of steps)
      each.mark(
        isChanged(each.keys),
        isChanged(each.keys) ? null : each === step || together ? text : "",
      );
    await check();
    saved();
  }
  function lead(problem) {
    const row = /^action_space\[(\d+)\](?:\.(\w+))?/.exec(problem.key);
    if (row) {
      const control = body.querySelector(
        `[data-row="${row[1]}"] input${row[2] ? `[data-key="${row[2]}"]` : ""}`,
      );
      control?.focus();
      control?.scrollIntoView({ block: "center" });
      return Boolean(control);
    }
    const control =
      {
        sensor: camera,
        training_algorithm: algorithm,
        neural_network: network,
        lidar_config: lidar,
      }[problem.key.split(/[.[]/)[0]] ?? kind;
    control.focus();
    control.scrollIntoView({ block: "center" });
    return true;
  }
  for (const step of steps) step.lead = lead;
  take(facts.values);
  draw();
  show(facts.problems);
  brokenFile(sensors, facts, PATH, reread, signal);
  async function reread() {
    Object.assign(facts, await get(PATH, signal));
    take(facts.values);
    draw();
    show(facts.problems);
    brokenFile(sensors, facts, PATH, reread, signal);
    for (const step of steps) step.mark(false, "");
  }
  return { sensors, actions, algorithm: () => algorithm.value };
}
