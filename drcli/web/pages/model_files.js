// Settings and files of a model, and what differs from its parent or from any other model.

import { Field } from "/fields.js";
import { saveBlob } from "/model_tasks.js";
import { Plot } from "/plot.js";
import { setQuery, useGet } from "/store.js";
import { number } from "/text.js";
import { Empty, Failure, Table, html, useMemo } from "/ui.js";

const COLORS = ["c1", "c2"];

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
  const all = [parent, ...names.filter((name) => name !== parent && name !== prefix)].filter(
    Boolean,
  );
  const options = [
    ["none", "no other model"],
    ...all.map((name) => [name, name === parent ? `${name} (its parent)` : name]),
  ];
  return html`
    ${all.length > 0 && html`<${Field} label="Compare with" options=${options} value=${compared || "none"} set=${(name) => setQuery({ other: name })} />`}
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
      <p><button type="button" class="fine" onClick=${() => saveBlob(new Blob([files[name]]), name)}>Download ${name}</button></p>
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

/**
 * The learning curves of two trainings over each other, with what chance alone would do.
 * @param {{prefix: string, other: string, sameReward: boolean}} props `sameReward`: whether their rewards can be compared
 */
function BothCurves({ prefix, other, sameReward }) {
  const path = (name) => `/api/model/curve?prefix=${encodeURIComponent(name)}`;
  const names = [other, prefix];
  const curves = [useGet(path(other)).value, useGet(path(prefix)).value];
  const found = useMemo(() => {
    if (!curves.every(Boolean)) return null;
    const both = curves.map((each) => new Map(each.iterations.map((row) => [row.iteration, row])));
    const x = [...new Set(both.flatMap((rows) => [...rows.keys()]))].sort((a, b) => a - b);
    const column = (rows, pick) => x.map((iteration) => pick(rows.get(iteration)) ?? null);
    const shares = (rows) => [0, 1, 2].map((k) => column(rows, (row) => row?.clean_share?.[k]));
    const rewards = both.map((rows) => column(rows, (row) => row?.mean_reward));
    return { both, x, clean: [x, ...both.flatMap(shares)], rewards: [x, ...rewards] };
  }, curves);
  if (!found) return null;
  const { both, x } = found;
  const shares = names.flatMap((name, k) => [
    { name, color: COLORS[k], unit: "%", digits: 0 },
    { name: `${name}, low`, group: name, color: COLORS[k], hidden: true },
    { name: `${name}, high`, group: name, color: COLORS[k], hidden: true },
  ]);
  const bands = COLORS.map((color, k) => [3 * k + 3, 3 * k + 2, color]);
  const at = (index) => {
    const iteration =
      x[index] ?? x.findLast((each) => both.some((rows) => rows.get(each)?.clean_share));
    if (iteration === undefined) return "None of them was evaluated.";
    const said = both.map((rows, k) => {
      const [share, low, high] = rows.get(iteration)?.clean_share ?? [];
      return share === undefined
        ? `${names[k]} was not evaluated`
        : `${names[k]} ${number(share, 0, "%")} (${number(low)} to ${number(high)})`;
    });
    return `Iteration ${number(iteration)}: ${said.join(", ")}`;
  };
  const rewards = names.map((name, k) => ({ name, color: COLORS[k], digits: 1 }));
  return html`
    <${Plot} title="Clean laps in evaluations" hint="The band is where the true share lies with 95 %: bands that overlap may differ by chance alone."
      series=${shares} data=${found.clean} limits=${{ y: [0, 105] }} axes=${{ left: "% of the laps" }} read=${at} bands=${bands} />
    ${
      sameReward
        ? html`<${Plot} title="Mean reward" series=${rewards} data=${found.rewards} axes=${{ left: "Reward" }} />`
        : html`<p class="quiet">Their reward functions differ, so their rewards cannot be compared.</p>`
    }`;
}
