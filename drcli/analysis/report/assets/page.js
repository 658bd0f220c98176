// What all parts of the page share: the numbers, colours, the theme, copying of commands.

const data = JSON.parse(document.getElementById("data").textContent);
const redraws = []; // functions to call when the colours change

/** Numbers as Python packed them; missing ones are NaN. */
function unpack(packed) {
  if (Array.isArray(packed)) {
    return Float64Array.from(packed, (value) => (value === null ? NaN : value));
  }
  const kind = ["f32", "i16", "i8"].find((name) => name in packed);
  const text = atob(packed[kind]);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  if (kind === "f32") return new Float32Array(bytes.buffer);
  const integers = kind === "i16" ? new Int16Array(bytes.buffer) : new Int8Array(bytes.buffer);
  const missing = kind === "i16" ? -32768 : -128;
  return Float32Array.from(integers, (value) =>
    value === missing ? NaN : packed.middle + value * packed.step,
  );
}

/** A colour of the present theme, such as "--ink". */
function color(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** A number as a person reads it: with so many decimals, or with about four digits. */
function shown(value, decimals) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (decimals !== undefined && decimals !== null) {
    return value.toFixed(decimals).replace(/^-(0(\.0+)?)$/, "$1"); // no minus before a zero
  }
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e6 || size < 1e-3)) return value.toExponential(2);
  return String(Number(value.toPrecision(size >= 1000 ? 6 : 4)));
}

/** An element with attributes and children; children that are strings become text. */
function make(name, attributes, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes || {})) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

/** Runs a part; one that fails leaves the others alone, and its place says so. */
function attempt(place, start) {
  try {
    start();
  } catch (error) {
    place.append(make("p", { role: "alert" }, `This browser cannot show it: ${error}`));
  }
}

function startTheme() {
  const button = document.getElementById("theme");
  const system = matchMedia("(prefers-color-scheme: dark)");
  let chosen = null;
  const apply = () => {
    const dark = chosen === null ? system.matches : chosen === "dark";
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    button.textContent = dark ? "Light" : "Dark";
    button.setAttribute("aria-label", dark ? "Switch to light colours" : "Switch to dark colours");
    for (const redraw of redraws) redraw();
  };
  button.hidden = false;
  button.addEventListener("click", () => {
    chosen = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    apply();
  });
  system.addEventListener("change", apply);
  apply();
}

async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    // Pages from a disk may not have a clipboard: the old way needs a selection.
    const area = make("textarea", { "aria-hidden": "true", class: "unseen" });
    area.value = text;
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  }
}

function startCopyButtons() {
  for (const button of document.querySelectorAll("button[data-copy]")) {
    button.hidden = false;
    button.addEventListener("click", async () => {
      const text = button.parentElement.querySelector("code").textContent;
      button.textContent = (await copyText(text)) ? "Copied" : "Select and copy";
      button.focus();
      setTimeout(() => {
        button.textContent = "Copy";
      }, 2000);
    });
  }
}
