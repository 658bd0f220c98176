// Sensors, algorithm, network and actions: two steps that are one file, model_metadata.json.

import { post } from "/api.js";
import { aboutField } from "/ask.js";
import { useDraft } from "/drafts.js";
import { Field, Fields, readFields, startOf, useChecked } from "/fields.js";
import { Polar } from "/polar.js";
import { BrokenFile, Step, useFileSaving } from "/steps.js";
import { useAction } from "/store.js";
import { Button, Columns, html, useRef, useState } from "/ui.js";

const PATH = "/api/metadata";
const KEYS = {
  sensors: ["sensor", "training_algorithm", "neural_network"],
  actions: ["action_space"],
};
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
  const { edits } = draft;
  const now = { ...facts.start, ...edits };
  const set = (key, value) => draft.change(key, value, facts.start[key]);
  const checked = useChecked(`${PATH}/check`, { values: edits }, 400, {}, facts.version);
  const problems = checked.answer?.problems ?? facts.problems;
  // PPO with ranges may become SAC only together with them: what belongs together is saved together.
  const together = "training_algorithm" in edits && "action_space" in edits;
  const stepOf = (name) => {
    const own = Object.entries(edits).filter(([key]) => KEYS[name].includes(key));
    const values = together ? edits : Object.fromEntries(own);
    const mine = JSON.stringify({ ...facts.values, ...values }, null, 2);
    const options = { path: PATH, draft, edits: values, body: { values }, mine, reload, saved };
    const dirty = own.length > 0;
    return { dirty, saving: useFileSaving(dirty, options) };
  };
  const steps = { sensors: stepOf("sensors"), actions: stepOf("actions") };
  return { facts, draft, now, set, problems, steps, reload };
}

export function SensorStep({ metadata: { facts, draft, now, set, problems, steps, reload } }) {
  const one = (names) => names.find((name) => now.sensor?.includes(name)) ?? "";
  const values = { ...now, sensor: one(facts.cameras), lidar_config: one(facts.lidars) };
  const change = (name, value) => {
    if (name === "sensor") set("sensor", [value, values.lidar_config].filter(Boolean));
    else if (name === "lidar_config") set("sensor", [values.sensor, value].filter(Boolean));
    else set(name, value);
  };
  return html`
    <${Step} id="sensors" title="Sensors, network and algorithm" draft=${draft} ...${steps.sensors}
      hint="What the car sees, and how it learns. These cannot change later in the same model." problems=${problems.filter((each) => isOfSensors(each) && !(each.key in values))}>
      <${BrokenFile} facts=${facts} path=${PATH} again=${reload} />
      <div class="fields"><${Fields} fields=${facts.fields} values=${values} set=${change} problems=${problems} /></div>
    <//>`;
}

/** A list as ranges around it, or ranges as a list of five that are slower in curves. */
function otherKind(space) {
  if (Array.isArray(space)) {
    const valuesOf = (key) => space.map((each) => each[key]).filter(Number.isFinite);
    const [angles, speeds] = [valuesOf("steering_angle"), valuesOf("speed")];
    const high = Math.max(...speeds, 0.2);
    const low = Math.min(...speeds, high);
    return {
      steering_angle: { low: Math.min(...angles, -5), high: Math.max(...angles, 5) },
      speed: { low: low < high ? low : high / 2, high },
    };
  }
  const highest = (key, usual) => (Number.isFinite(space[key]?.high) ? space[key].high : usual);
  return [-1, -0.5, 0, 0.5, 1].map((part) => ({
    steering_angle: part * highest("steering_angle", 30),
    speed: Number((highest("speed", 1) * (1 - 0.4 * Math.abs(part))).toFixed(2)),
  }));
}

export function ActionStep({ metadata: { facts, draft, now, set, problems, steps } }) {
  const [chosen, setChosen] = useState(-1);
  const place = useRef(null);
  const space = now.action_space;
  const listed = Array.isArray(space);
  const own = problems.filter((each) => !isOfSensors(each));
  const change = (value) => set("action_space", value);
  const replace = (value) => {
    setChosen(-1);
    change(value);
  };
  const focus = (k) =>
    setTimeout(() => place.current.querySelector(`[data-key^="action_space[${k}]"]`)?.focus());
  const choose = (k) => {
    setChosen(k);
    focus(k);
  };
  const props = { space, problems: own, change, facts };
  return html`
    <${Step} id="actions" title="Action space" draft=${steps.sensors.dirty ? null : draft} ...${steps.actions}
      hint="What the car can do in each step. Steering to the left is positive." problems=${own}>
      <div class="split">
        <div>
          <${Field} label="Kind" place="action_space" value=${listed ? "discrete" : "continuous"} options=${facts.kinds} set=${() => replace(otherKind(space))} />
          <${Polar} space=${space} chosen=${chosen} choose=${choose} />
        </div>
        <div>
          ${listed && html`<${Generator} fields=${facts.grid} made=${replace} />`}
          <div class="action-table" ref=${place}>
            ${listed ? html`<${ActionTable} ...${props} chosen=${chosen} choose=${setChosen} focus=${focus} />` : html`<${Ranges} ...${props} />`}
          </div>
        </div>
      </div>
    <//>`;
}

function Generator({ fields, made }) {
  const [values, setValues] = useState(() => startOf(fields));
  const [said, setSaid] = useState(null);
  const [refused, setRefused] = useState([]);
  const { given, wrong } = readFields(fields, values);
  const change = (name, text) => {
    setRefused([]);
    setValues({ ...values, [name]: text });
  };
  const [generate, busy] = useAction(async () => {
    try {
      const { actions, note } = await post(`${PATH}/generate`, given);
      made(actions);
      setSaid(note || `${actions.length} actions.`);
    } catch (error) {
      const about = aboutField(error);
      setSaid(about.key in given ? null : `${about.message} ${about.remedy}`);
      setRefused([about]);
    }
  });
  return html`
    <fieldset class="maker">
      <legend>Generate a list</legend>
      <div class="fields narrow">
        <${Fields} fields=${fields} values=${values} problems=${[...wrong, ...refused]} set=${change} />
      </div>
      <div class="actions"><${Button} busy=${busy || wrong.length > 0} onClick=${generate}>Generate<//></div>
      <p class="field-problem" role="status">${said}</p>
    </fieldset>`;
}

const Ranges = ({ facts, space, problems, change }) => html`
  <div class="fields narrow">${facts.ranges.map(([label, key, end]) => {
    const name = `action_space.${key}.${end}`;
    const set = (text) => change({ ...space, [key]: { ...space[key], [end]: read(text) } });
    return html`<${Field} key=${name} label=${label} place=${name} numeric=${true} value=${String(space[key]?.[end] ?? "")} set=${set}
      problems=${problems.filter((each) => each.key === name)} />`;
  })}</div>
  <p class="help">Steering from -30 (right) to 30 (left) degrees, speed from 0.1 to 4 m/s.</p>`;

function ActionTable({ space, problems, change, chosen, choose, focus }) {
  const wrong = new Set(problems.filter(({ severity }) => severity === "error").map((e) => e.key));
  const edit = (key, label) => (k) => {
    const name = `action_space[${k}].${key}`;
    const bad = wrong.has(name) || wrong.has(`action_space[${k}]`);
    const set = (text) => change(space.with(k, { ...space[k], [key]: read(text) }));
    return html`<input type="text" inputmode="decimal" autocomplete="off" aria-label=${`${label} of action ${k}`} data-key=${name}
      aria-invalid=${bad ? "true" : null} value=${String(space[k][key] ?? "")} onFocus=${() => choose(k)}
      onInput=${(event) => set(event.currentTarget.value)} />`;
  };
  const drop = (k) => {
    choose(-1);
    change(space.toSpliced(k, 1));
    focus(Math.min(k, space.length - 2));
  };
  const remove = (k) => html`
    <button type="button" class="plain" aria-label=${`Remove action ${k}`} disabled=${space.length < 2} onClick=${() => drop(k)}>×</button>`;
  const add = () => {
    choose(space.length);
    change([...space, { steering_angle: 0, speed: 1 }]);
    focus(space.length);
  };
  const columns = [
    ["No.", (k) => String(k)],
    ["Steering, degrees", edit("steering_angle", "Steering")],
    ["Speed, m/s", edit("speed", "Speed")],
    ["Remove", remove],
  ];
  return html`
    <${Columns} label="Actions" caption="Actions, as the network numbers them" columns=${columns} rows=${[...space.keys()]}
      kindOf=${(k) => k === chosen && "chosen"} />
    <div class="actions"><button type="button" onClick=${add}>Add an action</button></div>`;
}
