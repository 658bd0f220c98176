// Fields of forms: label, control, help and problems; and lists of problems that lead to their places.

import { post } from "/api.js";
import { Prose, html, signal, useEffect, useId, useRef, useState } from "/ui.js";

/**
 * The answer of a check of values, asked for when nothing was changed for a while.
 * @param {string} path
 * @param {any} body null if there is nothing to check
 * @param {number} wait milliseconds
 * @param {Object} more what is sent too, whose change asks for nothing
 * @param {string} version of the file that the values change
 * @returns {{answer: any, error: any, isCurrent: boolean}} the newest answer, and whether it is about these values
 */
export function useChecked(path, body, wait = 500, more = {}, version = "") {
  const key = body && JSON.stringify([body, version]);
  const sent = useRef(more);
  sent.current = more;
  const [state, setState] = useState({ key: null, answer: null, error: null });
  useEffect(() => {
    if (!key) {
      setState({ key, answer: null, error: null });
      return undefined;
    }
    const own = new AbortController();
    // A first answer may be a part of the whole one, which is then asked for.
    const ask = (part) =>
      post(path, { ...JSON.parse(key)[0], ...sent.current, ...part }, own.signal).then(
        (answer) => {
          if (answer.superseded) return;
          const add = (before) => ({ ...before, answer: { ...before.answer, ...answer } });
          setState(answer.more ? add : { key, answer, error: null });
          if (answer.more) ask({ whole: true });
        },
        (error) => error.name !== "AbortError" && setState((before) => ({ ...before, key, error })),
      );
    const timer = setTimeout(ask, wait, {});
    return () => {
      clearTimeout(timer);
      own.abort();
    };
  }, [path, key]);
  return { ...state, isCurrent: state.key === key };
}

/** Sentences as problems. */
export const asWarnings = (sentences = []) =>
  sentences.map((message) => ({ severity: "warning", message, remedy: "", where: "", key: "" }));

const WORDS = { error: "Error", warning: "Warning", note: "Note" };

/**
 * Problems, errors first; `lead` makes the place of each a button.
 * @param {{problems: Object[], lead?: ((problem: Object) => void) | null}} props
 */
export function Problems({ problems, lead = null }) {
  if (!problems?.length) return null;
  const place = (each, text) =>
    lead
      ? html`<button type="button" class="link" onClick=${() => lead(each)}>${text}</button>`
      : text;
  return html`<ul class="problems">${problems.map((each, k) => {
    const named = each.where && each.key && !each.message.includes(each.key);
    const where = each.where || (lead && each.key);
    return html`<li key=${k} class=${each.severity}>
      <strong>${WORDS[each.severity]}</strong>${where && html` ${place(each, where)}`}${named && ` ${each.key}`}: <${Prose} text=${each.message} />
      ${each.remedy && html` <span class="remedy"><${Prose} text=${each.remedy} /></span>`}
    </li>`;
  })}</ul>`;
}

/**
 * A labelled control with help and problems.
 * @param {{label: any, help?: any, problems?: Object[], control: (common: Object) => any, children?: any, hidden?: boolean}} props
 *   `control` gets id and descriptions for its element
 */
export function Field({
  label,
  help = "",
  problems = [],
  control,
  children = null,
  hidden = false,
  ...more
}) {
  const id = useId();
  const bad = problems.some((each) => each.severity === "error");
  const common = {
    id,
    "aria-describedby": `${id}-help ${id}-problem`,
    "aria-invalid": bad ? "true" : null,
  };
  return html`
    <div class="field" hidden=${hidden} ...${more}>
      <label for=${id}>${label}</label>
      ${control(common)}
      <p class="help" id=${`${id}-help`}>${typeof help === "string" ? html`<${Prose} text=${help} />` : help}</p>
      <p class="field-problem" id=${`${id}-problem`} role="status">${problems.map(
        (each) =>
          html`<span class=${each.severity === "error" ? "bad" : "warn"}><${Prose} text=${`${each.message} ${each.remedy} `} /></span>`,
      )}</p>
      ${children}
    </div>`;
}

/** A text field. @param {{label: any, value: string, onInput: (text: string) => void, numeric?: boolean, placeholder?: string, type?: string} & Record<string, any>} props */
export const TextField = ({
  value,
  onInput,
  numeric = false,
  placeholder = null,
  type = "text",
  ...more
}) => html`
  <${Field} ...${more} control=${(
    common,
  ) => html`<input ...${common} type=${type} autocomplete="off" spellcheck=${false}
    inputmode=${numeric ? "decimal" : null} placeholder=${placeholder} value=${value}
    onInput=${(event) => onInput(event.currentTarget.value)} />`} />`;

/** A choice. @param {{label: any, options: (string | string[])[], value: string, onChange: (value: string) => void}} props */
export const SelectField = ({ options, value, onChange, ...more }) => html`
  <${Field} ...${more} control=${(common) => html`<select ...${common} value=${value}
    onChange=${(event) => onChange(event.currentTarget.value)}>${options.map((each) => {
      const [key, text] = Array.isArray(each) ? each : [each, each];
      return html`<option key=${key} value=${key}>${text}</option>`;
    })}</select>`} />`;

/**
 * A field for one setting of /api/settings.
 * @param {{facts: Object, value: string, onInput: (text: string) => void, label?: string, places?: boolean, problems?: Object[], hidden?: boolean}} props
 *   `places`: say where its value comes from
 */
export function SettingField({
  facts,
  value,
  onInput,
  label = facts.name,
  places = false,
  ...more
}) {
  const common = {
    label: label === facts.name ? label : html`${label}<code class="quiet"> ${facts.name}</code>`,
    help: places ? `${facts.help} ${facts.origin}` : facts.help,
    value,
    "data-key": facts.name,
    ...more,
  };
  if (facts.kind === "flag" || facts.kind === "choice")
    return html`<${SelectField} ...${common} options=${facts.choices} onChange=${onInput} />`;
  return html`<${TextField} ...${common} numeric=${facts.kind === "number"} onInput=${onInput}
    type=${facts.secret ? "password" : "text"} placeholder=${facts.secret ? (facts.set ? "set; not shown" : "not set") : null} />`;
}

/** The line of the reward function that somebody wants to see. */
export const wantedLine = signal({ line: 0, times: 0 });

/**
 * Lead to the control of a problem on this page.
 * @param {{key?: string, file?: string, line?: number | null}} problem
 * @returns {boolean} whether there is one
 */
export function leadTo(problem) {
  if (/reward_function\.py$/.test(problem.file ?? "") && document.querySelector(".code-area")) {
    wantedLine.value = { line: problem.line ?? 1, times: wantedLine.value.times + 1 };
    return true;
  }
  const key = problem.key ?? "";
  const names = [key, key.replace(/\.\w+$/, ""), key.split(/[.[]/)[0]].filter(Boolean);
  const place = names
    .map((name) => document.querySelector(`[data-key="${CSS.escape(name)}"]`))
    .find(Boolean);
  if (!place) return false;
  for (let at = /** @type {any} */ (place); at; at = at.parentElement) {
    if (at.tagName === "DETAILS") at.open = true;
    at.hidden = false;
  }
  const control = place.matches("input, select, textarea")
    ? place
    : place.querySelector("input, select, textarea");
  /** @type {HTMLElement | null} */ (control)?.focus();
  place.scrollIntoView({ block: "center" });
  return true;
}
