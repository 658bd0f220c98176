// Saves settings and the three files; asks which version counts where a file has changed on the disk.

import { put } from "/api.js";
import { dialog } from "/dialogs.js";
import { notify } from "/notices.js";
import { html } from "/ui.js";

/** One of two versions; lines that the other does not have are marked. */
const Version = ({ text, other }) =>
  html`<pre class="version" tabindex="0">${(text ?? "(not there)")
    .split("\n")
    .map((line) =>
      other?.split("\n").includes(line) ? `${line}\n` : html`<mark>${line || " "}</mark>${"\n"}`,
    )}</pre>`;

/**
 * Both versions of what was changed here and on the disk.
 * @param {string} message what happened
 * @param {{name: string, yours: string, disk: string | null}[]} both
 * @returns {Promise<"mine" | "disk" | null>}
 */
function chooseVersion(message, both) {
  const content = (close) => html`
    <h2 id="conflict">The file has changed on the disk</h2>
    <p>${message} Choose which version to keep.</p>
    ${both.map(
      ({ name, yours, disk }) => html`<section class="versions">
        <h3>${name}</h3>
        <div><p>Yours, on this page</p><${Version} text=${yours} other=${disk} /></div>
        <div><p>On the disk</p><${Version} text=${disk} other=${yours} /></div>
      </section>`,
    )}
    <p class="actions">
      <button type="button" autofocus onClick=${() => close(null)}>Cancel</button>
      <button type="button" onClick=${() => close("disk")}>Take the one on the disk</button>
      <button type="button" class="danger" onClick=${() => close("mine")}>Write mine</button>
    </p>`;
  return dialog(content, { label: "conflict", wide: true });
}

/**
 * Write settings.
 * @param {Record<string, string>} values
 * @param {Object} versions of the files
 * @returns {Promise<{versions: Object, text: string, warnings: string[]} | null>} null where nothing was written
 */
export async function writeSettings(values, versions) {
  try {
    const edit = await put("/api/settings", { values, versions });
    const files = [...new Set((edit.changes ?? []).map((each) => each.file))].join(" and ");
    const text = files
      ? `Saved in ${files}; the old file is kept as .bak.`
      : "It was like this already.";
    return { versions: edit.versions, text, warnings: edit.warnings ?? [] };
  } catch (error) {
    if (error.status !== 409 || !error.answer?.conflict) throw error;
    const { conflict, versions: now } = error.answer;
    const choice = await chooseVersion(error.message, conflict);
    if (choice === "mine") return writeSettings(values, now);
    return choice === "disk" ? { versions: now, text: "Taken from the disk.", warnings: [] } : null;
  }
}

/**
 * Write one of the three files.
 * @param {string} path
 * @param {Object} body with the version of the file that was edited
 * @param {{mine: string, read: () => Promise<any>}} options the text as it would become; reads the file again
 * @returns {Promise<{facts: Object, text: string} | null>} what the file is now; null where nothing was written
 */
export async function writeOwnFile(path, body, { mine, read }) {
  try {
    const facts = await put(path, body);
    return { facts, text: savedText(facts) };
  } catch (error) {
    if (error.status !== 409) throw error;
    const disk = await read();
    const theirs = disk.text ?? JSON.stringify(disk.values, null, 2);
    const choice = await chooseVersion(error.message, [
      { name: disk.file, yours: mine, disk: theirs },
    ]);
    if (choice === "mine")
      return writeOwnFile(path, { ...body, version: disk.version }, { mine, read });
    return choice === "disk" ? { facts: disk, text: "Taken from the disk." } : null;
  }
}

/** What a page says after a file was saved. */
export function savedText(answer) {
  if (answer.others?.length)
    notify(
      `${answer.others.join(" and ")} ${answer.others.length > 1 ? "were" : "was"} written too: a training takes the shipped files only if there is none of your own.`,
    );
  return answer.changed
    ? `Saved in ${answer.file}${answer.backup ? `; the old one is kept as ${answer.backup}` : ""}.`
    : `${answer.file} was like this already.`;
}
