// Sensors, algorithm, network and actions: two steps that are one file, model_metadata.json.

import { post } from "/api.js";
import { useDraft } from "/drafts.js";
import { SelectField, TextField, useChecked } from "/fields.js";
import { Polar } from "/polar.js";
import { BrokenFile, Step, useFileSaving } from "/steps.js";
import { useAction } from "/store.js";
import { html, useRef, useState } from "/ui.js";

const PATH = "/api/metadata";
const DEFAULTS = {
  sensor: ["FRONT_FACING_CAMERA"],
  training_algorithm: "clipped_ppo",
  neural_network: "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
  action_space: [],
};
const KEYS = {
  sensors: ["sensor", "training_algorithm", "neural_network"],
  actions: ["action_space"],
};
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
const isOfSensors = (each) =>
  /^(sensor|lidar|training_algorithm|neural_network|version|exploration)/.test(each.key);
/** A number if it is written as one; else the text, of which the check says what is wrong. */
const read = (text) => (/^\s*[-+]?(\d+\.?\d*|\.\d+)\s*$/.test(text) ? Number(text) : text.trim());

/**
 * The edits of model_metadata.json, for both steps.
 * @param {{facts: Object, reload: () => Promise<void>, folder: string, saved: () => void}} options `facts` is the answer of /api/metadata
 */
export function useMetadata({ facts, reload, folder, saved }) {
  const draft = useDraft(`${folder}/model_metadata`, facts.version);
  const before = { ...DEFAULTS, ...facts.values };
  before.training_algorithm = String(before.training_algorithm).toLowerCase();
  const now = { ...before, ...draft.edits };
  const { edits } = draft;
  const set = (key, value) => {
    const { [key]: _, ...others } = edits;
    draft.set(same(value, before[key]) ? others : { ...others, [key]: value });
  };
  const checked = useChecked(`${PATH}/check`, { values: edits }, 400, {}, facts.version);
  const problems = checked.answer?.problems ?? facts.problems;
  const pick = (keys) =>
    Object.fromEntries(Object.entries(edits).filter(([key]) => keys.includes(key)));
  // PPO with ranges may become SAC only together with them: what belongs together is saved together.
  const together = "training_algorithm" in edits && "action_space" in edits;
  const saveOf = (step) => {
    const values = together ? edits : pick(KEYS[step]);
    const mine = JSON.stringify({ ...facts.values, ...values }, null, 2);
    return { path: PATH, draft, edits: values, body: { values }, mine, reload, saved };
  };
  const dirty = {
    sensors: Object.keys(pick(KEYS.sensors)).length > 0,
    actions: "action_space" in edits,
  };
  const saving = {
    sensors: useFileSaving(dirty.sensors, saveOf("sensors")),
    actions: useFileSaving(dirty.actions, saveOf("actions")),
  };
  return { facts, draft, now, set, problems, dirty, saving, reload, checkFailed: checked.error };
}

export function SensorStep({ metadata }) {
  const { facts, now, set, problems, dirty, saving, draft, reload } = metadata;
  const cameras = facts.cameras.filter(
    (name) => !facts.old_names.includes(name) || now.sensor?.includes(name),
  );
  const camera = facts.cameras.find((name) => now.sensor?.includes(name)) ?? "";
  const lidar = facts.lidars.find((name) => now.sensor?.includes(name)) ?? "";
  const named = (names, words) => names.map((name) => [name, words[name] ?? name]);
  const sense = (one, other) => set("sensor", [one, other].filter(Boolean));
  return html`
    <${Step} id="sensors" title="Sensors, network and algorithm" dirty=${dirty.sensors} saving=${saving.sensors} draft=${draft}
      hint="What the car sees, and how it learns. These cannot change later in the same model." problems=${problems.filter(isOfSensors)}>
      <${BrokenFile} facts=${facts} path=${PATH} again=${reload} />
      <div class="fields">
        <${SelectField} label="Camera" data-key="sensor" options=${named(cameras, facts.words)} value=${camera} onChange=${(name) => sense(name, lidar)} />
        <${SelectField} label="Lidar" data-key="lidar_config" options=${[["", "none"], ...named(facts.lidars, facts.words)]} value=${lidar}
          onChange=${(name) => sense(camera, name)} help="Sees other cars and boxes behind and beside the car; a time trial does not need it." />
        <${SelectField} label="Algorithm" data-key="training_algorithm" options=${named(facts.algorithms, facts.words)} value=${now.training_algorithm}
          onChange=${(name) => set("training_algorithm", name)} help="PPO is steady and the usual choice. SAC learns from every step again and needs a continuous action space." />
        <${SelectField} label="Network" data-key="neural_network" options=${named(facts.networks, facts.words)} value=${now.neural_network} onChange=${(name) => set("neural_network", name)} />
      </div>
    <//>`;
}

/** A list as ranges around it, or ranges as a list of five. */
function otherKind(space) {
  if (!Array.isArray(space)) {
    const fast = Number.isFinite(space.speed?.high) ? space.speed.high : 1;
    const wide = Number.isFinite(space.steering_angle?.high) ? space.steering_angle.high : 30;
    return [-1, -0.5, 0, 0.5, 1].map((part) => ({
      steering_angle: part * wide,
      speed: Math.round(fast * (1 - 0.4 * Math.abs(part)) * 100) / 100,
    }));
  }
  const angles = space.map((each) => each.steering_angle).filter(Number.isFinite);
  const speeds = space.map((each) => each.speed).filter(Number.isFinite);
  const [low, high] = [Math.min(...speeds, 4), Math.max(...speeds, 0.1)];
  return {
    steering_angle: { low: Math.min(...angles, -5), high: Math.max(...angles, 5) },
    speed: { low: low < high ? low : high / 2, high },
  };
}

export function ActionStep({ metadata }) {
  const { now, set, problems, dirty, saving, draft } = metadata;
  const [chosen, setChosen] = useState(-1);
  const place = useRef(null);
  const space = now.action_space;
  const listed = Array.isArray(space);
  const own = problems.filter((each) => !isOfSensors(each));
  const change = (value) => set("action_space", value);
  const focus = (k) =>
    setTimeout(() => place.current.querySelector(`[data-row="${k}"] input`)?.focus());
  const choose = (k) => {
    setChosen(k);
    focus(k);
  };
  return html`
    <${Step} id="actions" title="Action space" dirty=${dirty.actions} saving=${saving.actions} draft=${dirty.sensors ? null : draft}
      hint="What the car can do in each step. Steering to the left is positive." problems=${own}>
      <div class="split">
        <div>
          <${SelectField} label="Kind" data-key="action_space" value=${listed ? "discrete" : "continuous"}
            options=${[
              ["discrete", "Discrete: a list of actions"],
              ["continuous", "Continuous: ranges"],
            ]}
            onChange=${() => {
              setChosen(-1);
              change(otherKind(space));
            }} />
          <${Polar} space=${space} chosen=${chosen} choose=${choose} />
        </div>
        <div>
          ${
            listed &&
            html`<${Generator} made=${(actions) => {
              setChosen(-1);
              change(actions);
            }} />`
          }
          <div class="action-table" ref=${place}>
            ${
              listed
                ? html`<${ActionTable} space=${space} problems=${own} change=${change} chosen=${chosen} choose=${setChosen} focus=${focus} />`
                : html`<${Ranges} space=${space} problems=${own} change=${change} />`
            }
          </div>
        </div>
      </div>
    <//>`;
}

function Generator({ made }) {
  const [wanted, setWanted] = useState({
    max_angle: "30",
    angles: "5",
    max_speed: "1",
    speeds: "2",
  });
  const [said, setSaid] = useState("");
  const [generate, busy] = useAction(async () => {
    const values = Object.fromEntries(
      Object.entries(wanted).map(([key, text]) => [key, read(text)]),
    );
    try {
      const { actions, note } = await post(`${PATH}/generate`, values);
      made(actions);
      setSaid(note || `${actions.length} actions.`);
    } catch (error) {
      setSaid(html`<span class="bad">${error.message} ${error.remedy}</span>`);
    }
  });
  const field = (
    key,
    label,
    help,
  ) => html`<${TextField} label=${label} help=${help} numeric=${true} value=${wanted[key]}
    onInput=${(text) => setWanted({ ...wanted, [key]: text })} />`;
  return html`
    <fieldset class="maker">
      <legend>Generate a list</legend>
      <div class="fields narrow">
        ${field("max_angle", "Maximum steering, degrees", "0.5 to 30")}
        ${field("angles", "Steering granularity", "Number of angles; 3, 5 or 7 are usual")}
        ${field("max_speed", "Maximum speed, m/s", "0.1 to 4")}
        ${field("speeds", "Speed granularity", "Number of speeds; 1, 2 or 3 are usual")}
      </div>
      <div class="actions"><button type="button" aria-disabled=${busy ? "true" : null} onClick=${generate}>Generate</button></div>
      <p class="field-problem" role="status">${said}</p>
    </fieldset>`;
}

function Ranges({ space, problems, change }) {
  const one = (
    label,
    key,
    end,
  ) => html`<${TextField} label=${label} numeric=${true} data-key=${`action_space.${key}`}
    problems=${problems.filter((each) => each.key === `action_space.${key}.${end}`)} value=${String(space[key]?.[end] ?? "")}
    onInput=${(text) => change({ ...space, [key]: { ...space[key], [end]: read(text) } })} />`;
  return html`
    <div class="fields narrow">
      ${one("Rightmost steering, degrees", "steering_angle", "low")}
      ${one("Leftmost steering, degrees", "steering_angle", "high")}
      ${one("Least speed, m/s", "speed", "low")}
      ${one("Greatest speed, m/s", "speed", "high")}
    </div>
    <p class="help">Steering from -30 (right) to 30 (left) degrees, speed from 0.1 to 4 m/s.</p>`;
}

function ActionTable({ space, problems, change, chosen, choose, focus }) {
  const edit = (k, key, label) => {
    const name = `action_space[${k}].${key}`;
    const bad = problems.some(
      (each) =>
        each.severity === "error" && (each.key === name || each.key === `action_space[${k}]`),
    );
    return html`<input type="text" inputmode="decimal" autocomplete="off" aria-label=${`${label} of action ${k}`} data-key=${name}
      aria-invalid=${bad ? "true" : null} value=${String(space[k][key] ?? "")} onFocus=${() => choose(k)}
      onInput=${(event) => change(space.map((each, at) => (at === k ? { ...each, [key]: read(event.currentTarget.value) } : each)))} />`;
  };
  const remove = (k) => {
    choose(-1);
    change(space.filter((_, at) => at !== k));
    focus(Math.min(k, space.length - 2));
  };
  const add = () => {
    choose(space.length);
    change([...space, { steering_angle: 0, speed: 1 }]);
    focus(space.length);
  };
  return html`
    <div class="scroll" tabindex="0" role="region" aria-label="Actions">
      <table>
        <caption>Actions, as the network numbers them</caption>
        <thead><tr>${["No.", "Steering, degrees", "Speed, m/s", "Remove"].map((head) => html`<th scope="col">${head}</th>`)}</tr></thead>
        <tbody>${space.map(
          (_, k) => html`<tr key=${k} data-row=${k} class=${k === chosen ? "chosen" : null}>
          <td>${k}</td>
          <td>${edit(k, "steering_angle", "Steering")}</td>
          <td>${edit(k, "speed", "Speed")}</td>
          <td><button type="button" class="plain" aria-label=${`Remove action ${k}`} disabled=${space.length < 2} onClick=${() => remove(k)}>×</button></td>
        </tr>`,
        )}</tbody>
      </table>
    </div>
    <div class="actions"><button type="button" onClick=${add}>Add an action</button></div>`;
}
