// Settings and files of a model, and what differs from its parent or from any other model.

import { SelectField } from "/fields.js";
import { BothCurves } from "/model_curves.js";
import { setQuery, useGet } from "/store.js";
import { Empty, Failure, Table, html } from "/ui.js";

const RESULTS = {
  world: "track",
  elapsed_s: "training time, s",
  hours: "machine hours",
  usd: "cost, USD",
  best_lap_s: "best clean lap, s",
  best_training_lap_s: "best training lap, s",
  best_progress: "best progress, %",
  mean_progress: "mean progress, %",
};
const GROUPS = {
  hyperparameters: "Hyperparameters",
  settings: "Settings",
  worker_settings: "Settings of other workers",
  model: "Model",
  start: "Start",
};

const isMissing = (value) => (value ?? "") === "";
const textOf = (value) =>
  isMissing(value)
    ? "(not set)"
    : typeof value === "object"
      ? JSON.stringify(value)
      : String(value);
const figure = (value) =>
  isMissing(value)
    ? "–"
    : textOf(
        typeof value === "number" && !Number.isInteger(value) ? Number(value.toFixed(3)) : value,
      );
const rowsOf = (object) => Object.entries(object).map(([name, value]) => [name, textOf(value)]);

/** @param {{prefix: string, path: (name: string) => string, version: any, names: string[], other: string | null}} props other: the model to compare with; null for its parent */
export function Files({ prefix, path, version, names, other }) {
  const { value, error } = useGet(path("files"), version);
  const parent = value?.parent ?? "";
  const compared = other ?? parent;
  const difference = useGet(
    value && compared && compared !== "none"
      ? `${path("difference")}&other=${encodeURIComponent(compared)}`
      : null,
    version,
  );
  if (error) return html`<${Failure} error=${error} />`;
  if (!value) return null;
  const all = [...new Set([...(parent ? [parent] : []), ...names])].filter(
    (name) => name !== prefix,
  );
  const options = [
    ["none", "no other model"],
    ...all.map((name) => [name, name === parent ? `${name} (its parent)` : name]),
  ];
  return html`
    ${all.length > 0 && html`<${SelectField} label="Compare with" options=${options} value=${compared || "none"} onChange=${(name) => setQuery({ other: name })} />`}
    <div role="status">
      ${difference.error && html`<${Failure} error=${difference.error} />`}
      ${difference.value && html`<${Differences} found=${difference.value} other=${compared} prefix=${prefix} />`}
    </div>
    <${OwnFiles} ...${value} />`;
}

function OwnFiles({ files, settings, given, versions, machine }) {
  const own = new Set(given);
  const all = Object.entries(settings);
  const rows = (wanted) =>
    rowsOf(Object.fromEntries(all.filter(([name]) => own.has(name) === wanted)));
  const names = Object.keys(files);
  return html`
    <h2>Files</h2>
    ${names.map(
      (name) => html`<details key=${name} open=${name === "reward_function.py"}>
      <summary>${name}</summary>
      <pre class="file-text" tabindex="0" role="region" aria-label=${name}>${files[name]}</pre>
      <p><button type="button" class="fine" onClick=${() => keep(name, files[name])}>Download ${name}</button></p>
    </details>`,
    )}
    ${!names.length && html`<${Empty} text="The model has no files of its own." />`}
    <h2>Settings of the training</h2>
    ${
      all.length
        ? html`
      <${Table} caption="Settings that were set" heads=${["Setting", "Value"]} rows=${rows(true)} />
      <details><summary>${all.length - own.size} settings at their default</summary>
        <${Table} caption="Defaults" heads=${["Setting", "Value"]} rows=${rows(false)} />
      </details>`
        : html`<${Empty} text="The settings of this training were not recorded (version 0.1.0 and other programs do not record them)." />`
    }
    ${
      Object.keys(machine).length > 0 &&
      html`<details><summary>Machine and versions</summary>
      <${Table} caption="Machine and versions" heads=${["What", "Value"]} rows=${rowsOf({ ...machine, ...versions })} />
    </details>`
    }`;
}

/** Let the browser keep a text. */
function keep(name, content) {
  const url = URL.createObjectURL(new Blob([content], { type: "text/plain" }));
  Object.assign(document.createElement("a"), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}

/** Lines of a difference, added and removed ones in colour. */
export const Diff = ({ lines }) =>
  html`<pre class="file-text file-diff" tabindex="0">${lines.map(
    (line) =>
      html`<span class=${line.startsWith("+") ? "diff-added" : line.startsWith("-") ? "diff-removed" : null}>${line}${"\n"}</span>`,
  )}</pre>`;

function Differences({ found, other, prefix }) {
  const rows = (list) => list.map((each) => [each.name, textOf(each.before), textOf(each.after)]);
  const shown = Object.entries(GROUPS).filter(([key]) => found[key].length);
  const machine = [...found.versions, ...found.machine];
  return html`
    <section aria-label=${`Differences from ${other}`}>
      <h2>Differences from ${other}</h2>
      ${!shown.length && !found.files.length && html`<p>Settings, hyperparameters and files are the same.</p>`}
      ${shown.map(([key, name]) => html`<${Table} key=${key} caption=${name} heads=${[name, other, prefix]} rows=${rows(found[key])} />`)}
      ${found.files.map(
        (file) => html`<details open key=${file.name}><summary>${file.name} differs</summary>
        ${file.diff.length ? html`<${Diff} lines=${file.diff} />` : html`<p class="quiet">Its text was not kept.</p>`}
      </details>`,
      )}
      <${BothCurves} prefix=${prefix} other=${other} sameReward=${!found.files.some((file) => file.name === "reward_function.py")} />
      <${Table} caption="Results" heads=${["Result", other, prefix]}
        rows=${found.results.map((each) => [RESULTS[each.name] ?? each.name.replaceAll("_", " "), figure(each.before), figure(each.after)])} />
      ${
        machine.length > 0 &&
        html`<details><summary>Versions and machine differ</summary>
        <${Table} caption="Versions and machine" heads=${["What", other, prefix]} rows=${rows(machine)} />
      </details>`
      }
    </section>`;
}
