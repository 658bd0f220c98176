// Elements without Preact, for the pages that are not components yet.

import { confirmed } from "/dialogs.js";
import { notify } from "/notices.js";

export * from "/text.js";
export { confirmed, notify };

/** An element; attributes that are functions become listeners, null and false are left out. */
export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (typeof value === "function") element.addEventListener(name, value);
    else if (name === "value") element.value = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(
    ...children.flat(9).filter((child) => child !== null && child !== undefined && child !== false),
  );
  return element;
}

/** Show these children instead of the present ones. */
export function fill(element, ...children) {
  element.replaceChildren(
    ...children.flat(9).filter((child) => child !== null && child !== undefined && child !== false),
  );
  return element;
}

/** The same for buttons: the focus stays on them, on the same one or else on the first, if it was there. */
export function fillButtons(element, ...children) {
  const focused = element.contains(document.activeElement) ? document.activeElement : null;
  fill(element, ...children);
  if (!focused || document.activeElement === focused) return;
  const next = element.contains(focused)
    ? focused
    : element.querySelector("button:not(:disabled), a[href]");
  (next ?? document.getElementById("main")).focus({ preventScroll: true });
}

/** A short sentence where there is nothing yet, and what to do next. */
export function empty(sentence, ...next) {
  return h(
    "div",
    { class: "empty" },
    h("p", {}, sentence),
    next.length ? h("p", { class: "actions" }, next) : null,
  );
}

/** Text in which words in backticks are code. */
export const prose = (text) =>
  text.split("`").map((piece, k) => (k % 2 ? h("code", {}, piece) : piece));

/** A sentence about something that failed, with its remedy. */
export function failure(error) {
  return h(
    "div",
    { class: "problem", role: "alert" },
    h("p", {}, prose(error.message)),
    error.remedy ? h("p", { class: "remedy" }, prose(error.remedy)) : null,
  );
}

/** A table with a caption; cells are texts, numbers (right-aligned) or elements. */
export function table(caption, heads, rows) {
  const cell = (value) =>
    h("td", { class: typeof value === "number" ? "number" : null }, value ?? "–");
  return h(
    "div",
    { class: "scroll", tabindex: "0", role: "region", "aria-label": caption },
    h(
      "table",
      {},
      h("caption", {}, caption),
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          heads.map((head) => h("th", { scope: "col" }, head)),
        ),
      ),
      h(
        "tbody",
        {},
        rows.map((row) => h("tr", {}, row.map(cell))),
      ),
    ),
  );
}

/** Name and value pairs as tiles; returns the element, and a function that sets the values. */
export function tiles(names) {
  const values = names.map(() => h("dd", {}, "–"));
  const element = h(
    "dl",
    { class: "tiles" },
    names.map((name, k) => h("div", {}, h("dt", {}, name), values[k])),
  );
  return [
    element,
    (texts) =>
      texts.forEach((text, k) => {
        if (values[k].textContent !== text) values[k].textContent = text;
      }),
  ];
}
