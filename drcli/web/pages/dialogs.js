// Questions in a dialog of the browser, so that keyboard and screen reader know it; leaving the page closes it.

import { html, render } from "/vendor/preact/preact.js";

/**
 * Show a dialog until it is closed.
 * @param {(close: (value: any) => void) => any} content
 * @param {{label: string, wide?: boolean}} options label: id of its heading
 * @returns {Promise<any>} what it was closed with; null if it was left
 */
export function dialog(content, { label, wide = false }) {
  return new Promise((resolve) => {
    const element = document.createElement("dialog");
    element.className = wide ? "wide" : "";
    element.setAttribute("aria-labelledby", label);
    let value = null;
    const close = (given) => {
      value = given;
      element.close();
    };
    const leave = () => element.close();
    element.addEventListener("close", () => {
      removeEventListener("hashchange", leave);
      render(null, element);
      element.remove();
      resolve(value);
    });
    // What was sent will be answered.
    element.addEventListener("cancel", (event) => {
      if (element.querySelector("[aria-busy=true]")) event.preventDefault();
    });
    addEventListener("hashchange", leave);
    document.body.append(element);
    render(content(close), element);
    element.showModal();
  });
}

/** Show something until it is closed. */
export const show = (title, content) =>
  dialog(
    (close) => html`
      <h2 id="shown">${title}</h2>
      ${content}
      <p class="actions"><button type="button" autofocus onClick=${() => close(null)}>Close</button></p>`,
    { label: "shown", wide: true },
  );
