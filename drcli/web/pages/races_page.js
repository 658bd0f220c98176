// All races of the bucket, and the form that makes one.

import { post } from "/api.js";
import { useDraft } from "/drafts.js";
import { RaceForm } from "/race_form.js";
import { StateBadge, dateText, nightLink, raceLink, waitText } from "/race_words.js";
import { setQuery, useGet, useTopic } from "/store.js";
import { number } from "/text.js";
import { Columns, Empty, Failure, html, useEffect } from "/ui.js";

export const title = "Races";

export function Page({ query }) {
  const { value: found, error } = useTopic("races");
  const folder = useGet("/api/new-folder").value?.directory;
  const open = query.has("new");
  return html`
    <h1>Races</h1>
    <p>A leaderboard over models of this bucket: racers submit checkpoints, a queue drives them under the same rules, and the best is first.</p>
    <p class="actions"><button type="button" class="main" aria-expanded=${String(open)}
      onClick=${() => setQuery({ new: open ? "" : "1" })}>Make a race</button></p>
    ${folder && html`<${Creation} key=${folder} folder=${folder} open=${open} />`}
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

/** @type {[string, (race: any) => any][]} */
const COLUMNS = [
  ["Race", ({ race, name }) => html`<a href=${raceLink(race)}>${name}</a>`],
  ["State", ({ badge }) => html`<${StateBadge} badge=${badge} />`],
  ["Track", ({ world }) => world],
  ["Kind", ({ kind }) => kind],
  ["Leader", ({ leader, leader_text: time }) => (leader ? `${leader} ${time}` : "nobody yet")],
  ["Submissions", ({ submissions }) => String(submissions)],
  [
    "Queue",
    ({ race, name, queued, runner }) =>
      html`${queued ? waitText(queued) : "empty"}${runner && ", being driven"} <a href=${nightLink(race)} aria-label=${`Race night of ${name}`}>Race night</a>`,
  ],
  ["Made", (race) => dateText(race.created_at)],
];

const List = ({ races }) => html`
  <${Columns} kind="race-table race-all" label="Races" columns=${COLUMNS} rows=${races} header=${0} keyOf=${({ race }) => race}
    caption=${`${number(races.length)} ${races.length === 1 ? "race" : "races"}, the newest first`} />`;
