// Settings and files of a model, and what differs from its parent or from any other model.

import { get } from "/api.js";
import { empty, failure, fill, h, table } from "/dom.js";
import { field, select } from "/form_dialog.js";

const text = (value) =>
  value === null || value === undefined || value === ""
    ? "(not set)"
    : typeof value === "object"
      ? JSON.stringify(value)
      : String(value);
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

export function filesPart(prefix, { signal, names }) {
  const files = h("div"),
    difference = h("div", { role: "status" }),
    place = h("div");
  const element = h("div", {}, place, difference, files);
  let other = null;

  async function update() {
    try {
      const found = await get(`/api/model/files?prefix=${encodeURIComponent(prefix)}`, signal);
      if (other === null) other = found.parent;
      drawChoice(found.parent);
      drawFiles(found);
      compare();
    } catch (error) {
      if (error.name !== "AbortError") fill(files, failure(error));
    }
  }

  function drawChoice(parent) {
    const all = [...new Set([...(parent ? [parent] : []), ...names()])].filter(
      (name) => name !== prefix,
    );
    const control = select(
      "other",
      [
        ["", "no other model"],
        ...all.map((name) => [name, name === parent ? `${name} (its parent)` : name]),
      ],
      other,
    );
    control.addEventListener("change", () => {
      other = control.value;
      compare();
    });
    fill(place, all.length ? field("Compare with", control) : null);
  }

  async function compare() {
    if (!other) {
      fill(difference);
      return;
    }
    try {
      const found = await get(
        `/api/model/difference?prefix=${encodeURIComponent(prefix)}&other=${encodeURIComponent(other)}`,
        signal,
      );
      fill(difference, differences(found, other, prefix));
    } catch (error) {
      if (error.name !== "AbortError") fill(difference, failure(error));
    }
  }

  function drawFiles({ files: texts, settings, given, versions, machine }) {
    const named = Object.entries(settings);
    const own = new Set(given);
    fill(
      files,
      h("h2", {}, "Files"),
      Object.keys(texts).length
        ? Object.entries(texts).map(([name, content]) =>
            h(
              "details",
              { open: name === "reward_function.py" },
              h("summary", {}, name),
              h(
                "pre",
                { class: "file-text", tabindex: "0", role: "region", "aria-label": name },
                content,
              ),
              h(
                "p",
                {},
                h(
                  "button",
                  { type: "button", class: "fine", click: () => keep(name, content) },
                  `Download ${name}`,
                ),
              ),
            ),
          )
        : empty("The model has no files of its own."),
      h("h2", {}, "Settings of the training"),
      named.length
        ? [
            table(
              "Settings that were set",
              ["Setting", "Value"],
              named.filter(([name]) => own.has(name)).map(([name, value]) => [name, text(value)]),
            ),
            h(
              "details",
              {},
              h("summary", {}, `${named.length - own.size} settings at their default`),
              table(
                "Defaults",
                ["Setting", "Value"],
                named
                  .filter(([name]) => !own.has(name))
                  .map(([name, value]) => [name, text(value)]),
              ),
            ),
          ]
        : empty(
            "The settings of this training were not recorded (version 0.1.0 and other programs do not record them).",
          ),
      Object.keys(machine).length
        ? h(
            "details",
            {},
            h("summary", {}, "Machine and versions"),
            table(
              "Machine and versions",
              ["What", "Value"],
              [...Object.entries(machine), ...Object.entries(versions)].map(([name, value]) => [
                name,
                text(value),
              ]),
            ),
          )
        : null,
    );
  }
  return { element, update };
}

function keep(name, content) {
  const url = URL.createObjectURL(new Blob([content], { type: "text/plain" }));
  const link = Object.assign(document.createElement("a"), { href: url, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}

function differences(found, other, prefix) {
  const groups = [
    ["Hyperparameters", found.hyperparameters],
    ["Settings", found.settings],
    ["Settings of other workers", found.worker_settings],
    ["Model", found.model],
    ["Start", found.start],
  ];
  const shown = groups.filter(([, rows]) => rows.length);
  const rows = (list) => list.map((each) => [each.name, text(each.before), text(each.after)]);
  return h(
    "section",
    { "aria-label": `Differences from ${other}` },
    h("h2", {}, `Differences from ${other}`),
    shown.length || found.files.length
      ? null
      : h("p", {}, "Settings, hyperparameters and files are the same."),
    shown.map(([name, list]) => table(name, [name, other, prefix], rows(list))),
    found.files.map((file) =>
      h(
        "details",
        { open: true },
        h("summary", {}, `${file.name} differs`),
        file.diff.length
          ? h(
              "pre",
              { class: "file-text file-diff", tabindex: "0" },
              file.diff.map((line) =>
                h(
                  "span",
                  {
                    class: line.startsWith("+")
                      ? "diff-added"
                      : line.startsWith("-")
                        ? "diff-removed"
                        : null,
                  },
                  `${line}\n`,
                ),
              ),
            )
          : h("p", { class: "quiet" }, "Its text was not kept."),
      ),
    ),
    table(
      "Results",
      ["Result", other, prefix],
      found.results.map((each) => [
        RESULTS[each.name] ?? each.name.replaceAll("_", " "),
        figure(each.before),
        figure(each.after),
      ]),
    ),
    found.versions.length || found.machine.length
      ? h(
          "details",
          {},
          h("summary", {}, "Versions and machine differ"),
          table(
            "Versions and machine",
            ["What", other, prefix],
            rows([...found.versions, ...found.machine]),
          ),
        )
      : null,
  );
}

const figure = (value) =>
  value === null || value === ""
    ? "–"
    : text(
        typeof value === "number" && !Number.isInteger(value) ? Number(value.toFixed(3)) : value,
      );
