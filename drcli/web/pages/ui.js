// Components that all pages use.

import { mendLink } from "/mend.js";
import { html, useEffect, useRef, useState } from "/vendor/preact/preact.js";

export * from "/vendor/preact/preact.js";

let ids = 0;
/** An id of its own for an element; Preact's begin again in each dialog. */
export const useId = () => useState(() => `id-${(ids += 1)}`)[0];

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
export const Button = ({ busy = false, onClick, children, class: kind = null, ...more }) => html`
  <button type="button" class=${kind} aria-disabled=${busy ? "true" : null}
    onClick=${(event) => !busy && onClick(event)} ...${more}>${children}</button>`;

/** A labelled choice. @param {{label: string, options: (string | string[])[], value: string, onChange: (value: string) => void}} props */
export const Choice = ({ label, options, value, onChange, ...more }) => html`
  <label class="choice"><span>${label}</span>
    <select value=${value} onChange=${(event) => onChange(event.currentTarget.value)} ...${more}>
      ${options.map((each) => {
        const [key, text] = Array.isArray(each) ? each : [each, each];
        return html`<option key=${key} value=${key}>${text}</option>`;
      })}
    </select>
  </label>`;

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
export const Table = ({ caption, heads, rows }) => html`
  <div class="scroll" tabindex="0" role="region" aria-label=${caption}>
    <table>
      <caption>${caption}</caption>
      <thead><tr>${heads.map((head) => html`<th scope="col">${head}</th>`)}</tr></thead>
      <tbody>${rows.map((row) => html`<tr>${row.map((cell) => html`<td class=${typeof cell === "number" ? "number" : null}>${cell ?? "–"}</td>`)}</tr>`)}</tbody>
    </table>
  </div>`;

/**
 * Tabs by the pattern of the ARIA guide: arrow keys move, the panel is shown at once.
 * @param {{label: string, parts: [string, string, () => any][], chosen: string, onChoose: (key: string) => void}} props
 */
export function Tabs({ label, parts, chosen, onChoose }) {
  const list = useRef(null);
  const at = Math.max(
    0,
    parts.findIndex(([key]) => key === chosen),
  );
  const [key, , content] = parts[at];
  useEffect(() => {
    // On a phone, the chosen one may be further to the right.
    list.current.scrollLeft = list.current.children[at].offsetLeft - list.current.offsetLeft - 40;
  }, [at]);
  const move = (event) => {
    const last = parts.length - 1;
    const next = {
      ArrowRight: at === last ? 0 : at + 1,
      ArrowLeft: at ? at - 1 : last,
      Home: 0,
      End: last,
    }[event.key];
    if (next === undefined) return;
    event.preventDefault();
    onChoose(parts[next][0]);
    list.current.children[next].focus();
  };
  return html`
    <div class="part-tabs" role="tablist" aria-label=${label} ref=${list} onKeyDown=${move}>
      ${parts.map(
        (
          [each, text],
          k,
        ) => html`<button type="button" role="tab" class="part-tab" key=${each} id=${`tab-${each}`} aria-controls="panel"
        aria-selected=${String(k === at)} tabindex=${k === at ? 0 : -1} onClick=${() => onChoose(each)}>${text}</button>`,
      )}
    </div>
    <div class="part-panel" role="tabpanel" tabindex="0" id="panel" aria-labelledby=${`tab-${key}`} key=${key}>${content()}</div>`;
}
