// The reward function: templates, editor, and the check that is drawn while it is typed.

import { CodeEditor, replaceText } from "/code_editor.js";
import { confirmed } from "/ask.js";
import { useDraft } from "/drafts.js";
import { Field, Problems, Refused, leadTo, useChecked } from "/fields.js";
import { RewardPicture } from "/reward_picture.js";
import { Step, useFileSaving } from "/steps.js";
import { Table, html, useRef, useState } from "/ui.js";

const PATH = "/api/reward";
const PAGE = crypto.getRandomValues(new Uint32Array(2)).join("-");
const CHECK_MS = 120;

const isOwn = (each) => /reward_function\.py$/.test(each.file ?? "");

function stateOf({ answer, error, isCurrent }) {
  if (!isCurrent) return "Checking ... The first check on a track takes some seconds longer.";
  if (error || !answer) return "Not checked.";
  const count = (severity) => answer.problems.filter((each) => each.severity === severity).length;
  const errors = count("error");
  if (errors) return `${errors} ${errors > 1 ? "errors" : "error"}: a training would not start.`;
  return count("warning") ? "It works; read the warnings." : "It works.";
}

/**
 * @param {{facts: Object, reload: () => Promise<void>, folder: string, known: Object, changes: number, saved: () => void}} props
 *   `facts` is the answer of /api/reward, `known` of /api/reward/templates; it is checked again after `changes` elsewhere
 */
export function RewardStep({ facts, reload, folder, known, changes, saved }) {
  const draft = useDraft(`${folder}/reward_function`, facts.version);
  const text = draft.edits.text ?? facts.text;
  const dirty = text !== facts.text;
  const area = useRef(null);
  const course = useRef(null);
  const [template, setTemplate] = useState("0");
  const checked = useChecked(`${PATH}/check`, { page: PAGE, text, changes }, CHECK_MS, {
    known: course.current?.key ?? "",
    whole: false,
  });
  const { answer, error } = checked;
  if (answer?.course) course.current = answer.course;
  const set = (value) => draft.change("text", value, facts.text);
  const body = { text };
  const file = { path: PATH, draft, edits: body, body, mine: text, reload, saved };
  const saving = useFileSaving(dirty, file);
  const { templates, parameters } = known;
  const insert = async () => {
    const chosen = templates[Number(template)];
    const question = `Replace what you have typed by the template "${chosen.name}"?`;
    if (dirty && text !== chosen.text && !(await confirmed(question, { action: "Replace" })))
      return;
    replaceText(area.current, chosen.text);
  };
  return html`
    <${Step} id="reward" title="Reward function" dirty=${dirty} saving=${saving} draft=${draft}
      hint="It is called after each step; a training makes the sum of its rewards as large as it can. The check runs while you type.">
      <div class="row">
        <${Field} label="Template" options=${templates.map((each, k) => [String(k), each.name])} value=${template}
          set=${setTemplate} help=${templates[Number(template)]?.about ?? ""} />
        <button type="button" onClick=${insert}>Use this template</button>
      </div>
      <div class="split wide">
        <div>
          <${CodeEditor} label="Reward function" text=${text} onInput=${set} problems=${(answer?.problems ?? []).filter(isOwn)} area=${area} />
          <p class="step-state" role="status">${stateOf(checked)}</p>
          <div class="reward-problems">
            ${error ? html`<${Refused} error=${error} />` : html`<${Problems} problems=${answer?.problems} lead=${leadTo} />`}
          </div>
          <details>
            <summary>Parameters of the function</summary>
            <${Table} caption="Parameters" heads=${["Name", "Type", "Unit", "Meaning"]} rows=${parameters} />
          </details>
        </div>
        <${RewardPicture} course=${course.current} report=${answer} />
      </div>
    <//>`;
}
