// All races of the bucket, and the form that makes one.

import { post } from "/api.js";
import { useDraft } from "/drafts.js";
import { RaceForm } from "/race_form.js";
import { StateBadge, dateText, nightLink, raceLink, waitText } from "/race_words.js";
import { setQuery, useGet, useTopic } from "/store.js";
import { number } from "/text.js";
import { Empty, Failure, html, useEffect } from "/ui.js";

export const title = "Races";

const COLUMNS = ["Race", "State", "Track", "Kind", "Leader", "Submissions", "Queue", "Made"];

export function Page({ query }) {
  const { value: found, error } = useTopic("races");
  const folder = useGet("/api/new-folder").value;
  const open = query.has("new");
  return html`
    <h1>Races</h1>
    <p>A leaderboard over models of this bucket: racers submit checkpoints, a queue drives them under the same rules, and the best is first.</p>
    <p class="actions"><button type="button" class="main" aria-expanded=${String(open)}
      onClick=${() => setQuery({ new: open ? "" : "1" })}>Make a race</button></p>
    ${folder && html`<${Creation} key=${folder.directory} folder=${folder.directory} open=${open} />`}
    <div class="race-list">
      ${error && html`<${Failure} error=${error} />`}
      ${!found && !error && html`<p class="quiet">Reading the bucket …</p>`}
      ${found?.races.length > 0 && html`<${List} races=${found.races} />`}
      ${
        found?.races.length === 0 &&
        !open &&
        html`<${Empty} text=${`There is no race in s3://${found.bucket} yet. Make one, let racers submit their models, and drive its queue.`}>
          <button type="button" onClick=${() => setQuery({ new: "1" })}>Make the first race</button>
        <//>`
      }
      ${found?.damaged.map((message) => html`<${Failure} key=${message} error=${{ message }} />`)}
    </div>`;
}

function Creation({ folder, open }) {
  const draft = useDraft(`new-race:${folder}`, 1);
  useEffect(() => {
    if (draft.restored) setQuery({ new: "1" });
  }, []);
  if (!open) return null;
  const send = async (rules) => {
    const { race } = await post("/api/races", rules);
    location.hash = raceLink(race);
  };
  return html`<${RaceForm} title="Make a race" action="Make this race" draft=${draft} send=${send} leave=${() => setQuery({ new: "" })} />`;
}

const List = ({ races }) => html`
  <div class="scroll" tabindex="0" role="region" aria-label="Races">
    <table class="race-table race-all" role="table">
      <caption>${number(races.length)} ${races.length === 1 ? "race" : "races"}, the newest first</caption>
      <thead role="rowgroup"><tr role="row">${COLUMNS.map((name) => html`<th key=${name} scope="col" role="columnheader">${name}</th>`)}</tr></thead>
      <tbody role="rowgroup">${races.map((race) => {
        const cells = [
          html`<${StateBadge} state=${race.state} />`,
          race.world,
          race.kind,
          `${race.leader ?? "nobody yet"}${race.leader_s === null ? "" : ` ${race.leader_text}`}`,
          number(race.submissions),
          html`${race.queued ? waitText(race.queued) : "empty"}${race.runner && ", being driven"} <a href=${nightLink(race.race)} aria-label=${`Race night of ${race.name}`}>Race night</a>`,
          dateText(race.created_at),
        ];
        return html`<tr key=${race.race} role="row">
          <th scope="row" role="rowheader"><a href=${raceLink(race.race)}>${race.name}</a></th>
          ${cells.map((cell, k) => html`<td key=${k} role="cell" data-label=${COLUMNS[k + 1]}><span>${cell}</span></td>`)}
        </tr>`;
      })}</tbody>
    </table>
  </div>`;
