// What has happened, in a sentence: above the page, until it is closed or the page is left.

import { signal } from "/vendor/preact/preact.js";

const GOOD_MS = 8000;

/**
 * @typedef {Object} Notice
 * @property {number} id
 * @property {string} text
 * @property {"good" | "warn" | "bad"} kind
 * @property {string} remedy
 * @property {{text: string, href: string} | null} link
 */

/** @type {{value: Notice[]}} */
export const notices = signal([]);
let last = 0;

/**
 * Show a notice, once however often it is said; a good one leaves after some seconds.
 * @param {string} text
 * @param {"good" | "warn" | "bad"} kind
 * @param {string} remedy
 * @param {{text: string, href: string} | null} link to where it can be mended
 */
export function notify(text, kind = "good", remedy = "", link = null) {
  const notice = { id: (last += 1), text, kind, remedy, link };
  notices.value = [...notices.value.filter((each) => each.text !== text), notice];
  if (kind === "good") setTimeout(() => dismiss(notice.id), GOOD_MS);
}

/** @param {number} id */
export function dismiss(id) {
  notices.value = notices.value.filter((each) => each.id !== id);
}

/** What was said about a page is not said about the next one. */
export function clearNotices() {
  notices.value = notices.value.filter((each) => each.kind === "good");
}
