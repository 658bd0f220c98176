// All models of the bucket: what they are, which came from which, and what drives now.

import { api, get, post } from "/api.js";
import { bytes, empty, failure, fill, h, lapTime, moment, notify, number } from "/dom.js";
import { ask, field } from "/form_dialog.js";
import { taskEnd } from "/model_tasks.js";
import { follow } from "/socket.js";

export const title = "Models";

export const modelLink = (prefix, tab = "") =>
  `#/model?prefix=${encodeURIComponent(prefix)}${tab ? `&tab=${tab}` : ""}`;

const COLUMNS = [
  "Model",
  "Track",
  "Best clean lap",
  "Clean laps",
  "Best checkpoint",
  "Last checkpoint",
  "Size",
  "Changed",
];
const SORTS = {
  changed: ["Newest first", (a, b) => Date.parse(b.model.modified) - Date.parse(a.model.modified)],
  name: ["Name", (a, b) => a.model.prefix.localeCompare(b.model.prefix, "en", { numeric: true })],
  lap: [
    "Fastest lap on each track",
    (a, b) =>
      (a.training?.world ?? "").localeCompare(b.training?.world ?? "", "en") ||
      (a.training?.best_lap_s ?? Infinity) - (b.training?.best_lap_s ?? Infinity),
  ],
  score: [
    "Best score",
    (a, b) => (b.model.best?.metric ?? -Infinity) - (a.model.best?.metric ?? -Infinity),
  ],
  size: ["Size", (a, b) => b.model.size_bytes - a.model.size_bytes],
};
const kept = { search: "", sort: "changed", family: false };

export function show(main, params, { signal }) {
  const search = h("input", {
    type: "search",
    placeholder: "Name, track or note",
    autocomplete: "off",
    value: kept.search,
    input: () => {
      kept.search = search.value;
      draw();
    },
  });
  const sort = h(
    "select",
    {
      change: () => {
        kept.sort = sort.value;
        draw();
      },
    },
    Object.entries(SORTS).map(([key, [text]]) =>
      h("option", { value: key, selected: key === kept.sort }, text),
    ),
  );
  const family = h("input", {
    type: "checkbox",
    checked: kept.family,
    change: () => {
      kept.family = family.checked;
      sort.disabled = kept.family;
      draw();
    },
  });
  sort.disabled = kept.family;
  const count = h("p", { class: "quiet", role: "status" }, "Reading the bucket …");
  const list = h("div", { class: "model-list" });
  fill(
    main,
    h("h1", {}, "Models"),
    h(
      "div",
      { class: "model-tools" },
      field("Search", search),
      field("Sort", sort),
      h("label", { class: "form-check" }, family, " Family tree"),
      importer(signal),
    ),
    count,
    list,
  );

  let data = null,
    tree = null,
    drawn = "";
  follow(
    "models",
    (value) => {
      if (value.error) {
        fill(list, failure(value.error));
        count.textContent = "";
        drawn = "";
        return;
      }
      data = value;
      draw();
    },
    signal,
  );

  function rows() {
    const words = kept.search.toLocaleLowerCase("en").split(/\s+/).filter(Boolean);
    const fits = ({ model, training }) =>
      words.every((word) =>
        `${model.prefix} ${training?.world ?? ""} ${model.note}`
          .toLocaleLowerCase("en")
          .includes(word),
      );
    return data.models.filter(fits).sort(SORTS[kept.sort][1]);
  }

  async function draw() {
    if (!data) return;
    if (!data.models.length) {
      fill(
        list,
        empty(
          `There is no model in s3://${data.bucket} yet.`,
          h("a", { class: "button main", href: "#/new" }, "Start a training"),
          "or drop the archive of a model on “Import a model”.",
        ),
      );
      count.textContent = "";
      return;
    }
    if (kept.family) {
      try {
        tree = await get(api("models", "family"), signal);
      } catch (error) {
        if (error.name !== "AbortError") fill(list, failure(error));
        return;
      }
      if (!kept.family) return;
    }
    const found = rows();
    const state = JSON.stringify([
      found,
      data.trainings,
      data.evaluations,
      data.current,
      kept.family ? tree : null,
    ]);
    count.textContent =
      `${number(found.length)} of ${number(data.models.length)} models in s3://${data.bucket}` +
      (data.gone
        ? `. Records of ${number(data.gone)} trainings whose models were deleted are kept, too.`
        : ".");
    if (state === drawn) return;
    drawn = state;
    const focused = document.activeElement?.dataset?.key;
    fill(
      list,
      found.length
        ? kept.family
          ? familyTree(tree, found, data)
          : modelTable(found, data)
        : empty(
            "No model fits the search.",
            h(
              "button",
              {
                type: "button",
                click: () => {
                  search.value = kept.search = "";
                  draw();
                  search.focus();
                },
              },
              "Show all",
            ),
          ),
    );
    if (focused)
      list.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
  }
}

/** What a model does now, as labels. */
export function badges(prefix, { trainings = [], evaluations = [], current }, training = false) {
  return [
    training || trainings.some((each) => each.prefix === prefix)
      ? h("span", { class: "model-badge good" }, "training now")
      : null,
    evaluations.some((each) => each.prefix === prefix)
      ? h("span", { class: "model-badge good" }, "evaluated now")
      : null,
    current === prefix
      ? h(
          "span",
          { class: "model-badge", title: "DR_LOCAL_S3_MODEL_PREFIX in run.env" },
          "in run.env",
        )
      : null,
  ];
}

/** Number of a checkpoint, and how it drives. */
export const checkpointText = (entry) => entry?.text ?? "–";

function modelTable(found, data) {
  const cell = (k, content, kind = null) =>
    h("td", { class: kind, "data-label": COLUMNS[k] }, content);
  return [
    h(
      "div",
      { class: "scroll", tabindex: "0", role: "region", "aria-label": "Models" },
      h(
        "table",
        { class: "model-cards" },
        h("caption", { class: "unseen" }, "Models of the bucket"),
        h(
          "thead",
          {},
          h(
            "tr",
            {},
            COLUMNS.map((name) => h("th", { scope: "col" }, name)),
          ),
        ),
        h(
          "tbody",
          {},
          found.map(({ model, training, laps }) =>
            h(
              "tr",
              {},
              h(
                "th",
                { scope: "row" },
                h("a", { href: modelLink(model.prefix), "data-key": model.prefix }, model.prefix),
                " ",
                badges(model.prefix, data, model.training),
                model.kind === "tensorflow"
                  ? h(
                      "span",
                      {
                        class: "model-badge",
                        title: "Trained with DeepRacer-for-Cloud or a console",
                      },
                      "TensorFlow",
                    )
                  : null,
                model.damaged.length
                  ? h(
                      "span",
                      { class: "model-badge bad", title: model.damaged.join(" ") },
                      "damaged",
                    )
                  : null,
                training?.parent
                  ? h(
                      "p",
                      { class: "fine quiet" },
                      "from ",
                      training.parent,
                      ` (checkpoint ${training.parent_checkpoint.split("_")[0]})`,
                    )
                  : null,
                model.note ? h("p", { class: "fine quiet two-lines" }, model.note) : null,
              ),
              cell(1, training?.world || "–"),
              cell(2, lapTime(training?.best_lap_s), "short"),
              cell(3, number(laps), "short"),
              cell(4, checkpointText(model.best)),
              cell(5, checkpointText(model.last)),
              cell(6, bytes(model.size_bytes), "short"),
              cell(7, moment(Date.parse(model.modified) / 1000)),
            ),
          ),
        ),
      ),
    ),
    h(
      "p",
      { class: "quiet fine" },
      "After a checkpoint is how it drove in its evaluation. A clean lap is completed without a violation; those of training episodes and of their evaluations are counted. The best one is that of an evaluation on the track of the model.",
    ),
  ];
}

function familyTree(tree, found, data) {
  const shown = new Map(found.map((each) => [each.model.prefix, each]));
  const without = found.filter(
    (each) => !tree.members.some((member) => member.model === each.model.prefix && member.exists),
  );
  const item = (member) => {
    const entry = member.exists ? shown.get(member.model) : null;
    const name = member.exists
      ? h("a", { href: modelLink(member.model), "data-key": member.model }, member.model)
      : h("span", { class: "quiet" }, `${member.model} (deleted)`);
    const line = h(
      "li",
      { class: "family-member" },
      h(
        "div",
        {},
        name,
        " ",
        entry ? badges(member.model, data, entry.model.training) : null,
        member.training
          ? h(
              "span",
              { class: "quiet" },
              ` ${[member.training.world, member.training.best_lap_s != null ? `best clean lap ${lapTime(member.training.best_lap_s)}` : "", `${number(member.training.iterations)} iterations`].filter(Boolean).join(", ")}`,
            )
          : null,
      ),
      member.weights
        ? h(
            "p",
            { class: "fine quiet" },
            `began with checkpoint ${member.weights.split("_")[0]}`,
            member.changes.length
              ? `; changed: ${member.changes.join("; ")}`
              : "; nothing else was changed",
          )
        : null,
    );
    line.style.setProperty("--depth", Math.min(member.depth, 12));
    return line;
  };
  return h(
    "ul",
    { class: "family-tree", "aria-label": "Which model began with the weights of which" },
    tree.members.map(item),
    without.map((each) =>
      item({
        model: each.model.prefix,
        exists: true,
        depth: 0,
        training: null,
        weights: "",
        changes: [],
      }),
    ),
  );
}

/** A button and a place to drop files that become a model. */
function importer(signal) {
  const choose = h("input", {
    type: "file",
    multiple: true,
    class: "unseen",
    "aria-label": "Files of a model",
    tabindex: "-1",
    change: () => {
      take(choose.files);
      choose.value = "";
    },
  });
  const button = h(
    "button",
    { type: "button", class: "file-drop", click: () => choose.click() },
    "Import a model",
    h("span", { class: "fine quiet" }, " or drop its files here"),
  );
  const stop = (event) => {
    event.preventDefault();
    button.classList.toggle("over", event.type === "dragover");
  };
  button.addEventListener("dragover", stop);
  button.addEventListener("dragleave", stop);
  button.addEventListener("drop", (event) => {
    stop(event);
    take(event.dataTransfer.files);
  });

  async function take(files) {
    const list = [...files];
    if (!list.length) return;
    const first = list.find((file) => !/\.(json|py|ya?ml)$/i.test(file.name)) ?? list[0];
    const name =
      first.name
        .replace(/\.(tar\.gz|tgz|tar|pb|onnx|index|meta)$/i, "")
        .replace(/[^A-Za-z0-9._/-]+/g, "-")
        .replace(/^[-.]+/, "") || "imported";
    const values = await ask({
      title: "Import a model",
      action: "Import",
      intro: h(
        "p",
        {},
        `${list.map((file) => `${file.name} (${bytes(file.size)})`).join(", ")}. It can be an archive of a console, of DeepRacer on AWS or of the car (.tar.gz), a frozen graph (.pb) with its model_metadata.json, or an .onnx of dr-export.`,
      ),
      fields: [
        field(
          "Name of the new model",
          h("input", {
            name: "prefix",
            required: true,
            pattern: "[A-Za-z0-9._\\/\\-]+",
            value: name,
            autocomplete: "off",
          }),
          "Letters, digits and . _ - and / between folders.",
        ),
      ],
    });
    if (!values) return;
    button.disabled = true;
    try {
      let upload = "";
      for (const file of list) {
        notify(`Sending ${file.name} …`);
        upload = (
          await post(
            `/api/uploads?name=${encodeURIComponent(file.name.replace(/[^A-Za-z0-9._-]+/g, "-"))}&upload=${upload}`,
            file,
          )
        ).upload;
      }
      const { task } = await post("/api/models/import", { upload, prefix: values.prefix });
      const report = await taskEnd(task, signal);
      for (const sentence of report.warnings) notify(sentence, "warn");
      location.hash = modelLink(values.prefix);
    } catch (error) {
      if (error.name !== "AbortError" && !error.ofTask) notify(error.message, "bad", error.remedy);
    } finally {
      button.disabled = false;
    }
  }
  return h("div", { class: "form-field" }, button, choose);
}
