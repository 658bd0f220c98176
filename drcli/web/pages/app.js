// The frame of the console: pages by the part of the address after #, connection, tasks, theme, notices.

import { clearNotices, dismiss, notices, notify } from "/notices.js";
import { mendLink } from "/mend.js";
import { connected, follow } from "/socket.js";
import { route, useGet } from "/store.js";
import { ThemeButton } from "/theme_colors.js";
import { Empty, Failure, Told, html, render, signal, useEffect, useState } from "/ui.js";

const PAGES = [
  { path: "/", name: "Live", module: "/live_page.js" },
  { path: "/new", name: "New training", module: "/new_page.js" },
  { path: "/models", name: "Models", module: "/models_page.js" },
  { path: "/play", name: "Episodes", module: "/player_page.js" },
  { path: "/races", name: "Races", module: "/races_page.js" },
  { path: "/spot", name: "Spot", module: "/spot_page.js" },
  { path: "/car", name: "Car", module: "/car_page.js" },
  { path: "/settings", name: "Settings", module: "/settings_page.js" },
];
// Pages below an entry of the menu: pattern of the path, module, path of the entry.
/** @type {[RegExp, string, string][]} */
const MORE = [
  [/^\/model$/, "/model_page.js", "/models"],
  [/^\/race\/([a-z0-9-]+)$/, "/race_page.js", "/races"],
  [/^\/night\/([a-z0-9-]+)$/, "/night_page.js", "/races"],
];
const RESTORE_MS = 3000;
const byId = (name) => document.getElementById(name);
const main = byId("main");

/** The module of a path and what its pattern found; null for an unknown path. */
function find(path) {
  const page = PAGES.find((each) => each.path === path);
  if (page) return { module: page.module, params: [] };
  for (const [pattern, module] of MORE) {
    const found = pattern.exec(path);
    if (found) return { module, params: found.slice(1) };
  }
  return null;
}

function Main() {
  const { path, query } = route.value;
  const found = find(path);
  const [loaded, setLoaded] = useState(/** @type {any} */ ({ path: null }));
  const [tries, setTries] = useState(0);
  const folder = useGet(path === "/new" ? null : "/api/new-folder");
  const page = loaded.path === path ? loaded : null;
  useEffect(() => {
    const styled = styles(path.split("/")[1] || "live");
    if (!found) return undefined;
    let here = true;
    const take = (value) => here && setLoaded({ path, ...value });
    // A module that could not be loaded is remembered as such: another address asks again.
    Promise.all([import(found.module + (tries ? `?${tries}` : "")), styled]).then(
      ([module]) => take({ module }),
      (error) => take({ error }),
    );
    return () => {
      here = false;
    };
  }, [path, tries]);
  useEffect(() => {
    if (page?.module) document.title = `${page.module.title} – DeepRacer console`;
  }, [page?.module]);
  const again = () => setTries(tries + 1);
  useEffect(() => {
    if (connected.value && page?.error) again();
  }, [connected.value]);

  if (!found) return html`<h1>There is no such page</h1><p><a href="#/">Open the live page</a></p>`;
  if (folder.value?.exists === false && path !== "/new")
    return html`
    <h1>Welcome</h1>
    <${Empty} text=${`${folder.value.directory} is not a working folder yet: it has no run.env.`}>
      <a class="button main" href="#/new">Create a working folder</a>
    <//>`;
  if (page?.error) return html`<${Broken} error=${page.error} again=${again} />`;
  // The page itself says what is wrong with a folder that cannot be read.
  if (!page || (path !== "/new" && !folder.value && !folder.error)) return null;
  const { Page: Shown } = page.module;
  return html`<${Shown} key=${path} params=${found.params} query=${query} />`;
}

const Broken = ({ error, again }) => html`
  <h1>This page cannot be shown</h1>
  <${Failure} error=${error} />
  <p><button type="button" onClick=${again}>Try again</button></p>`;

function Menu() {
  const { path } = route.value;
  const above = MORE.find(([pattern]) => pattern.test(path))?.[2];
  return html`<ul>${PAGES.map(
    (page) => html`<li key=${page.path}>
      <a href=${`#${page.path}`}
        aria-current=${page.path === path ? "page" : page.path === above ? "true" : null}>${page.name}</a>
    </li>`,
  )}</ul>`;
}

/**
 * Use the style sheets of a page only: two pages may give one class different looks, and those of others
 * need not be there before the first picture.
 * @param {string} name of the page
 * @returns {Promise<any>} when they are loaded
 */
function styles(name) {
  const links = /** @type {NodeListOf<HTMLLinkElement>} */ (
    document.querySelectorAll("link[data-pages]")
  );
  const loading = [...links].map((link) => {
    const wanted = link.dataset.pages.split(" ").includes(name);
    link.media = wanted ? "all" : "not all";
    if (!wanted || link.sheet) return null;
    return new Promise((resolve) => {
      link.addEventListener("load", resolve, { once: true });
      link.addEventListener("error", resolve, { once: true });
    });
  });
  return Promise.all(loading);
}

function Connection() {
  const [away, setAway] = useState("");
  const open = connected.value;
  useEffect(() => {
    byId("connection").classList.toggle("away", !open);
    if (open) {
      setAway("");
      return undefined;
    }
    const timer = setTimeout(
      () =>
        fetch("/api/folder").then(
          (answer) => setAway(answer.status === 401 ? "token" : "gone"),
          () => setAway("gone"),
        ),
      200,
    );
    return () => clearTimeout(timer);
  }, [open]);
  if (open) return html`<span class="dot good"></span>Connected`;
  if (!away) return null;
  return html`<span class="dot bad"></span>${
    away === "token"
      ? html`This console needs its token: open it with <code>dr console</code>, or <a href="/enter">enter the token</a>.`
      : html`No connection. The page tries again by itself; if the console was stopped, start it with <code>dr console start</code>.`
  }`;
}

const Notices = () =>
  notices.value.map(
    ({ id, text, kind, remedy, link }) => html`
      <div key=${id} class=${`notice ${kind}`}>
        <p><${Told} text=${text} remedy=${remedy} link=${link} /></p>
        <button type="button" class="plain" aria-label="Close this notice" onClick=${() => dismiss(id)}>×</button>
      </div>`,
  );

const open = signal([]);
const seen = new Map();
follow("tasks", ({ tasks: list = [] }) => {
  for (const task of list) {
    const before = seen.get(task.id);
    // The step "Start" says itself what went wrong.
    const isTold = task.kind === "start-training" && route.value.path === "/new";
    if (before && before !== task.state && task.state === "failed" && !isTold)
      notify(
        `${task.title}: ${task.error.message}`,
        "bad",
        task.error.remedy,
        mendLink(task.error.message),
      );
    if (before && before !== task.state && task.state === "done") notify(`${task.title}: done.`);
    seen.set(task.id, task.state);
  }
  open.value = list.filter((task) => task.ended === null);
  byId("tasks").hidden = !open.value.length;
});
const Tasks = () =>
  open.value.map(
    (task) => html`<p key=${task.id}><strong>${task.title}</strong> ${task.text || "…"}</p>`,
  );

byId("skip").addEventListener("click", (event) => {
  event.preventDefault(); // the part of the address after # names the page
  main.focus();
});

// A page that somebody comes back to is scrolled to where it was, as soon as it is long enough.
const scrolled = new Map();
history.scrollRestoration = "manual";
let went = false;
addEventListener("popstate", () => {
  went = true;
});
addEventListener("click", () => {
  went = false;
});
addEventListener("scrollend", () => scrolled.set(location.hash, scrollY));
addEventListener("hashchange", () => {
  clearNotices();
  scrollTo(0, 0);
  main.focus({ preventScroll: true });
  const wanted = went ? scrolled.get(location.hash) : 0;
  const until = Date.now() + RESTORE_MS;
  const restore = () => {
    if (document.documentElement.scrollHeight >= wanted + innerHeight) scrollTo(0, wanted);
    else if (Date.now() < until) requestAnimationFrame(restore);
  };
  if (wanted) restore();
});
addEventListener("keydown", (event) => {
  if (event.key === "Escape" && !document.querySelector("dialog[open]") && notices.value.length)
    dismiss(notices.value.at(-1).id);
});
render(html`<${Menu} />`, byId("pages"));
render(html`<${Connection} />`, byId("connection"));
render(html`<${ThemeButton} />`, byId("themes"));
render(html`<${Notices} />`, byId("notices"));
render(html`<${Tasks} />`, byId("tasks"));
render(html`<${Main} />`, main);
