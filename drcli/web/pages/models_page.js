// All models of the bucket: what they are, which came from which, and what drives now.

import { post } from "/api.js";
import { ask } from "/ask.js";
import { notify } from "/notices.js";
import { taskEnd } from "/model_tasks.js";
import { setQuery, useAction, useGet, useTopic } from "/store.js";
import { bytes, lapTime, moment, number } from "/text.js";
import { Empty, Failure, html, useRef, useState } from "/ui.js";

export const title = "Models";

export const modelLink = (prefix, tab = "", more = {}) =>
  `#/model?${new URLSearchParams({ prefix, ...(tab && { tab }), ...more })}`;
/** Number of a checkpoint, and how it drives. */
export const checkpointText = (entry) => entry?.text ?? "–";

const byName = (a, b) => a.model.prefix.localeCompare(b.model.prefix, "en", { numeric: true });
const lapOf = (each) => each.training?.best_lap_s ?? Infinity;
const worldOf = (each) => each.training?.world ?? "";
// Head, key of the order, comparison: the first click shows what is sought most often first.
/** @type {[string, string, ((a: any, b: any) => number) | null][]} */
const COLUMNS = [
  ["Model", "name", byName],
  ["Track", "track", (a, b) => worldOf(a).localeCompare(worldOf(b), "en") || lapOf(a) - lapOf(b)],
  ["Best clean lap", "lap", (a, b) => lapOf(a) - lapOf(b)],
  ["Clean laps", "laps", (a, b) => (b.laps ?? -1) - (a.laps ?? -1)],
  [
    "Best checkpoint",
    "score",
    (a, b) => (b.model.best?.metric ?? -Infinity) - (a.model.best?.metric ?? -Infinity),
  ],
  ["Last checkpoint", "", null],
  ["Size", "size", (a, b) => b.model.size_bytes - a.model.size_bytes],
  ["Changed", "changed", (a, b) => Date.parse(b.model.modified) - Date.parse(a.model.modified)],
];

export function Page({ query }) {
  const { value: data, error } = useTopic("models");
  const [search, turned, family, races] = ["search", "turned", "family", "races"].map(
    (name) => query.get(name) ?? "",
  );
  const sort = query.get("sort") ?? "changed";
  const set = setQuery;
  const [ticked, setTicked] = useState([]);
  const tree = useGet(family ? "/api/models/family" : null);
  const words = search.toLocaleLowerCase("en").split(/\s+/).filter(Boolean);
  const text = ({ model, training }) =>
    `${model.prefix} ${training?.world ?? ""} ${model.note}`.toLocaleLowerCase("en");
  const isCopy = ({ model }) => model.prefix.startsWith("races/");
  const compare = COLUMNS.find(([, key]) => key === sort)?.[2] ?? COLUMNS.at(-1)[2];
  const models = data?.models ?? [];
  const found = models
    .filter((each) => (races || !isCopy(each)) && words.every((word) => text(each).includes(word)))
    .sort((a, b) => (turned ? -1 : 1) * compare(a, b) || byName(a, b));
  const copies = models.filter(isCopy).length;
  const order = (key) =>
    set(key === sort ? { turned: turned ? "" : "1" } : { sort: key, turned: "" });
  const tick = (prefix) =>
    setTicked(
      ticked.includes(prefix)
        ? ticked.filter((each) => each !== prefix)
        : [...ticked, prefix].slice(-2),
    );
  const check = (
    name,
    value,
    label,
  ) => html`<label class="form-check"><input type="checkbox" checked=${Boolean(value)}
    onChange=${(event) => set({ [name]: event.currentTarget.checked ? "1" : "" })} /> ${label}</label>`;
  const list = () => {
    if (!models.length)
      return html`<${Empty} text=${`There is no model in s3://${data.bucket} yet.`}>
      <a class="button main" href="#/new">Start a training</a> or drop the archive of a model on “Import a model”.<//>`;
    if (!found.length)
      return html`<${Empty} text="No model fits the search."><button type="button" onClick=${() => set({ search: "" })}>Show all</button><//>`;
    if (!family)
      return html`<${ModelTable} found=${found} data=${data} order=${order} sort=${sort} turned=${turned} ticked=${ticked} tick=${tick} />`;
    return tree.error
      ? html`<${Failure} error=${tree.error} />`
      : tree.value && html`<${FamilyTree} tree=${tree.value} found=${found} data=${data} />`;
  };
  const gone = data?.gone
    ? ` Records of ${number(data.gone)} trainings whose models were deleted are kept, too.`
    : "";
  return html`
    <h1>Models</h1>
    <div class="model-tools">
      <div class="form-field"><label for="model-search">Search</label>
        <input type="search" id="model-search" placeholder="Name, track or note" autocomplete="off" value=${search} onInput=${(event) => set({ search: event.currentTarget.value })} />
      </div>
      ${check("family", family, "Family tree")}
      ${copies > 0 && check("races", races, `Copies in races (${copies})`)}
      <${Importer} />
      ${ticked.length === 2 && html`<a class="button" href=${modelLink(ticked[1], "files", { other: ticked[0] })}>Compare ${ticked[0]} and ${ticked[1]}</a>`}
    </div>
    <p class="quiet" role="status">${error ? "" : data ? `${number(found.length)} of ${number(models.length)} models in s3://${data.bucket}.${gone}` : "Reading the bucket …"}</p>
    <div class="model-list">${error ? html`<${Failure} error=${error} />` : data && list()}</div>`;
}

/** What a model does now and how its training ended, as labels. */
export function Badges({ prefix, data, model, training }) {
  const { trainings = [], evaluations = [], current } = data;
  const badge = (kind, text, about = null) =>
    html`<span class=${`model-badge ${kind}`} title=${about}>${text}</span> `;
  const trains = model?.training || trainings.some((each) => each.prefix === prefix);
  const failed = !trains && (training?.state === "failed" || training?.state === "lost");
  return html`
    ${trains && badge("good", "training now")}
    ${failed && badge("bad", training.state === "failed" ? "training failed" : "training broke off", training.message)}
    ${evaluations.some((each) => each.prefix === prefix) && badge("good", "evaluated now")}
    ${current === prefix && badge("", "in run.env", "DR_LOCAL_S3_MODEL_PREFIX in run.env")}
    ${model?.kind === "tensorflow" && badge("", "TensorFlow", "Trained with DeepRacer-for-Cloud or a console")}
    ${model?.damaged?.length > 0 && badge("bad", "damaged", model.damaged.join(" "))}`;
}

function ModelTable({ found, data, order, sort, turned, ticked, tick }) {
  const sorted = (key) => (key !== sort ? null : turned ? "descending" : "ascending");
  const cell = (k, content, kind = null) =>
    html`<td class=${kind} data-label=${COLUMNS[k][0]}>${content}</td>`;
  return html`
    <div class="scroll" tabindex="0" role="region" aria-label="Models">
      <table class="model-cards">
        <caption class="unseen">Models of the bucket</caption>
        <thead><tr>${COLUMNS.map(
          ([name, key]) => html`<th scope="col" key=${name} aria-sort=${sorted(key)}>
          ${key ? html`<button type="button" class="sorter" onClick=${() => order(key)}>${name}${sorted(key) && (turned ? " ▲" : " ▼")}</button>` : name}
        </th>`,
        )}</tr></thead>
        <tbody>${found.map(
          ({ model, training, laps }) => html`<tr key=${model.prefix}>
          <th scope="row">
            <input type="checkbox" aria-label=${`Compare ${model.prefix}`} checked=${ticked.includes(model.prefix)} onChange=${() => tick(model.prefix)} />
            ${" "}<a href=${modelLink(model.prefix)}>${model.prefix}</a> <${Badges} prefix=${model.prefix} data=${data} model=${model} training=${training} />
            ${training?.parent && html`<p class="fine quiet">from ${training.parent} (checkpoint ${training.parent_checkpoint.split("_")[0]})</p>`}
            ${model.note && html`<p class="fine quiet two-lines">${model.note}</p>`}
          </th>
          ${cell(1, training?.world || "–")}
          ${cell(2, lapTime(training?.best_lap_s), "short")}
          ${cell(3, number(laps), "short")}
          ${cell(4, checkpointText(model.best))}
          ${cell(5, checkpointText(model.last))}
          ${cell(6, bytes(model.size_bytes), "short")}
          ${cell(7, moment(Date.parse(model.modified) / 1000))}
        </tr>`,
        )}</tbody>
      </table>
    </div>
    <p class="quiet fine">After a checkpoint is how it drove in its evaluation. A clean lap is completed without a violation; those of training episodes and of their evaluations are counted. The best one is that of an evaluation on the track of the model.</p>`;
}

function FamilyTree({ tree, found, data }) {
  const shown = new Map(found.map((each) => [each.model.prefix, each]));
  const known = new Set(
    tree.members.filter((member) => member.exists).map((member) => member.model),
  );
  const others = found
    .filter(({ model }) => !known.has(model.prefix))
    .map(({ model }) => ({
      model: model.prefix,
      exists: true,
      depth: 0,
      weights: "",
      changes: [],
    }));
  const about = (training) => [
    training.world,
    (training.best_lap_s ?? null) !== null && `best clean lap ${lapTime(training.best_lap_s)}`,
    `${number(training.iterations)} iterations`,
  ];
  return html`<ul class="family-tree" aria-label="Which model began with the weights of which">${[
    ...tree.members,
    ...others,
  ].map((member) => {
    const entry = member.exists && shown.get(member.model);
    const changed = member.changes.length
      ? `; changed: ${member.changes.join("; ")}`
      : "; nothing else was changed";
    return html`<li class="family-member" key=${member.model} style=${{ "--depth": Math.min(member.depth, 12) }}>
      <div>
        ${member.exists ? html`<a href=${modelLink(member.model)}>${member.model}</a>` : html`<span class="quiet">${member.model} (deleted)</span>`}
        ${" "}${entry && html`<${Badges} prefix=${member.model} data=${data} ...${entry} />`}
        ${member.training && html`<span class="quiet"> ${about(member.training).filter(Boolean).join(", ")}</span>`}
      </div>
      ${member.weights && html`<p class="fine quiet">began with checkpoint ${member.weights.split("_")[0]}${changed}</p>`}
    </li>`;
  })}</ul>`;
}

/** The name of a model from that of its file. */
function nameOf(files) {
  const first = files.find((file) => !/\.(json|py|ya?ml)$/i.test(file.name)) ?? files[0];
  const plain = first.name.replace(/\.(tar\.gz|tgz|tar|pb|onnx|index|meta)$/i, "");
  return plain.replace(/[^A-Za-z0-9._/-]+/g, "-").replace(/^[-.]+/, "") || "imported";
}

/** A button and a place to drop files that become a model. */
function Importer() {
  const chooser = useRef(null);
  const [over, setOver] = useState(false);
  const [take, busy] = useAction(async (given) => {
    const files = [...given];
    if (!files.length) return;
    const listed = files.map((file) => `${file.name} (${bytes(file.size)})`).join(", ");
    const values = await ask({
      title: "Import a model",
      action: "Import",
      intro: html`<p>${listed}. It can be an archive of a console, of DeepRacer on AWS or of the car (.tar.gz), a frozen graph (.pb) with its model_metadata.json, or an .onnx file that a model was downloaded as.</p>`,
      fields: [
        {
          name: "prefix",
          label: "Name of the new model",
          value: nameOf(files),
          help: "Letters, digits and . _ - and / between folders.",
          more: { required: true, pattern: "[A-Za-z0-9._\\/\\-]+" },
        },
      ],
    });
    if (!values) return;
    let upload = "";
    for (const file of files) {
      notify(`Sending ${file.name} …`);
      const name = encodeURIComponent(file.name.replace(/[^A-Za-z0-9._-]+/g, "-"));
      ({ upload } = await post(`/api/uploads?name=${name}&upload=${upload}`, file));
    }
    const { task } = await post("/api/models/import", { upload, prefix: values.prefix });
    const report = await taskEnd(task);
    for (const sentence of report.warnings) notify(sentence, "warn");
    location.hash = modelLink(values.prefix);
  });
  const drag = (event) => {
    event.preventDefault();
    setOver(event.type === "dragover");
    if (event.type === "drop") take(event.dataTransfer.files);
  };
  const chosen = (event) => {
    take([...event.currentTarget.files]);
    event.currentTarget.value = "";
  };
  return html`<div class="form-field">
    <button type="button" class=${`file-drop${over ? " over" : ""}`} disabled=${busy} onClick=${() => chooser.current.click()} onDragOver=${drag} onDragLeave=${drag} onDrop=${drag}>
      Import a model<span class="fine quiet"> or drop its files here</span>
    </button>
    <input type="file" multiple class="unseen" aria-label="Files of a model" tabindex="-1" ref=${chooser} onChange=${chosen} />
  </div>`;
}
