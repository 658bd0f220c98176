// Fields for settings: a control of the right kind, its help, where its value comes from, its problems.

import { fill, h, prose } from "/dom.js";

let count = 0;

/**
 * A field for one setting of /api/settings.
 * @param {Object} facts the setting
 * @param {{label?: string, change: function(): void, places?: boolean}} options
 */
export function settingField(facts, { label = facts.name, change, places = false }) {
  const id = `setting-${++count}`,
    problem = h("p", { class: "field-problem", id: `${id}-problem`, role: "status" });
  const help = h("p", { class: "help", id: `${id}-help` });
  const common = { id, "aria-describedby": `${id}-help ${id}-problem` };
  let start = startOf(facts),
    control;
  const plainChoice = facts.kind === "choice" && (start === "" || wordOf(facts, start));
  const plainFlag =
    facts.kind === "flag" && /^(true|false|1|0|yes|no|on|off|t|f|y|n)?$/i.test(start);
  const changed = () => {
    change();
    showHelp();
  };
  if (facts.secret)
    control = h("input", {
      ...common,
      type: "password",
      autocomplete: "new-password",
      placeholder: facts.set ? "set; not shown" : "not set",
      input: changed,
    });
  else if (plainFlag)
    control = h(
      "select",
      { ...common, change: changed },
      [
        ["True", "Yes (True)"],
        ["False", "No (False)"],
      ].map(([value, text]) => h("option", { value }, text)),
    );
  else if (plainChoice)
    control = h(
      "select",
      { ...common, change: changed },
      facts.choices.map((value) => h("option", { value }, value)),
    );
  else
    control = h("input", {
      ...common,
      type: "text",
      autocomplete: "off",
      spellcheck: "false",
      inputmode: facts.kind === "whole" ? "numeric" : facts.kind === "number" ? "decimal" : null,
      input: changed,
    });
  const element = h(
    "div",
    { class: "field", "data-setting": facts.name },
    h(
      "label",
      { for: id },
      label,
      label === facts.name ? null : h("code", { class: "quiet" }, ` ${facts.name}`),
    ),
    control,
    help,
    problem,
  );

  function normal(text) {
    if (plainFlag) return /^(true|1|yes|on|t|y)$/i.test(text) ? "True" : "False";
    return plainChoice ? (wordOf(facts, text) ?? text) : text;
  }
  function showHelp() {
    const parts = [sentence(facts.meaning)];
    if (!plainFlag && !plainChoice && facts.kind !== "text")
      parts.push(`Allowed: ${facts.expected}.`);
    if (facts.default && !facts.secret) parts.push(`Default: ${facts.default}.`);
    if (places)
      parts.push(
        facts.source === "default" ? "Not set, so the default counts." : `From ${facts.source}.`,
      );
    if (places && facts.written?.includes("$") && !facts.secret)
      parts.push(`Filled in: ${facts.value || "empty"}.`);
    if (facts.environment)
      parts.push(
        `The environment of the console sets it and overrides the files; \`unset ${facts.name}\` and \`dr console restart\` take that back.`,
      );
    if (facts.effect !== "used") parts.push(`No effect here: ${facts.reason}.`);
    fill(help, prose(parts.join(" ")));
  }
  function set(text) {
    control.value = facts.secret ? "" : normal(text);
  }
  set(start);
  start = control.value;
  showHelp();
  return {
    name: facts.name,
    element,
    control,
    get value() {
      return control.value;
    },
    set value(text) {
      set(text);
      change();
    },
    get changed() {
      return control.value !== start;
    },
    /** What the files have now. */
    saved(newFacts = null) {
      if (newFacts) {
        Object.assign(facts, newFacts);
        set(startOf(facts));
      }
      start = control.value;
      showHelp();
    },
    reset() {
      control.value = start;
    },
    problem(found) {
      fill(
        problem,
        found.map((each) =>
          h(
            "span",
            { class: each.severity === "error" ? "bad" : "warn" },
            prose(`${each.message} ${each.remedy} `),
          ),
        ),
      );
      control.setAttribute("aria-invalid", String(found.some((each) => each.severity === "error")));
    },
    focus() {
      control.focus();
      element.scrollIntoView({ block: "center" });
    },
  };
}

const startOf = (facts) => (facts.secret ? "" : (facts.written ?? facts.value ?? ""));
const wordOf = (facts, text) =>
  facts.choices.find((word) => word.toLowerCase() === text.toLowerCase());
const sentence = (text) => (/[.!?]$/.test(text) ? text : `${text}.`);

/** A list of problems, errors first; `lead` makes each a link to its place. */
export function problemList(problems, lead = null) {
  if (!problems.length) return null;
  return h(
    "ul",
    { class: "problems" },
    problems.map((each) =>
      h(
        "li",
        { class: each.severity },
        h(
          "strong",
          {},
          each.severity === "error" ? "Error" : each.severity === "warning" ? "Warning" : "Note",
        ),
        each.where
          ? [
              " ",
              lead
                ? h(
                    "button",
                    { type: "button", class: "link", click: () => lead(each) },
                    each.where,
                  )
                : h("span", {}, each.where),
              each.key && !each.message.includes(each.key) ? ` ${each.key}` : "",
            ]
          : each.key && lead
            ? [
                " ",
                h("button", { type: "button", class: "link", click: () => lead(each) }, each.key),
              ]
            : null,
        ": ",
        prose(each.message),
        " ",
        h("span", { class: "remedy" }, prose(each.remedy)),
      ),
    ),
  );
}

/**
 * Both versions of what was changed here and on the disk; resolves to "mine", "disk" or "".
 * @param {string} message what happened
 * @param {{name: string, yours: string, disk: string|null}[]} both
 */
export function chooseVersion(message, both) {
  return new Promise((resolve) => {
    // Lines that the other version does not have are marked.
    const show = (text, other) =>
      h(
        "pre",
        { class: "version", tabindex: "0" },
        text === null || text === undefined
          ? "(not there)"
          : text.split("\n").flatMap((line, k, all) => {
              const end = k < all.length - 1 ? "\n" : "";
              return other?.split("\n").includes(line)
                ? [line + end]
                : [h("mark", {}, line || " "), end];
            }),
      );
    const dialog = h(
      "dialog",
      { class: "wide", "aria-labelledby": "conflict" },
      h(
        "form",
        { method: "dialog" },
        h("h2", { id: "conflict" }, "The file has changed on the disk"),
        h("p", {}, message, " Choose which version to keep."),
        both.map((each) =>
          h(
            "section",
            { class: "versions" },
            h("h3", {}, each.name),
            h("div", {}, h("p", {}, "Yours, on this page"), show(each.yours, each.disk)),
            h("div", {}, h("p", {}, "On the disk"), show(each.disk, each.yours)),
          ),
        ),
        h(
          "p",
          { class: "actions" },
          h("button", { value: "", autofocus: true }, "Cancel"),
          h("button", { value: "disk" }, "Take the one on the disk"),
          h("button", { value: "mine", class: "danger" }, "Write mine"),
        ),
      ),
    );
    dialog.addEventListener("close", () => {
      resolve(dialog.returnValue);
      dialog.remove();
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

/** Call a function when nothing was typed for a while. */
export function debounced(call, wait, signal) {
  let timer = 0;
  signal?.addEventListener("abort", () => clearTimeout(timer), { once: true });
  return () => {
    clearTimeout(timer);
    if (!signal?.aborted) timer = setTimeout(call, wait);
  };
}
