// The report: draws graphs and the map into their places; texts and tables are there already.

import { unpacked } from "/packed.js";
import { Plot, aligned } from "/plot.js";
import { ReportMap } from "/report_map.js";
import { ThemeButton } from "/theme_colors.js";
import { Component, html, render, useMemo } from "/ui.js";

const data = JSON.parse(document.getElementById("data").textContent);

/** A part that fails leaves the others alone, and its place says so. */
class Part extends Component {
  componentDidCatch(error) {
    this.setState({ error });
  }

  render({ children }, { error }) {
    return error
      ? html`<p role="alert">This browser cannot show it: ${String(error)}</p>`
      : children;
  }
}

function Graph({ graph }) {
  const columns = useMemo(
    () => aligned(graph.series.map(({ x, y }) => ({ x: unpacked(x), y: unpacked(y) }))),
    [graph],
  );
  const series = graph.series.map(({ x, y, ...look }) => look);
  return html`<${Plot} ...${graph} series=${series} data=${columns} />`;
}

async function copy(code) {
  try {
    await navigator.clipboard.writeText(code.textContent);
    return true;
  } catch {
    // Pages from a disk may not have a clipboard: the old way copies what is selected.
    getSelection().selectAllChildren(code);
    return document.execCommand("copy");
  }
}

/** @param {HTMLButtonElement} button beside a command */
function startCopying(button) {
  button.hidden = false;
  button.addEventListener("click", async () => {
    const done = await copy(button.parentElement.querySelector("code"));
    button.textContent = done ? "Copied" : "Select and copy";
    setTimeout(() => {
      button.textContent = "Copy";
    }, 2000);
  });
}

async function start() {
  const show = (place, part) => render(html`<${Part}>${part}<//>`, place);
  show(document.getElementById("themes"), html`<${ThemeButton} />`);
  document.querySelectorAll("button[data-copy]").forEach(startCopying);
  const map = document.getElementById("map");
  if (map) show(map, html`<${ReportMap} map=${data.map} />`);
  for (const place of /** @type {NodeListOf<HTMLElement>} */ (
    document.querySelectorAll("[data-graph]")
  )) {
    show(place, html`<${Graph} graph=${data.graphs[place.dataset.graph]} />`);
    await new Promise((next) => setTimeout(next)); // the page can be read meanwhile
  }
}
start();
