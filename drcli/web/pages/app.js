// The frame of the console: pages by the part of the address after #, connection, tasks, theme.

import { get } from "/api.js";
import { empty, fill, h, notify } from "/dom.js";
import { follow, onConnection } from "/socket.js";

const PAGES = [
  { path: "/", name: "Live", module: "/live_page.js" },
  { path: "/new", name: "New training", module: "/new_page.js" },
  { path: "/models", name: "Models", module: "/models_page.js" },
  { path: "/play", name: "Episodes", module: "/player_page.js" },
  { path: "/races", name: "Races", module: "/races_page.js" },
  { path: "/settings", name: "Settings", module: "/settings_page.js" },
];
// Pages below an entry of the menu: pattern of the path, module, path of the entry.
const MORE = [
  [/^\/model$/, "/model_page.js", "/models"],
  [/^\/race\/([a-z0-9-]+)$/, "/race_page.js", "/races"],
  [/^\/night\/([a-z0-9-]+)$/, "/night_page.js", "/races"],
];

const main = document.getElementById("main");
let current = null;

function find(path) {
  const page = PAGES.find((each) => each.path === path);
  if (page) return [page.module, []];
  for (const [pattern, module] of MORE) {
    const found = pattern.exec(path);
    if (found) return [module, found.slice(1).map(decodeURIComponent)];
  }
  return [null, []];
}

async function show() {
  const [path, query = ""] = (location.hash.slice(1) || "/").split("?");
  current?.abort();
  const mine = (current = new AbortController());
  menu(path);
  styles(path.split("/")[1] || "live");
  let found;
  try {
    found = find(path);
  } catch {
    found = [null, []];
  }
  const [module, params] = found;
  if (!module) {
    fill(
      main,
      h("h1", {}, "There is no such page"),
      h("p", {}, h("a", { href: "#/" }, "Open the live page")),
    );
    return;
  }
  try {
    if (path !== "/new" && !(await folderExists(mine.signal))) return;
    const page = await import(module);
    if (mine.signal.aborted) return;
    document.title = `${page.title} – DeepRacer console`;
    main.replaceChildren();
    await page.show(main, params, { signal: mine.signal, query: new URLSearchParams(query) });
  } catch (error) {
    if (mine.signal.aborted || error.name === "AbortError") return;
    console.error(error);
    fill(
      main,
      h("h1", {}, "This page cannot be shown"),
      h("p", {}, error.message),
      error.remedy ? h("p", {}, error.remedy) : null,
      h("p", {}, h("button", { type: "button", click: show }, "Try again")),
    );
  }
  if (!mine.signal.aborted && mine.moved) main.focus({ preventScroll: true });
}

let known = false;
/** Whether the folder of the console has settings; otherwise the page says how to make them. */
async function folderExists(signal) {
  if (known) return true;
  const folder = await get("/api/new-folder", signal).catch((error) => {
    if (error.name === "AbortError") throw error;
    return { exists: true };
  }); // the page says what is wrong
  known = folder.exists;
  if (!known) {
    document.title = "DeepRacer console";
    fill(
      main,
      h("h1", {}, "Welcome"),
      empty(
        `${folder.directory} is not a working folder yet: it has no run.env.`,
        h("a", { class: "button main", href: "#/new" }, "Create a working folder"),
      ),
    );
  }
  return known;
}

function menu(path) {
  const above = MORE.find(([pattern]) => pattern.test(path))?.[2];
  fill(
    document.getElementById("pages"),
    h(
      "ul",
      {},
      PAGES.map((page) =>
        h(
          "li",
          {},
          h(
            "a",
            {
              href: `#${page.path}`,
              "aria-current": page.path === path ? "page" : page.path === above ? "true" : null,
            },
            page.name,
          ),
        ),
      ),
    ),
  );
}

/** Use the style sheets of a page only: two pages may give one class different looks. */
function styles(name) {
  for (const link of document.querySelectorAll("link[data-pages]"))
    link.disabled = !link.dataset.pages.split(" ").includes(name);
}

function theme() {
  const button = document.getElementById("theme"),
    root = document.documentElement;
  const label = () => {
    button.textContent = root.dataset.theme === "dark" ? "Light" : "Dark";
  };
  button.addEventListener("click", () => {
    root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
    try {
      localStorage.setItem("dr-theme", root.dataset.theme);
    } catch {
      /* storage is switched off */
    }
    label();
    dispatchEvent(new Event("themechange"));
  });
  label();
}

function connection() {
  const place = document.getElementById("connection");
  let timer = 0,
    connected = false;
  const away = async () => {
    const refused = await fetch("/api/folder").then(
      (answer) => answer.status === 401,
      () => false,
    );
    if (connected) return;
    fill(
      place,
      h("span", { class: "dot bad" }),
      refused
        ? [
            "This console needs its token: open it with ",
            h("code", {}, "dr console"),
            ", or ",
            h("a", { href: "/enter" }, "enter the token"),
            ".",
          ]
        : [
            "No connection. The page tries again by itself; if the console was stopped, start it with ",
            h("code", {}, "dr console start"),
            ".",
          ],
    );
  };
  onConnection((open) => {
    clearTimeout(timer);
    connected = open;
    place.classList.toggle("away", !open);
    if (open) fill(place, h("span", { class: "dot good" }), "Connected");
    else timer = setTimeout(away, 200);
  });
}

const seen = new Map();
function tasks() {
  const place = document.getElementById("tasks");
  follow("tasks", ({ tasks: list = [] }) => {
    for (const task of list) {
      const before = seen.get(task.id);
      if (before && before !== task.state && task.state === "failed")
        notify(`${task.title}: ${task.error.message}`, "bad", task.error.remedy);
      if (before && before !== task.state && task.state === "done") notify(`${task.title}: done.`);
      seen.set(task.id, task.state);
    }
    const open = list.filter((task) => task.ended === null);
    place.hidden = !open.length;
    fill(
      place,
      open.map((task) =>
        h("p", {}, h("strong", {}, task.title), task.text ? ` ${task.text}` : " …"),
      ),
    );
  });
}

addEventListener("hashchange", () => {
  show().then(() => {
    if (!main.contains(document.activeElement)) main.focus({ preventScroll: true });
  });
  scrollTo(0, 0);
});
theme();
connection();
tasks();
show();
