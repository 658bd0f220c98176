// The reward function: templates, editor, and the check that is drawn while it is typed.

import { get, post } from "/api.js";
import { codeEditor } from "/code_editor.js";
import { confirmed, failure, fill, h, table } from "/dom.js";
import { editStep, savedText, writeOwnFile } from "/edit_step.js";
import { rewardPicture } from "/reward_picture.js";
import { debounced, problemList } from "/setting_fields.js";

const PATH = "/api/reward";
const PAGE = crypto.getRandomValues(new Uint32Array(2)).join("-");

/** The step; `facts` is the answer of /api/reward. */
export function rewardStep(facts, { templates, parameters }, { saved }, signal) {
  const picture = rewardPicture(signal);
  const found = h("div", { class: "reward-problems" }),
    state = h("p", { class: "step-state", role: "status" }, " ");
  const later = debounced(check, 700, signal);
  const editor = codeEditor({
    label: "Reward function",
    change: () => {
      changed();
      later();
    },
  });
  const choose = h(
    "select",
    { id: "template" },
    templates.map((each, k) => h("option", { value: String(k) }, each.name)),
  );
  const about = h("p", { class: "help" });
  const tell = () => {
    about.textContent = templates[Number(choose.value)]?.about ?? "";
  };
  choose.addEventListener("change", tell);
  tell();
  const step = editStep(
    {
      id: "reward",
      title: "Reward function",
      hint: "It is called after each step; a training makes the sum of its rewards as large as it can. The check runs while you type, as `dr-reward check` does.",
      save,
    },
    h(
      "div",
      { class: "row" },
      h("div", { class: "field" }, h("label", { for: "template" }, "Template"), choose, about),
      h("button", { type: "button", click: insert }, "Use this template"),
    ),
    h(
      "div",
      { class: "split wide" },
      h(
        "div",
        {},
        editor.element,
        state,
        found,
        h(
          "details",
          {},
          h("summary", {}, "Parameters of the function"),
          table(
            "Parameters",
            ["Name", "Type", "Unit", "Meaning"],
            parameters.map((each) => [
              h("code", {}, each.name),
              each.kind,
              each.unit.replaceAll("**", "") || "",
              each.meaning.replaceAll("**", ""),
            ]),
          ),
        ),
      ),
      picture.element,
    ),
  );
  let number = 0;

  const changed = () =>
    step.mark(editor.text !== facts.text, editor.text !== facts.text ? null : "");
  async function insert() {
    const template = templates[Number(choose.value)];
    if (
      editor.text !== facts.text &&
      editor.text !== template.text &&
      !(await confirmed(`Replace what you have typed by the template "${template.name}"?`, {
        action: "Replace",
      }))
    )
      return;
    editor.area.focus();
    editor.area.select();
    if (!document.execCommand("insertText", false, template.text)) editor.text = template.text; // so that it can be undone
    changed();
    check();
  }
  async function check() {
    const mine = ++number;
    state.textContent = "Checking ... The first check on a track takes some seconds longer.";
    try {
      const report = await post(
        `${PATH}/check`,
        { page: PAGE, text: editor.text, known: picture.known },
        signal,
      );
      if (mine !== number || report.superseded) return;
      editor.mark(report.problems.filter((each) => /reward_function\.py$/.test(each.file ?? "")));
      const count = (severity) =>
        report.problems.filter((each) => each.severity === severity).length;
      const errors = count("error");
      state.textContent = errors
        ? `${errors} ${errors > 1 ? "errors" : "error"}: a training would not start.`
        : count("warning")
          ? "It works; read the warnings."
          : "It works.";
      fill(
        found,
        problemList(report.problems, (problem) => editor.goTo(problem.line)),
      );
      picture.show(report);
    } catch (error) {
      if (error.name === "AbortError" || mine !== number) return;
      state.textContent = "Not checked.";
      fill(found, error.problems ? problemList(error.problems) : failure(error));
    }
  }
  async function save() {
    const text = editor.text;
    const answer = await writeOwnFile(
      PATH,
      { text, version: facts.version },
      { mine: text, read: () => get(PATH, signal), signal },
    );
    if (!answer) {
      step.mark(true, "Not saved.");
      return;
    }
    Object.assign(facts, answer.disk ?? { ...answer, text });
    if (answer.disk) {
      editor.text = facts.text;
      check();
    }
    step.problems([]);
    step.mark(
      editor.text !== facts.text,
      editor.text !== facts.text ? null : answer.disk ? "Taken from the disk." : savedText(answer),
    );
    saved();
  }
  editor.text = facts.text;
  check();
  step.refresh = later;
  step.lead = (problem) => {
    editor.goTo(problem.line);
    return true;
  };
  return step;
}
