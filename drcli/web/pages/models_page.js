// All models of the bucket: what they are, which came from which, and what drives now.

import { post } from "/api.js";
import { ask } from "/ask.js";
import { Field } from "/fields.js";
import { notify } from "/notices.js";
import { runTask } from "/model_tasks.js";
import { setQuery, useAction, useGet, useTopic } from "/store.js";
import { bytes, lapTime, moment, number } from "/text.js";
import { Columns, Empty, Failure, Loaded, Tick, html, useState } from "/ui.js";

export const title = "Models";

export const modelLink = (prefix, tab = "", more = {}) =>
  `#/model?${new URLSearchParams({ prefix, ...(tab && { tab }), ...more })}`;
/** Number of a checkpoint, and how it drives. */
const checkpointText = (entry) => entry?.text ?? "–";

const byName = (a, b) => a.model.prefix.localeCompare(b.model.prefix, "en", { numeric: true });
const lapOf = ({ training }) => training?.best_lap_s ?? Infinity;
const worldOf = ({ training }) => training?.world ?? "";
const scoreOf = ({ model }) => -(model.best?.metric ?? -Infinity);
const sizeOf = ({ model }) => model.size_bytes;
const changedOf = ({ model }) => Date.parse(model.modified);
/**
 * Name, name of its order, value of the order (small ones first), cell, class.
 * @type {[string, string, ((each: any) => number | string) | null, (each: any) => any, string?][]}
 */
const COLUMNS = [
  ["Model", "name", null, () => null],
  ["Track", "track", worldOf, (each) => worldOf(each) || null],
  ["Best clean lap", "lap", lapOf, ({ training }) => lapTime(training?.best_lap_s), "short"],
  ["Clean laps", "laps", ({ laps }) => -(laps ?? -1), ({ laps }) => number(laps), "short"],
  ["Best checkpoint", "score", scoreOf, ({ model }) => checkpointText(model.best)],
  ["Last checkpoint", "", null, ({ model }) => checkpointText(model.last)],
  ["Size", "size", (each) => -sizeOf(each), (each) => bytes(sizeOf(each)), "short"],
  ["Changed", "changed", (each) => -changedOf(each), (each) => moment(changedOf(each) / 1000)],
];

/** By a column, then by the best lap, then by name. */
const byColumn = (key) => (a, b) => {
  const [, , value] = COLUMNS.find((column) => column[1] === key) ?? COLUMNS.at(-1);
  if (!value) return byName(a, b);
  const [one, other] = [value(a), value(b)];
  const order =
    typeof one === "string" ? one.localeCompare(String(other), "en") : one - Number(other);
  return order || lapOf(a) - lapOf(b) || byName(a, b);
};

const isCopy = ({ model }) => model.prefix.startsWith("races/");

export function Page({ query }) {
  const { value: data, error } = useTopic("models");
  const [search, turned, family, races, sort] = ["search", "turned", "family", "races", "sort"].map(
    (name) => query.get(name) ?? "",
  );
  const [ticked, setTicked] = useState([]);
  const words = search.toLocaleLowerCase("en").split(/\s+/).filter(Boolean);
  const text = (each) =>
    `${each.model.prefix} ${worldOf(each)} ${each.model.note}`.toLocaleLowerCase("en");
  const models = data?.models ?? [];
  const order = byColumn(sort || "changed");
  const found = models
    .filter((each) => (races || !isCopy(each)) && words.every((word) => text(each).includes(word)))
    .sort((a, b) => (turned ? -order(a, b) : order(a, b)));
  const copies = models.filter(isCopy).length;
  const check = (name, value, label) => html`
    <${Tick} label=${label} on=${Boolean(value)} set=${(on) => setQuery({ [name]: on ? "1" : "" })} />`;
  const list = () => {
    if (!models.length)
      return html`<${Empty} text=${`There is no model in s3://${data.bucket} yet.`}>
      <a class="button main" href="#/new">Start a training</a> or drop the archive of a model on “Import a model”.<//>`;
    if (!found.length)
      return html`<${Empty} text="No model fits the search."><button type="button" onClick=${() => setQuery({ search: "" })}>Show all</button><//>`;
    if (family) return html`<${FamilyTree} found=${found} />`;
    return html`<${ModelTable} found=${found} sort=${sort || "changed"} turned=${turned} ticked=${ticked} setTicked=${setTicked} />`;
  };
  const gone = data?.gone
    ? ` Records of ${number(data.gone)} trainings whose models were deleted are kept, too.`
    : "";
  return html`
    <h1>Models</h1>
    <div class="model-tools">
      <${Field} label="Search" type="search" placeholder="Name, track or note" value=${search} set=${(given) => setQuery({ search: given })} />
      ${check("family", family, "Family tree")}
      ${copies > 0 && check("races", races, `Copies in races (${copies})`)}
      <${Importer} />
      ${ticked.length === 2 && html`<a class="button" href=${modelLink(ticked[1], "files", { other: ticked[0] })}>Compare ${ticked[0]} and ${ticked[1]}</a>`}
    </div>
    <p class="quiet" role="status">${error ? "" : data ? `${number(found.length)} of ${number(models.length)} models in s3://${data.bucket}.${gone}` : "Reading the bucket …"}</p>
    <div class="model-list">${error ? html`<${Failure} error=${error} />` : data && list()}</div>`;
}

/** What a model does now and how its training ended, as labels. @param {{badges: [string, string, string][]}} props */
export const Badges = ({ badges = [] }) =>
  badges.map(
    ([kind, text, about]) =>
      html`<span key=${text} class=${`model-badge ${kind}`} title=${about}>${text}</span> `,
  );

function ModelTable({ found, sort, turned, ticked, setTicked }) {
  const tick = (prefix, on) => {
    const others = ticked.filter((each) => each !== prefix);
    setTicked(on ? [...others, prefix].slice(-2) : others);
  };
  const named = ({ model: { prefix, note }, training, badges }) => html`
    <input type="checkbox" aria-label=${`Compare ${prefix}`} checked=${ticked.includes(prefix)} onChange=${(event) => tick(prefix, event.currentTarget.checked)} />
    ${" "}<a href=${modelLink(prefix)}>${prefix}</a> <${Badges} badges=${badges} />
    ${training?.parent && html`<p class="fine quiet">from ${training.parent} (checkpoint ${training.parent_checkpoint.split("_")[0]})</p>`}
    ${note && html`<p class="fine quiet two-lines">${note}</p>`}`;
  const order = (key) =>
    setQuery(key === sort ? { turned: turned ? "" : "1" } : { sort: key, turned: "" });
  const columns = COLUMNS.map(([name, key, , cell, kind]) => {
    const mark = key === sort && (turned ? " ▲" : " ▼");
    const head = html`<button type="button" class="sorter" onClick=${() => order(key)}>${name}${mark}</button>`;
    return [name, key === "name" ? named : cell, kind, key ? head : name];
  });
  const chosen = COLUMNS.find(([, key]) => key === sort)?.[0] ?? "";
  return html`
    <${Columns} kind="model-cards" label="Models" columns=${columns} rows=${found} header=${0} keyOf=${({ model }) => model.prefix}
      sorted=${{ [chosen]: turned ? "descending" : "ascending" }} />
    <p class="quiet fine">After a checkpoint is how it drove in its evaluation. A clean lap is completed without a violation; those of training episodes and of their evaluations are counted. The best one is that of an evaluation on the track of the model.</p>`;
}

function FamilyTree({ found }) {
  const tree = useGet("/api/models/family");
  const shown = new Map(found.map((each) => [each.model.prefix, each]));
  const about = ({ world, best_lap_s: lap, iterations }) => [
    world,
    (lap ?? null) !== null && `best clean lap ${lapTime(lap)}`,
    `${number(iterations)} iterations`,
  ];
  const item = ({ model, exists, depth = 0, training, weights = "", changes = [] }) => html`
    <li class="family-member" key=${model} style=${{ "--depth": Math.min(depth, 12) }}>
      <div>
        ${exists ? html`<a href=${modelLink(model)}>${model}</a>` : html`<span class="quiet">${model} (deleted)</span>`}
        ${" "}${exists && html`<${Badges} ...${shown.get(model)} />`}
        ${training && html`<span class="quiet"> ${about(training).filter(Boolean).join(", ")}</span>`}
      </div>
      ${weights && html`<p class="fine quiet">began with checkpoint ${weights.split("_")[0]}; ${changes.length ? `changed: ${changes.join("; ")}` : "nothing else was changed"}</p>`}
    </li>`;
  return html`<${Loaded} found=${tree}>${({ members }) => {
    const known = new Set(members.filter(({ exists }) => exists).map(({ model }) => model));
    const others = [...shown.keys()].filter((prefix) => !known.has(prefix));
    return html`
      <ul class="family-tree" aria-label="Which model began with the weights of which">
        ${members.map(item)}${others.map((model) => item({ model, exists: true, training: null }))}
      </ul>`;
  }}<//>`;
}

/** The name of a model from that of its file. */
function nameOf(files) {
  const first = files.find((file) => !/\.(json|py|ya?ml)$/i.test(file.name)) ?? files[0];
  const plain = first.name.replace(/\.(tar\.gz|tgz|tar|pb|onnx|index|meta)$/i, "");
  return plain.replace(/[^A-Za-z0-9._/-]+/g, "-").replace(/^[-.]+/, "") || "imported";
}

/** Where files are chosen, or dropped, that become a model. */
function Importer() {
  const [take, busy] = useAction(async (files) => {
    const listed = files.map((file) => `${file.name} (${bytes(file.size)})`).join(", ");
    const name = {
      ...{ name: "prefix", label: "Name of the new model", value: nameOf(files) },
      help: "Letters, digits and . _ - and / between folders.",
      more: { required: true, pattern: "[A-Za-z0-9._\\/\\-]+" },
    };
    const values = await ask({
      title: "Import a model",
      action: "Import",
      about: listed,
      intro: `${listed}. It can be an archive of a console, of DeepRacer on AWS or of the car (.tar.gz), a frozen graph (.pb) with its model_metadata.json, or an .onnx file that a model was downloaded as.`,
      fields: [name],
    });
    if (!values) return;
    let upload = "";
    for (const file of files) {
      notify(`Sending ${file.name} …`);
      const query = new URLSearchParams({
        name: file.name.replace(/[^A-Za-z0-9._-]+/g, "-"),
        upload,
      });
      ({ upload } = await post(`/api/uploads?${query}`, file));
    }
    const report = await runTask("/api/models/import", { upload, prefix: values.prefix });
    for (const sentence of report.warnings) notify(sentence, "warn");
    location.hash = modelLink(values.prefix);
  });
  const chosen = (event) => {
    take([...event.currentTarget.files]);
    event.currentTarget.value = ""; // so that the same files can be chosen again
  };
  return html`
    <label class="field">Import a model<span class="fine quiet"> or drop its files here</span>
      <input type="file" multiple class="file-drop" disabled=${busy} onChange=${chosen} />
    </label>`;
}
