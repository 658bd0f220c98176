// Elements, numbers with units, and the few controls that all pages use.

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

/** A number with digits behind the point; a dash for nothing. */
export function number(value, digits = 0, unit = "") {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const text = Number(value).toLocaleString("en", {
    minimumFractionDigits: digits,
    maximumFractionDigits: digits,
  });
  return unit ? `${text} ${unit}` : text;
}

/** Seconds as "1 h 02 min", "3 min 20 s" or "12 s". */
export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const whole = Math.round(seconds),
    hours = Math.floor(whole / 3600),
    minutes = Math.floor(whole / 60) % 60;
  if (hours) return `${hours} h ${String(minutes).padStart(2, "0")} min`;
  return minutes ? `${minutes} min ${String(whole % 60).padStart(2, "0")} s` : `${whole} s`;
}

/** The name of an evaluation, fourteen digits of its local time, as a time; other names stay as they are. */
export function stampText(stamp) {
  const found = /^(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)(\d\d)$/.exec(stamp);
  return found ? `${found[1]}-${found[2]}-${found[3]} ${found[4]}:${found[5]}:${found[6]}` : stamp;
}

/** A lap time as the console writes it: MM:SS.mmm. */
export function lapTime(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const ms = Math.round(seconds * 1000);
  const pad = (value, width) => String(value).padStart(width, "0");
  return `${pad(Math.floor(ms / 60000), 2)}:${pad(Math.floor(ms / 1000) % 60, 2)}.${pad(ms % 1000, 3)}`;
}

/** Resets after another text: ", 1 reset", ", 2 resets", or nothing. */
export const andResets = (count) => (count ? `, ${count} reset${count === 1 ? "" : "s"}` : "");

/** Bytes as MB or GB. */
export function bytes(value) {
  if (value === null || value === undefined) return "–";
  if (value >= 1e9) return number(value / 1e9, 1, "GB");
  if (value >= 1e6) return number(value / 1e6, 1, "MB");
  return number(value / 1e3, 0, "kB");
}

/** A date and time of this machine, from Unix seconds. */
export function moment(unix) {
  return unix
    ? new Date(unix * 1000).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" })
    : "–";
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

/** Ask before something that cannot be undone; resolves to whether it was confirmed. */
export function confirmed(question, { action, detail = "" }) {
  return new Promise((resolve) => {
    const dialog = h(
      "dialog",
      { "aria-labelledby": "question" },
      h(
        "form",
        { method: "dialog" },
        h("h2", { id: "question" }, question),
        detail ? h("p", {}, detail) : null,
        h(
          "p",
          { class: "actions" },
          h("button", { value: "no", autofocus: true }, "Cancel"),
          h("button", { value: "yes", class: "danger" }, action),
        ),
      ),
    );
    dialog.addEventListener("close", () => {
      resolve(dialog.returnValue === "yes");
      dialog.remove();
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

const notices = document.getElementById("notices");

/** A notice that stays until it is closed; a good one leaves after some seconds. */
export function notify(text, kind = "good", remedy = "") {
  const note = h(
    "div",
    { class: `notice ${kind}` },
    h("p", {}, text, remedy ? h("span", { class: "remedy" }, ` ${remedy}`) : null),
    h(
      "button",
      {
        type: "button",
        class: "plain",
        "aria-label": "Close this notice",
        click: () => note.remove(),
      },
      "×",
    ),
  );
  notices.append(note);
  if (kind === "good") setTimeout(() => note.remove(), 8000);
}
