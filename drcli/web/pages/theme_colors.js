// Dark or light, and the colours of colors.css for what is drawn on a canvas.

import { html, signal } from "/vendor/preact/preact.js";

const root = document.documentElement;

/** "dark" or "light"; theme.js has set it before the page was drawn, and follows the system. */
export const theme = signal(root.dataset.theme);
new MutationObserver(() => {
  theme.value = root.dataset.theme;
}).observe(root, { attributeFilter: ["data-theme"] });

/** The colour of a token, such as "c1", in the present theme. */
export const ink = (token) => getComputedStyle(root).getPropertyValue(`--${token}`).trim();

/** Switches between dark and light. */
export function ThemeButton() {
  const other = theme.value === "dark" ? "light" : "dark";
  const change = () => {
    root.dataset.theme = other;
    try {
      localStorage.setItem("dr-theme", other);
    } catch {
      /* storage is switched off */
    }
  };
  return html`<button id="theme" type="button" class="plain" aria-label="Dark or light" onClick=${change}>
    ${other === "dark" ? "Dark" : "Light"}
  </button>`;
}
