// run.env and system.env as forms by group.

import { get, post } from "/api.js";
import { failure, fill, h } from "/dom.js";
import { asWarnings, guardLeaving, writeSettings } from "/edit_step.js";

import { debounced, problemList, settingField } from "/setting_fields.js";

export const title = "Settings";

export async function show(main, params, { signal, query }) {
  fill(main, h("h1", {}, title), h("p", { role: "status" }, "Reading the settings ..."));
  build(main, await get("/api/settings", signal), { signal, query });
}

function build(main, form, { signal, query }) {
  const fields = new Map(),
    state = h("p", { class: "step-state", role: "status" }, "Nothing is changed."),
    problems = h("div", {});
  let versions = form.versions;
  const later = debounced(check, 500, signal);
  const wanted = () => [...fields.values()].filter((each) => each.changed);
  const save = h("button", { type: "button", class: "main", disabled: true, click: write }, "Save");
  const undo = h(
    "button",
    {
      type: "button",
      disabled: true,
      click: () => {
        for (const each of wanted()) each.reset();
        changed();
      },
    },
    "Undo all",
  );
  const search = h("input", {
    type: "search",
    id: "settings-search",
    placeholder: "Name or word",
    autocomplete: "off",
    input: filter,
  });
  const onlySet = h("input", { type: "checkbox", id: "only-set", change: filter });
  const found = h("p", { class: "readout", role: "status" }, " ");
  const sections = form.groups.map((group) => {
    const mine = group.settings.map((facts) => {
      const field = settingField(facts, { change: changed, places: true });
      fields.set(facts.name, field);
      return { facts, field };
    });
    const set = mine.filter(({ facts }) => facts.place).length;
    return {
      mine,
      element: h(
        "details",
        { class: "group" },
        h(
          "summary",
          {},
          h("h2", {}, group.title),
          h(
            "span",
            { class: "quiet" },
            ` ${mine.length} ${mine.length === 1 ? "setting" : "settings"}, ${set} set`,
          ),
        ),
        h(
          "div",
          { class: "fields" },
          mine.map(({ field }) => field.element),
        ),
      ),
    };
  });

  function changed() {
    const count = wanted().length;
    save.disabled = undo.disabled = !count;
    state.textContent = count
      ? `${count} ${count === 1 ? "setting is" : "settings are"} not saved yet.`
      : "Nothing is changed.";
    later();
  }
  function filter() {
    const word = search.value.trim().toLowerCase();
    let shown = 0;
    for (const { mine, element } of sections) {
      let any = 0;
      for (const { facts, field } of mine) {
        const fits =
          `${facts.name} ${facts.meaning} ${facts.secret ? "" : facts.value}`
            .toLowerCase()
            .includes(word) &&
          (!onlySet.checked || facts.place || facts.environment);
        field.element.hidden = !fits;
        any += fits;
      }
      element.hidden = !any;
      element.open = Boolean(word || onlySet.checked) && any > 0;
      shown += any;
    }
    found.textContent = word || onlySet.checked ? `${shown} settings` : " ";
  }
  function showProblems(list) {
    for (const field of fields.values())
      field.problem(list.filter((each) => each.key === field.name));
    fill(
      problems,
      problemList(list, (problem) => lead(problem.key)),
    );
  }
  function lead(name) {
    const field = fields.get(name);
    if (!field) return;
    field.element.hidden = false;
    const group = field.element.closest("details");
    group.hidden = false;
    group.open = true;
    field.focus();
  }
  async function check() {
    const values = Object.fromEntries(wanted().map((each) => [each.name, each.value]));
    if (!Object.keys(values).length) {
      showProblems(form.problems);
      return;
    }
    try {
      const checked = await post("/api/settings/check", { values }, signal);
      showProblems([...checked.problems, ...asWarnings(checked.warnings)]);
    } catch (error) {
      if (error.name !== "AbortError") fill(problems, failure(error));
    }
  }
  async function write() {
    const changes = wanted(),
      values = Object.fromEntries(changes.map((each) => [each.name, each.value]));
    save.disabled = true;
    state.textContent = "Saving ...";
    try {
      const edit = await writeSettings(values, versions, signal);
      if (!edit) {
        changed();
        return;
      }
      form = await get("/api/settings", signal);
      versions = form.versions;
      const now = new Map(
        form.groups.flatMap((group) => group.settings).map((each) => [each.name, each]),
      );
      for (const [name, field] of fields)
        if (values[name] !== undefined || !field.changed) field.saved(now.get(name));
      showProblems([
        ...form.problems.filter((each) => each.severity === "error"),
        ...asWarnings(edit.warnings),
      ]);
      changed();
      const files = [...new Set((edit.changes ?? []).map((each) => each.file))].join(" and ");
      state.textContent = edit.disk
        ? "Taken from the disk."
        : `Saved in ${files}; the old file is kept as .bak. A training that runs keeps its settings.`;
    } catch (error) {
      if (error.name === "AbortError") return;
      if (error.problems) showProblems(error.problems);
      else fill(problems, failure(error));
      save.disabled = false;
      state.textContent = "Not saved.";
    }
  }
  fill(
    main,
    h("h1", {}, title),
    h(
      "p",
      { class: "quiet" },
      `${form.run_file} and system.env in ${form.directory}. $NAME in a value stands for the value of another setting. Values of the environment win over the files, and ${form.run_file} wins over system.env. Comments in the files stay.`,
    ),
    h(
      "div",
      { class: "row settings-bar" },
      h(
        "div",
        { class: "field" },
        h("label", { for: "settings-search" }, "Search settings"),
        search,
      ),
      h(
        "p",
        { class: "actions" },
        onlySet,
        h("label", { for: "only-set" }, "Only those that are set"),
      ),
      h("div", { class: "actions" }, save, undo, state),
    ),
    found,
    problems,
    sections.map((each) => each.element),
  );
  showProblems(form.problems);
  const name = query.get("name");
  if (name) lead(name);
  guardLeaving(() => wanted().length > 0, signal);
}
