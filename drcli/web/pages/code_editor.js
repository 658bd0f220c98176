// A plain editor for Python: line numbers, marks at lines with problems, Tab that Escape lets go.

import { wantedLine } from "/fields.js";
import { html, useLayoutEffect, useRef, useState } from "/ui.js";

const INDENT = "    ";
const LINE_PX = 20; // as in new.css

/** Insert as if it was typed, so that it can be undone. */
function type(area, text) {
  if (!document.execCommand("insertText", false, text))
    area.setRangeText(text, area.selectionStart, area.selectionEnd, "end");
}

const lineStart = ({ value, selectionStart }) => value.lastIndexOf("\n", selectionStart - 1) + 1;

/** Indent the chosen lines, or take it back. */
function shift(area, back) {
  const start = lineStart(area);
  const { value, selectionStart, selectionEnd } = area;
  const end = value.indexOf("\n", Math.max(selectionEnd - 1, selectionStart));
  const lines = value.slice(start, end < 0 ? value.length : end).split("\n");
  const moved = lines
    .map((line) => (back ? line.replace(/^( {1,4}|\t)/, "") : line && INDENT + line))
    .join("\n");
  area.setSelectionRange(start, end < 0 ? value.length : end);
  type(area, moved);
  area.setSelectionRange(start, start + moved.length);
}

function indent(area, back) {
  const { value, selectionStart, selectionEnd } = area;
  if (back || value.slice(selectionStart, selectionEnd).includes("\n")) shift(area, back);
  else type(area, INDENT.slice((selectionStart - lineStart(area)) % 4));
}

function newLine(area) {
  const line = area.value.slice(lineStart(area), area.selectionStart);
  type(area, `\n${/^[ \t]*/.exec(line)[0]}${line.trimEnd().endsWith(":") ? INDENT : ""}`);
}

/** Replace everything, so that it can be undone. */
export function replaceText(area, text) {
  area.focus();
  area.select();
  type(area, text);
}

/**
 * @param {{label: string, text: string, onInput: (text: string) => void, problems: Object[], area: {current: any}}} props
 *   `area` gets the textarea; problems have lines
 */
export function CodeEditor({ label, text, onInput, problems, area }) {
  const [scrolled, setScrolled] = useState(0);
  const [at, setAt] = useState(1);
  const [free, setFree] = useState(false);
  const frame = useRef(null);
  const lines = text.split("\n");
  const marks = new Map();
  // An error counts more than a warning, and notes mark nothing.
  for (const each of problems)
    if (each.line && each.severity !== "note" && marks.get(each.line)?.severity !== "error")
      marks.set(each.line, each);

  const wanted = wantedLine.value;
  useLayoutEffect(() => {
    if (!wanted.times) return;
    const line = Math.min(Math.max(wanted.line, 1), lines.length);
    const offset = lines.slice(0, line - 1).reduce((sum, each) => sum + each.length + 1, 0);
    area.current.focus();
    area.current.setSelectionRange(offset, offset + lines[line - 1].length);
    area.current.scrollTop = Math.max(0, (line - 5) * LINE_PX);
    frame.current.scrollIntoView({ block: "center" });
    setAt(line);
  }, [wanted.times]);

  const onKey = (event) => {
    const { key } = event;
    const isEnter = key === "Enter" && !event.ctrlKey && !event.metaKey && !event.isComposing;
    const does = { Tab: !free && indent, Enter: isEnter && newLine }[key];
    if (does) {
      event.preventDefault();
      does(event.currentTarget, event.shiftKey);
    }
    if (key === "Escape") setFree(true);
    else if (key !== "Tab" && key !== "Shift") setFree(false);
  };
  const tell = ({ currentTarget }) =>
    setAt(currentTarget.value.slice(0, currentTarget.selectionStart).split("\n").length);
  const enter = (event) => {
    setFree(false);
    tell(event);
  };
  const mark = marks.get(at);
  const place = mark
    ? `Line ${at}: ${mark.message}`
    : `The cursor is in line ${at}; the file has ${lines.length}.`;
  const moved = { transform: `translateY(${-scrolled}px)` };
  return html`
    <div class="code" ref=${frame}>
      <div class="code-frame">
        <div class="code-gutter" aria-hidden="true" style=${moved}>${lines.map((_, k) => {
          const found = marks.get(k + 1);
          return html`<div key=${k} class=${`code-line ${found?.severity ?? ""}`} title=${found?.message}>${k + 1}</div>`;
        })}</div>
        <div class="code-body">
          <div class="code-bands" aria-hidden="true" style=${moved}>${[...marks]
            .filter(([line]) => line <= lines.length)
            .map(
              ([line, { severity }]) =>
                html`<div key=${line} class=${`code-band ${severity}`} style=${{ top: `${(line - 1) * LINE_PX}px` }}></div>`,
            )}
          </div>
          <textarea class="code-area" ref=${area} wrap="off" spellcheck=${false} autocapitalize="off" autocomplete="off"
            aria-label=${label} aria-describedby="code-keys" value=${text} onInput=${(event) => onInput(event.currentTarget.value)}
            onKeyDown=${onKey} onFocus=${enter} onKeyUp=${tell} onClick=${tell}
            onScroll=${(event) => setScrolled(event.currentTarget.scrollTop)}></textarea>
        </div>
      </div>
      <p class="help" id="code-keys">Tab indents, Shift+Tab takes it back. To leave the editor with Tab, press Escape first.</p>
      <p class="readout" role="status">${free ? "Tab now leaves the editor." : place}</p>
    </div>`;
}
