// The form with all rules of a race, to make one or to change one. What it comes to is checked while it is filled.

import { aboutField } from "/ask.js";
import { Fields, leadTo, readFields, startOf, useChecked } from "/fields.js";
import { DraftNote } from "/steps.js";
import { useAction, useGet } from "/store.js";
import { Button, Failure, Form, Loaded, Prose, html, useEffect, useRef, useState } from "/ui.js";

const CHECK_MS = 350;
const isBox = ({ kind }) => kind === "flag" || kind === "many";

/**
 * @param {{title: string, action: string, draft: Object, path?: string, present?: boolean, send: (rules: Object) => Promise<void>, leave: () => void}} props
 *   path: where the fields are; present: they have the rules of a race
 */
export function RaceForm(props) {
  const { title, draft, path = "/api/races/form", present = false } = props;
  const found = useGet(path);
  return html`
    <section class="race-card" aria-label=${title}>
      <h2>${title}</h2>
      ${present && html`<p class="quiet">As long as nobody has driven.</p>`}
      <${DraftNote} draft=${draft} />
      <${Loaded} found=${found} reading="Reading the tracks …">${({ fields }) => html`<${Rules} fields=${fields} ...${props} />`}<//>
    </section>`;
}

function Rules({ fields, present = false, action, draft, send, leave }) {
  const form = useRef(null);
  const [refused, setRefused] = useState(null);
  const start = startOf(fields);
  const values = { ...start, ...draft.edits };
  const { given, wrong } = readFields(fields, values);
  const isNamed = values.name.trim() !== "";
  const wait = present || draft.restored ? 0 : CHECK_MS;
  const checked = useChecked("/api/races/check", isNamed && !wrong.length ? given : null, wait);
  const told = refused ?? (checked.error && aboutField(checked.error));
  const problems = told ? [...wrong, told] : wrong;
  useEffect(() => form.current.querySelector("input").focus(), []);

  const set = (name, value) => {
    setRefused(null);
    draft.change(name, value, start[name]);
  };
  const [submit, busy] = useAction(async () => {
    if (wrong.length) return leadTo(wrong[0]);
    try {
      await send(given);
      draft.saved(values);
    } catch (error) {
      setRefused(aboutField(error));
      leadTo(aboutField(error));
    }
  });
  const cancel = () => {
    draft.set({});
    leave();
  };
  const controls = (own) =>
    html`<${Fields} fields=${own} values=${values} set=${set} problems=${problems} />`;
  const parts = Object.entries(Object.groupBy(fields, ({ part }) => part));
  const label = fields.find((each) => each.name === problems[0]?.key)?.label;
  return html`
    <${Form} ref=${form} class="race-form" aria-label=${action} onSubmit=${submit}>
      ${parts.map(
        ([name, own]) => html`
          <fieldset key=${name}><legend>${name}</legend>
            <div class="fields">${controls(own.filter((each) => !isBox(each)))}</div>
            ${controls(own.filter(isBox))}
          </fieldset>`,
      )}
      <div class="race-outcome" role="status"><${Outcome} ...${{ busy, isNamed, label }} problem=${problems[0]} said=${checked.answer?.said.slice(0, present ? 1 : 2)} /></div>
      <p class="actions">
        <${Button} type="submit" class="main" busy=${busy}>${action}<//>
        <${Button} onClick=${cancel}>Cancel<//>
      </p>
    <//>`;
}

/** What the rules come to, or what stands in the way. */
function Outcome({ busy, isNamed, label, problem, said }) {
  if (busy) return html`<p class="quiet">Waiting for the answer ... The form stays filled in.</p>`;
  if (problem && label) return html`<p class="race-failed">Correct the field “${label}” first.</p>`;
  if (problem) return html`<${Failure} error=${problem} />`;
  if (!isNamed) return html`<p class="quiet">Give the race a name.</p>`;
  if (!said) return html`<p class="quiet">Your rules appear here as a sentence.</p>`;
  return said.map((text) => html`<p key=${text}><${Prose} text=${text} /></p>`);
}
