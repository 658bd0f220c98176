// Fields of forms: label, control, help and problems; and lists of problems that lead to their places.

import { post } from "/api.js";
import { Failure, Options, Prose, Tick, useId } from "/ui.js";
import { html, signal, useEffect, useRef, useState } from "/vendor/preact/preact.js";

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

/** What was refused: its problems, which lead to their places, or else its sentence. */
export const Refused = ({ error, lead = leadTo }) =>
  error?.problems?.length
    ? html`<${Problems} problems=${error.problems} lead=${lead} />`
    : error && html`<${Failure} error=${error} />`;

/**
 * A labelled control with help and problems: a choice with `options`, a text of several lines with `rows`, or a line.
 * @param {{label: any, value: any, set: (text: string) => void, options?: any[] | null, rows?: number, numeric?: boolean,
 *   help?: string, problems?: Object[], hidden?: boolean, place?: string, children?: any} & Record<string, any>} props
 *   `place`: the key of problems that lead here; what is not named here is an attribute of the control
 */
export function Field({ label, value, set, options = null, rows = 0, numeric = false, ...props }) {
  const { help = "", problems = [], hidden = false, place = null, children, ...more } = props;
  const id = useId();
  const own = {
    ...{ id, value, onInput: (event) => set(event.currentTarget.value) },
    "aria-describedby": `${id}-help ${id}-problem`,
    "aria-invalid": problems.some((each) => each.severity === "error") ? "true" : null,
    ...more,
  };
  const line = { autocomplete: "off", spellcheck: false, inputmode: numeric ? "decimal" : null };
  const control = options
    ? html`<select ...${own}><${Options} options=${options} /></select>`
    : rows
      ? html`<textarea ...${own} rows=${rows}></textarea>`
      : html`<input ...${line} ...${own} />`;
  return html`
    <div class="field" hidden=${hidden} data-key=${place}>
      <label for=${id}>${label}</label>
      ${control}
      <p class="help" id=${`${id}-help`}><${Prose} text=${help} /></p>
      <p class="field-problem" id=${`${id}-problem`} role="status">${problems.map(
        (each) =>
          html`<span class=${each.severity === "error" ? "bad" : "warn"}><${Prose} text=${`${each.message} ${each.remedy} `} /></span>`,
      )}</p>
      ${children}
    </div>`;
}

/**
 * A field as the server describes it.
 * @typedef {Object} Described
 * @property {string} name
 * @property {string} label
 * @property {any} value what it begins with; true or false for a check box, a list for several
 * @property {string} [kind] text, choice, whole, number, time, flag, many or lines
 * @property {any[]} [options] of a choice, or of several
 * @property {string} [help]
 * @property {string} [placeholder]
 * @property {Object} [more] attributes of the control, such as min and required
 * @property {[string, string[]]} [only] another field, and its values with which this one has a meaning
 */

/** @param {Described} field @param {Record<string, any>} values */
const isHidden = ({ only }, values) => Boolean(only) && !only[1].includes(values[only[0]]);

/** @param {{kind?: string}} field */
const isNumber = ({ kind }) => kind === "whole" || kind === "number";

function localTime(unix) {
  if (!unix) return "";
  const at = new Date(unix * 1000);
  return new Date(Number(at) - at.getTimezoneOffset() * 60_000).toISOString().slice(0, 16);
}

/** What the controls of described fields begin with. @param {Described[]} fields */
export const startOf = (fields) =>
  Object.fromEntries(
    fields.map((field) => {
      const { name, kind, value } = field;
      if (kind === "time") return [name, localTime(value)];
      return [name, isNumber(field) ? String(value ?? "") : value];
    }),
  );

/** The controls of described fields. @param {{fields: Described[], values: Record<string, any>, set: (name: string, value: any) => void, problems?: Object[]}} props */
export const Fields = ({ fields, values, set, problems = [] }) =>
  fields.map((field) => {
    const { name, label, kind = "text", options = [], help, placeholder, more } = field;
    const value = values[name];
    const change = (given) => set(name, given);
    if (kind === "flag")
      return html`<p key=${name} data-key=${name} hidden=${isHidden(field, values)}><${Tick} label=${label} on=${value} set=${change} /></p>`;
    if (kind === "many")
      return html`
        <div key=${name} data-key=${name} role="group" aria-label=${label}>
          <p class="many">${label}</p>
          ${options.map(([key, text]) => {
            const others = value.filter((one) => one !== key);
            return html`<${Tick} key=${key} label=${text} on=${value.includes(key)} set=${(on) => change(on ? [...others, key] : others)} />`;
          })}
        </div>`;
    const own = {
      ...{ key: name, place: name, label, help, value, set: change, placeholder, ...more },
      ...{ options: kind === "choice" ? options : null, rows: kind === "lines" ? 5 : 0 },
      ...{ numeric: isNumber(field), type: kind === "time" ? "datetime-local" : more?.type },
    };
    return html`<${Field} ...${own} hidden=${isHidden(field, values)} problems=${problems.filter((each) => each.key === name)} />`;
  });

/**
 * What is sent of described fields: numbers as such, null for none, times of the world; nothing of hidden ones.
 * @param {Described[]} fields
 * @param {Record<string, any>} values
 * @returns {{given: Record<string, any>, wrong: Object[]}} with problems that no server needs to find
 */
export function readFields(fields, values) {
  const given = {};
  const wrong = [];
  for (const field of fields.filter((each) => !isHidden(each, values))) {
    const { name, label, kind } = field;
    const text = values[name];
    given[name] = text;
    if (kind === "time") given[name] = text && new Date(text).toISOString();
    if (!isNumber(field)) continue;
    given[name] = text.trim() === "" ? null : Number(text);
    const whole = kind === "whole";
    if (whole ? Number.isSafeInteger(given[name] ?? 0) : Number.isFinite(given[name] ?? 0))
      continue;
    const message = `“${label}” is not a ${whole ? "whole " : ""}number.`;
    const remedy = `Write digits, such as ${whole ? "3" : "2.5"}.`;
    wrong.push({ severity: "error", key: name, where: "", message, remedy });
  }
  return { given, wrong };
}

/**
 * A field for one setting of /api/settings.
 * @param {{facts: Object, label?: string, places?: boolean} & Record<string, any>} props `places`: say where its value comes from
 */
export const SettingField = ({ facts, label = "", places = false, ...more }) => html`
  <${Field} label=${label ? html`${label}<code class="quiet"> ${facts.name}</code>` : facts.name}
    help=${places ? `${facts.help} ${facts.origin}` : facts.help} place=${facts.name} options=${facts.options}
    numeric=${facts.kind === "number"} type=${facts.secret ? "password" : "text"} placeholder=${facts.placeholder} ...${more} />`;

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
