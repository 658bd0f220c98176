// What somebody has changed and not saved: kept in the browser until it is, whatever way the page is left.

import { useRef, useState } from "/ui.js";

const PREFIX = "dr-draft:";

/**
 * @typedef {Object} Draft
 * @property {Record<string, any>} edits what differs from what was saved
 * @property {any} version of the file that was edited
 * @property {number} at milliseconds
 */

/** @type {Map<string, Draft>} */
const memory = new Map(); // where the browser keeps nothing

const tab = ownTab();
/** A name that no other open tab has, and that this one keeps when it is loaded again. */
function ownTab() {
  const fresh = [...crypto.getRandomValues(new Uint32Array(2))].join("-");
  try {
    // The copy of a tab begins with the storage of the first one: its navigation says that it is not a reload.
    const [entry] = /** @type {PerformanceNavigationTiming[]} */ (
      performance.getEntriesByType("navigation")
    );
    const kept =
      entry?.type === "navigate" && window.opener ? null : sessionStorage.getItem("dr-tab");
    sessionStorage.setItem("dr-tab", kept ?? fresh);
    return kept ?? fresh;
  } catch {
    return fresh;
  }
}

const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
const keyOf = (name) => name && `${PREFIX}${name}:${tab}`;

function read(key) {
  if (memory.has(key)) return memory.get(key);
  try {
    return JSON.parse(localStorage.getItem(key) ?? "null");
  } catch {
    return null;
  }
}

/** @param {string[]} secrets names of edits that are kept as long as this tab only */
function write(key, draft, secrets = []) {
  if (!key) return;
  if (draft) memory.set(key, draft);
  else memory.delete(key);
  const open = Object.entries(draft?.edits ?? {}).filter(([name]) => !secrets.includes(name));
  try {
    if (open.length)
      localStorage.setItem(key, JSON.stringify({ ...draft, edits: Object.fromEntries(open) }));
    else localStorage.removeItem(key);
  } catch {
    /* storage is switched off or full: the draft lasts as long as this tab */
  }
}

/** Keys of drafts of this name that other tabs have left. */
function strangers(name) {
  try {
    return Object.keys(localStorage).filter(
      (key) => key.startsWith(`${PREFIX}${name}:`) && key !== keyOf(name) && read(key)?.at,
    );
  } catch {
    return [];
  }
}

/**
 * What was changed in a form and is not saved.
 * @param {string | null} name of the form, with its folder; null keeps it as long as the form is shown
 * @param {any} version of what is edited now
 * @param {string[]} secrets names of edits that are kept as long as this tab only
 * @returns {{edits: Record<string, any>, version: any, restored: number | null, set: (edits: Record<string, any>) => void,
 *   change: (name: string, value: any, start: any) => void,
 *   saved: (written: Record<string, any>, version?: any) => void,
 *   found: {at: number, take: () => void, drop: () => void} | null}}
 *   `change` sets one value, which is no edit if it is as at the start;
 *   `saved` forgets what was written, and keeps what was changed since, for this version of the file;
 *   `restored`: when the shown edits were left, until the next one; `found`: those of a tab that is gone or elsewhere
 */
export function useDraft(name, version, secrets = []) {
  const [draft, setDraft] = useState(() => read(keyOf(name)));
  const [restored, setRestored] = useState(draft?.at ?? null);
  const [others, setOthers] = useState(() => strangers(name));
  const newest = useRef(draft);
  const keep = (edits, base) => {
    const changed = Object.keys(edits).length > 0;
    const next = changed ? { edits, version: base, at: Date.now() } : null;
    newest.current = next;
    write(keyOf(name), next, secrets);
    setDraft(next);
    if (!changed) setRestored(null);
  };
  const set = (edits) => keep(edits, newest.current?.version ?? version);
  const change = (name, value, start) => {
    const { [name]: _, ...others } = newest.current?.edits ?? {};
    set(same(value, start) ? others : { ...others, [name]: value });
  };
  const saved = (written, base = version) => {
    const isNew = ([key, value]) => !same(value, written[key]);
    keep(Object.fromEntries(Object.entries(newest.current?.edits ?? {}).filter(isNew)), base);
    setRestored(null);
  };
  const first = others[0];
  const drop = () => {
    write(first, null);
    setOthers(others.slice(1));
  };
  const take = () => {
    const other = read(first);
    drop();
    newest.current = other;
    write(keyOf(name), other);
    setDraft(other);
    setRestored(other.at);
  };
  return {
    edits: draft?.edits ?? {},
    version: draft?.version ?? version,
    ...{ restored, set, change, saved },
    found: first ? { at: read(first)?.at ?? 0, take, drop } : null,
  };
}
