// Components that all pages use.

import { mendLink } from "/mend.js";
import { html, useEffect, useRef, useState } from "/vendor/preact/preact.js";

export * from "/vendor/preact/preact.js";

let ids = 0;
/** An id of its own for an element; Preact's begin again in each dialog. */
export const useId = () => useState(() => `id-${(ids += 1)}`)[0];

/** The name of the window, once it is known. */
export const useTitle = (text) =>
  useEffect(() => {
    if (text) document.title = text;
  }, [text]);

/** Text in which words in backticks are code. */
export const Prose = ({ text }) =>
  String(text ?? "")
    .split("`")
    .map((piece, k) => (k % 2 ? html`<code>${piece}</code>` : piece));

/** A sentence, what to do, and a link to where. */
export const Told = ({ text, remedy = "", link = null }) => html`
  <${Prose} text=${text} />
  ${remedy && html` <span class="remedy"><${Prose} text=${remedy} /></span>`}
  ${link && html` <a href=${link.href}>${link.text}</a>`}`;

/** Something that failed, with its remedy, and a link to where it can be mended in the page. */
export function Failure({ error }) {
  const [first] = error.problems ?? [];
  const link =
    mendLink(`${first?.where ?? ""} ${first?.key ?? ""} ${error.message}`) ??
    mendLink(error.remedy ?? "");
  return html`
    <div class="problem" role="alert">
      <p><${Prose} text=${error.message} /></p>
      ${error.remedy && html`<p class="remedy"><${Prose} text=${error.remedy} /></p>`}
      ${link && link.href !== location.hash && html`<p><a class="button" href=${link.href}>${link.text}</a></p>`}
    </div>`;
}

/** A sentence where there is nothing yet, and what to do next. */
export const Empty = ({ text, children = null }) => html`
  <div class="empty">
    <p><${Prose} text=${text} /></p>
    ${children && html`<p class="actions">${children}</p>`}
  </div>`;

/** Names and values as tiles. @param {{values: [string, any][]}} props */
export const Tiles = ({ values }) => html`
  <dl class="tiles">
    ${values.map(([name, value]) => html`<div key=${name}><dt>${name}</dt><dd>${value ?? "–"}</dd></div>`)}
  </dl>`;

/** A button that stays where it is while its action runs, so that it keeps the focus. */
export const Button = ({
  busy = false,
  onClick = null,
  children,
  class: kind = null,
  ...more
}) => html`
  <button type="button" class=${kind} aria-disabled=${busy ? "true" : null}
    onClick=${(event) => !busy && onClick?.(event)} ...${more}>${children}</button>`;

/** A form whose values the page sends itself, by its button and by Enter. */
export function Form({ onSubmit, children, ...more }) {
  const submit = (event) => {
    event.preventDefault();
    onSubmit();
  };
  return html`<form onSubmit=${submit} ...${more}>${children}</form>`;
}

/** @typedef {(string | [string, any])[]} Options of a choice: a text, a value and its text, or a name and the options of its group */

/** What a `select` has. @param {{options: Options}} props */
export const Options = ({ options }) =>
  options.map((each) => {
    const [key, text] = Array.isArray(each) ? each : [each, each];
    return Array.isArray(text)
      ? html`<optgroup key=${key} label=${key}><${Options} options=${text} /></optgroup>`
      : html`<option key=${key} value=${key}>${text}</option>`;
  });

/** A choice in a line. @param {{label: any, options: Options, value: string, onChange: (value: string) => void} & Record<string, any>} props */
export const Choice = ({ label, options, value, onChange, ...more }) => html`
  <label class="choice"><span>${label}</span>
    <select value=${value} onChange=${(event) => onChange(event.currentTarget.value)} ...${more}>
      <${Options} options=${options} />
    </select>
  </label>`;

/** A check box. @param {{label: any, on: boolean, set: (on: boolean) => void} & Record<string, any>} props */
export const Tick = ({ label, on, set, ...more }) => html`
  <label class="form-check"><input type="checkbox" checked=${on}
    onChange=${(event) => set(event.currentTarget.checked)} ...${more} /> ${label}</label>`;

/** What was asked for, as soon as it is there. @param {{found: {value: any, error: any}, reading?: string, children: (value: any) => any}} props */
export function Loaded({ found: { value, error }, reading = "", children }) {
  if (error) return html`<${Failure} error=${error} />`;
  return value ? children(value) : html`<p class="quiet" role="status">${reading}</p>`;
}

/** A part that is folded until somebody opens it; what is in it is made then. */
export const Folded = ({ title, open, onToggle, children }) => html`
  <details class="folded" open=${open} onToggle=${(event) => onToggle(event.currentTarget.open)}>
    <summary>${title}</summary>
    ${open && children}
  </details>`;

/** Calls with whether an element can be seen. */
export function useSeen(listener) {
  const place = useRef(null);
  useEffect(() => {
    const watcher = new IntersectionObserver((entries) => listener(entries.at(-1).isIntersecting), {
      rootMargin: "80px",
    });
    watcher.observe(place.current);
    return () => watcher.disconnect();
  }, []);
  return place;
}

/** A table with a caption; cells are texts, numbers (right-aligned) or elements. @param {{caption: string, heads: any[], rows: any[][]}} props */
export const Table = ({ heads, ...more }) => html`
  <${Columns} columns=${heads.map((name, k) => [name, (row) => row[k]])} ...${more} />`;

/**
 * A table of things, which a style may make a list on a small screen.
 * @param {{caption?: any, label?: string, columns: any[][], rows: any[], kind?: string,
 *   keyOf?: (thing: any, k: number) => any, kindOf?: (thing: any) => string | null, header?: number, sorted?: Record<string, string>}} props
 *   A column has a name, the cell of a thing, and a class; that of number `header` names its thing;
 *   `sorted` has the direction of a column by its name
 */
export function Columns({ caption = "", label = caption, columns, rows, kind = null, ...more }) {
  const { keyOf = (_, k) => k, kindOf = () => null, header = -1, sorted = {} } = more;
  const cell = (thing, /** @type {any[]} */ [name, content, style], k) => {
    const value = content(thing);
    if (k === header) return html`<th key=${k} scope="row" role="rowheader">${value}</th>`;
    const number = typeof value === "number" ? "number" : null;
    return html`<td key=${k} role="cell" class=${style ?? number} data-label=${name}><span>${value ?? "–"}</span></td>`;
  };
  return html`
    <div class="scroll" tabindex="0" role="region" aria-label=${label}>
      <table class=${kind} role="table">
        ${caption && html`<caption>${caption}</caption>`}
        <thead role="rowgroup"><tr role="row">${columns.map(([name, , style, head]) => html`<th key=${name} scope="col" role="columnheader" class=${style} aria-sort=${sorted[name]}>${head ?? name}</th>`)}</tr></thead>
        <tbody role="rowgroup">${rows.map((thing, at) => html`<tr key=${keyOf(thing, at)} role="row" class=${kindOf(thing)}>${columns.map((each, k) => cell(thing, each, k))}</tr>`)}</tbody>
      </table>
    </div>`;
}

/**
 * Tabs by the pattern of the ARIA guide: arrow keys move, the panel is shown at once.
 * @param {{label: string, parts: [string, string, () => any][], chosen: string, onChoose: (key: string) => void}} props
 */
export function Tabs({ label, parts, chosen, onChoose }) {
  const list = useRef(null);
  const keys = parts.map(([key]) => key);
  const at = Math.max(0, keys.indexOf(chosen));
  const last = keys.length - 1;
  useEffect(() => {
    // On a phone, the chosen one may be further to the right.
    list.current.scrollLeft = list.current.children[at].offsetLeft - list.current.offsetLeft - 40;
  }, [at]);
  const move = (event) => {
    const [before, after] = [at ? at - 1 : last, at === last ? 0 : at + 1];
    const next = { ArrowRight: after, ArrowLeft: before, Home: 0, End: last }[event.key];
    if (next === undefined) return;
    event.preventDefault();
    onChoose(keys[next]);
    list.current.children[next].focus();
  };
  const tab = (/** @type {any[]} */ [key, text], k) => html`
    <button type="button" role="tab" class="part-tab" key=${key} id=${`tab-${key}`} aria-controls="panel"
      aria-selected=${String(k === at)} tabindex=${k === at ? 0 : -1} onClick=${() => onChoose(key)}>${text}</button>`;
  return html`
    <div class="part-tabs" role="tablist" aria-label=${label} ref=${list} onKeyDown=${move}>${parts.map(tab)}</div>
    <div class="part-panel" role="tabpanel" tabindex="0" id="panel" aria-labelledby=${`tab-${keys[at]}`} key=${keys[at]}>${parts[at][2]()}</div>`;
}
