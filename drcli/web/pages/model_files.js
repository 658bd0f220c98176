// Settings and files of a model, and what differs from its parent or from any other model.

import { SelectField } from "/fields.js";
import { BothCurves } from "/model_curves.js";
import { setQuery, useGet } from "/store.js";
import { Empty, Failure, Table, html } from "/ui.js";

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

function OwnFiles({ files, given, defaults, machine }) {
  const names = Object.keys(files);
  const table = (caption, rows) =>
    html`<${Table} caption=${caption} heads=${["Name", "Value"]} rows=${rows} />`;
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
      given.length + defaults.length
        ? html`
      ${table("Settings that were set", given)}
      <details><summary>${defaults.length} settings at their default</summary>${table("Defaults", defaults)}</details>`
        : html`<${Empty} text="The settings of this training were not recorded (version 0.1.0 and other programs do not record them)." />`
    }
    ${machine.length > 0 && html`<details><summary>Machine and versions</summary>${table("Machine and versions", machine)}</details>`}`;
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
  const { Versions: versions, Machine: hardware, ...sections } = found.sections;
  const shown = Object.entries(sections).filter(([, rows]) => rows.length);
  const machine = [...versions, ...hardware];
  const table = (caption, rows) =>
    html`<${Table} key=${caption} caption=${caption} heads=${[caption, other, prefix]} rows=${rows} />`;
  return html`
    <section aria-label=${`Differences from ${other}`}>
      <h2>Differences from ${other}</h2>
      ${!shown.length && !found.files.length && html`<p>Settings, hyperparameters and files are the same.</p>`}
      ${shown.map(([caption, rows]) => table(caption, rows))}
      ${found.files.map(
        (file) => html`<details open key=${file.name}><summary>${file.name} differs</summary>
        ${file.diff.length ? html`<${Diff} lines=${file.diff} />` : html`<p class="quiet">Its text was not kept.</p>`}
      </details>`,
      )}
      <${BothCurves} prefix=${prefix} other=${other} sameReward=${!found.files.some((file) => file.name === "reward_function.py")} />
      ${table("Results", found.results)}
      ${machine.length > 0 && html`<details><summary>Versions and machine differ</summary>${table("Versions and machine", machine)}</details>`}
    </section>`;
}
