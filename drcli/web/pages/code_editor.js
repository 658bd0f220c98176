// A plain editor for Python: line numbers, marks at lines with problems, Tab that Escape lets go.

import { fill, h } from "/dom.js";

const INDENT = "    ";

/**
 * An editor around a textarea.
 * @param {{label: string, describedBy?: string, change: function(string): void}} options
 * @returns {{element: HTMLElement, area: HTMLTextAreaElement, text: string, goTo: function(number): void, mark: function(Object[]): void}}
 */
export function codeEditor({ label, change }) {
  const area = h("textarea", {
    class: "code-area",
    wrap: "off",
    spellcheck: "false",
    autocapitalize: "off",
    autocomplete: "off",
    "aria-label": label,
    "aria-describedby": "code-keys",
  });
  const gutter = h("div", { class: "code-gutter", "aria-hidden": "true" });
  const bands = h("div", { class: "code-bands", "aria-hidden": "true" });
  const place = h("p", { class: "readout", role: "status" });
  const element = h(
    "div",
    { class: "code" },
    h("div", { class: "code-frame" }, gutter, h("div", { class: "code-body" }, bands, area)),
    h(
      "p",
      { class: "help", id: "code-keys" },
      "Tab indents, Shift+Tab takes it back. To leave the editor with Tab, press Escape first.",
    ),
    place,
  );
  let marks = new Map(),
    lines = 0,
    free = false;

  const lineHeight = () => parseFloat(getComputedStyle(area).lineHeight);
  const lineAt = (offset) => area.value.slice(0, offset).split("\n").length;

  function drawLines() {
    const count = area.value.split("\n").length;
    if (count !== lines) lines = count;
    fill(
      gutter,
      Array.from({ length: lines }, (_, k) => {
        const mark = marks.get(k + 1);
        return h(
          "div",
          { class: mark ? `code-line ${mark.severity}` : "code-line", title: mark?.message },
          String(k + 1),
        );
      }),
    );
    const height = lineHeight();
    fill(
      bands,
      [...marks]
        .filter(([line]) => line <= lines)
        .map(([line, mark]) => {
          const band = h("div", { class: `code-band ${mark.severity}` });
          band.style.setProperty("top", `${(line - 1) * height}px`);
          return band;
        }),
    );
    scroll();
  }
  function scroll() {
    gutter.style.setProperty("transform", `translateY(${-area.scrollTop}px)`);
    bands.style.setProperty("transform", `translateY(${-area.scrollTop}px)`);
  }
  function tell() {
    const line = lineAt(area.selectionStart),
      mark = marks.get(line);
    place.textContent = mark
      ? `Line ${line}: ${mark.message}`
      : `The cursor is in line ${line}; the file has ${lines}.`;
  }
  function insert(text) {
    // As typed, so that it can be undone.
    if (!document.execCommand("insertText", false, text))
      area.setRangeText(text, area.selectionStart, area.selectionEnd, "end");
  }
  function shift(back) {
    const start = area.value.lastIndexOf("\n", area.selectionStart - 1) + 1;
    let end = area.value.indexOf("\n", Math.max(area.selectionEnd - 1, area.selectionStart));
    if (end < 0) end = area.value.length;
    const block = area.value.slice(start, end);
    const moved = block
      .split("\n")
      .map((line) => (back ? line.replace(/^( {1,4}|\t)/, "") : line && INDENT + line))
      .join("\n");
    area.setSelectionRange(start, end);
    insert(moved);
    area.setSelectionRange(start, start + moved.length);
  }
  area.addEventListener("keydown", (event) => {
    if (event.key === "Escape") {
      free = true;
      place.textContent = "Tab now leaves the editor.";
      return;
    }
    if (event.key === "Tab" && !free) {
      event.preventDefault();
      const several = area.value.slice(area.selectionStart, area.selectionEnd).includes("\n");
      if (event.shiftKey || several) shift(event.shiftKey);
      else {
        const column =
          area.selectionStart - area.value.lastIndexOf("\n", area.selectionStart - 1) - 1;
        insert(INDENT.slice(column % 4));
      }
    } else if (event.key === "Enter" && !event.ctrlKey && !event.metaKey && !event.isComposing) {
      event.preventDefault();
      const line = area.value.slice(
        area.value.lastIndexOf("\n", area.selectionStart - 1) + 1,
        area.selectionStart,
      );
      insert("\n" + /^[ \t]*/.exec(line)[0] + (line.trimEnd().endsWith(":") ? INDENT : ""));
    }
    if (event.key !== "Tab" && event.key !== "Shift") free = false;
  });
  area.addEventListener("focus", () => {
    free = false;
  });
  area.addEventListener("input", () => {
    drawLines();
    change(area.value);
  });
  area.addEventListener("scroll", scroll);
  for (const name of ["keyup", "click", "focus"]) area.addEventListener(name, tell);

  return {
    element,
    area,
    get text() {
      return area.value;
    },
    set text(value) {
      area.value = value;
      drawLines();
    },
    /** Put the cursor at the begin of a line, and show it. */
    goTo(line) {
      const all = area.value.split("\n"),
        at = Math.min(Math.max(line ?? 1, 1), all.length);
      const offset = all.slice(0, at - 1).reduce((sum, each) => sum + each.length + 1, 0);
      area.focus();
      area.setSelectionRange(offset, offset + all[at - 1].length);
      area.scrollTop = Math.max(0, (at - 5) * lineHeight());
      element.scrollIntoView({ block: "center" });
      tell();
    },
    /** Problems with lines, without notes; an error counts more than a warning. */
    mark(problems) {
      marks = new Map();
      for (const each of problems)
        if (each.line && each.severity !== "note" && marks.get(each.line)?.severity !== "error")
          marks.set(each.line, each);
      drawLines();
      if (document.activeElement === area) tell();
    },
  };
}
