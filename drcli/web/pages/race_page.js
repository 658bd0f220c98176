// One race: leaderboard, submissions, queue, pairs, and everything that its organiser and its racers do.

import { post } from "/api.js";
import { confirmed } from "/dialogs.js";
import { useDraft } from "/drafts.js";
import { notify } from "/notices.js";
import * as ask from "/race_actions.js";
import { RaceForm } from "/race_form.js";
import { Pairs } from "/race_pairs.js";
import {
  StateBadge,
  aboutField,
  checkpointNumber,
  dateText,
  driversText,
  gapText,
  inPairs,
  nightLink,
  pointsText,
  racePath,
  waitText,
} from "/race_words.js";
import { setQuery, useAction, useGet, useTopic } from "/store.js";
import { moment, number } from "/text.js";
import { Button, Empty, Failure, Folded, html, useEffect, useRef, useState } from "/ui.js";

export const title = "Race";

const MOST_SHOWN = 8;

export function Page({ params: [id], query }) {
  const told = useTopic(`race:${id}`);
  const folder = useGet("/api/new-folder").value;
  const [race, setRace] = useState(null);
  const before = useRef(Promise.resolve());
  useEffect(() => {
    if (told.value) setRace(told.value);
  }, [told.value]);
  useEffect(() => {
    if (race) document.title = `${race.rules.name} – DeepRacer console`;
  }, [race?.rules.name]);

  /** Do something, and say what went wrong; one after the other. */
  const after = (action) => {
    before.current = before.current.then(() =>
      action().catch((error) => {
        const { message, remedy } = aboutField(error);
        notify(message, "bad", remedy);
      }),
    );
    return before.current;
  };
  const act = (name, body = {}, said = "") =>
    after(async () => {
      const answer = await post(racePath(id, name), body);
      if (answer.race) setRace(answer.race);
      if (said) notify(said);
      return answer;
    });
  const error = told.error && aboutField(told.error);
  const back = html`<p><a href="#/races">All races</a></p>`;
  if (!race)
    return html`${back}<h1>Race</h1>
    ${error ? html`<${Failure} error=${error} />` : html`<p class="quiet">Reading the bucket …</p>`}`;
  const props = { id, race, act, after, take: setRace };
  const watch = (video, name) => ask.watch(id, video, name);
  return html`
    ${back}
    <${Head} race=${race} />
    <${Actions} ...${props} />
    <div role="status">
      ${error && html`<${Failure} error=${error} />`}
      ${race.damaged.map((message) => html`<${Failure} key=${message} error=${{ message }} />`)}
    </div>
    ${folder && race.changeable && html`<${Rules} key=${folder.directory} folder=${folder.directory} open=${query.has("rules")} ...${props} />`}
    <section class="race-page-part"><h2>Leaderboard</h2><${Board} race=${race} watch=${watch} /></section>
    <div class="race-columns">
      <section aria-label="Queue"><h2>Queue</h2><${Queue} ...${props} /></section>
      ${
        inPairs(race) &&
        html`<section class=${race.rules.pairing === "bracket" && "wide"} aria-label="Pairs">
          <h2>Pairs</h2><${Pairs} race=${race} watch=${watch} />
        </section>`
      }
    </div>
    ${race.submissions.length > 0 && html`<${Submissions} ...${props} watch=${watch} />`}`;
}

function Head({ race }) {
  const { rules, words, state, queue, runner } = race;
  const taking = state === "open" || state === "scheduled";
  const most = rules.max_submissions;
  const facts = [
    rules.opens_at && `Opens ${moment(rules.opens_at)}.`,
    rules.closes_at && `${taking ? "Closes" : "Closed"} ${moment(rules.closes_at)}.`,
    most > 0 && `Each racer has ${number(most)} ${most === 1 ? "submission" : "submissions"}.`,
    rules.sensors.length > 0 && `Sensors: ${rules.sensors.join(", ")}.`,
    words.conditions && `Settings: ${words.conditions}.`,
    runner && `The queue is driven by ${runner}.`,
  ];
  const { driving } = race.moments;
  const standing = [
    {
      scheduled: "Not open yet.",
      open: "Open for submissions.",
      closed: "Closed for submissions.",
      finished: "Finished; nobody is ranked.",
    }[state],
    driving && `${driversText(driving)} ${driving.cars.length > 1 ? "drive" : "drives"} now.`,
    queue.length > 0 &&
      `${waitText(queue.length)} in the queue${runner ? "." : ", but nobody is driving it."}`,
  ];
  return html`
    <div class="race-head">
      <h1>${rules.name} <${StateBadge} state=${state} /></h1>
      <p>${words.place}. ${words.decides} ${words.penalties}</p>
      <p class="race-standing" role="status">${race.winner ? `Winner: ${race.winner}.` : standing.filter(Boolean).join(" ")}</p>
      <p class="quiet">${facts.filter(Boolean).join(" ")}</p>
    </div>`;
}

function Actions({ id, race, act, after, take }) {
  const open = race.state === "open";
  const scheduled = race.state === "scheduled";
  const submit = () =>
    after(async () => {
      const answer = await ask.submitted(id);
      if (!answer) return;
      const { taken } = answer;
      take(answer.race);
      notify(
        `${taken.racer} has submitted checkpoint ${checkpointNumber(taken)} of ${taken.model}.${taken.queue ? "" : " Drive the queue to see its laps."}`,
      );
    });
  const [asked] = useAction(async (name, question) => {
    const body = await question();
    if (body) await act(name, body);
  });
  const close = async () => {
    const detail =
      "What waits in the queue is still driven, and then there is a winner. You can open it again.";
    if (await confirmed("Close this race for submissions?", { action: "Close it", detail }))
      act("close");
  };
  const stop = () => act("stop", {}, "The queue was stopped. What was driven is kept.");
  const button = (text, onClick, kind = null) =>
    html`<${Button} key=${text} class=${kind} onClick=${onClick}>${text}<//>`;
  return html`
    <p class="actions race-actions">
      ${open && button("Submit a model", submit, "main")}
      ${race.runner && race.here && button("Stop the queue", stop)}
      ${!race.runner && race.queue.length > 0 && button("Drive the queue", () => asked("run", () => ask.howToDrive(id)), open ? null : "main")}
      <a class="button" href=${nightLink(id)}>Race night</a>
      ${(open || scheduled) && button("Close for submissions", close)}
      ${!open && button(scheduled ? "Open now" : "Open again", () => asked("open", () => ask.untilWhen(id)))}
      ${button("Save as CSV", () => after(() => ask.keep(id, "table.csv", `${id}.csv`)))}
      ${button("Save as a page", () => after(() => ask.savePage(id)))}
      ${button("Log of the queue", () => after(() => ask.showLog(id)))}
      ${race.changeable && button("Change the rules", () => setQuery({ rules: "1" }))}
      ${button("Delete", () => after(() => ask.erase(id, race)), "danger")}
    </p>`;
}

function Rules({ id, folder, open, take }) {
  const draft = useDraft(`rules:${id}:${folder}`, 1);
  useEffect(() => {
    if (draft.restored) setQuery({ rules: "1" });
  }, []);
  if (!open) return null;
  const leave = () => setQuery({ rules: "" });
  const send = async (rules) => {
    take((await post(racePath(id, "rules"), rules)).race);
    leave();
    notify("The rules were changed.");
  };
  return html`<${RaceForm} title="Change the rules" action="Change the rules" draft=${draft} path=${racePath(id, "rules")} present=${true} send=${send} leave=${leave} />`;
}

const WatchButton = ({ video, name, watch }) => html`
  <button type="button" class="race-small" aria-label=${`Watch the video of ${name}`} onClick=${() => watch(video, name)}>Watch</button>`;

function Board({ race, watch }) {
  const { leaderboard, rules } = race;
  if (!leaderboard.length)
    return html`<${Empty} text=${
      race.submissions.length
        ? `Nobody has driven yet. ${race.runner ? "The first result appears here." : "Drive the queue."}`
        : race.state === "open"
          ? "Nobody has submitted a model yet."
          : "Nobody has driven."
    } />`;
  const paired = inPairs(race);
  // Name, text, class: what decides and the gap stay on a small screen, details do not.
  const figure = (name, key, kind = "detail") => [name, (row) => row[key], `figure ${kind}`];
  const time = (name, ranking, key) =>
    figure(name, key, ranking === rules.ranking ? "decides" : "detail");
  const average = `Best average of ${rules.average_laps} laps`;
  const won = (row) => `${row.wins}, ${row.draws}, ${row.losses}`;
  const model = (row) =>
    html`${row.model}<span class="quiet race-checkpoint"> checkpoint ${checkpointNumber(row)}</span>`;
  const film = ({ video, racer }) =>
    video
      ? html`<${WatchButton} video=${video} name=${racer} watch=${watch} />`
      : html`<span class="detail">–</span>`;
  const columns = [
    ["Rank", (row) => row.rank ?? "–", "rank"],
    ["Racer", (row) => row.racer, "racer"],
    ["Model", model, "model"],
    paired
      ? ["Points", pointsText, "figure decides"]
      : time("Best lap", "best-lap", "best_lap_text"),
    !paired && time(average, "best-average", "best_average_text"),
    !paired && time("Total time", "total-time", "total_text"),
    paired ? ["Won, drawn, lost", won, "figure gap"] : ["Gap", gapText, "figure gap"],
    paired && figure("Best lap", "best_lap_text"),
    figure("Laps", "laps_text"),
    figure("Off track", "off_track"),
    figure("Crashes", "crashes"),
    ["Video", film, "film"],
  ].filter(Boolean);
  return html`
    ${race.limit && html`<p class="quiet">The best lap, ${race.limit}.</p>`}
    <div class="scroll" tabindex="0" role="region" aria-label="Leaderboard">
      <table class="race-table race-board" role="table">
        <caption>Times in minutes:seconds; penalties are included. ${!paired && "The column in bold decides."}</caption>
        <thead role="rowgroup"><tr role="row">${columns.map(([name, , kind]) => html`<th key=${name} scope="col" role="columnheader" class=${kind.startsWith("figure") && "figure"}>${name}</th>`)}</tr></thead>
        <tbody role="rowgroup">${leaderboard.map(
          (row) => html`
            <tr key=${row.submission} role="row" class=${row.rank === 1 && "first"}>
              ${columns.map(([name, text, kind]) => html`<td key=${name} role="cell" class=${kind} data-label=${name}><span>${text(row)}</span></td>`)}
            </tr>`,
        )}</tbody>
      </table>
    </div>`;
}

const QUESTIONS = {
  withdraw: [
    (name) => `Withdraw ${name}?`,
    "Withdraw it",
    "Its laps are removed, and it no longer counts. It cannot be undone; the model stays.",
  ],
  restart: [
    (name) => `Drive ${name} again?`,
    "Drive it again",
    "Its present laps no longer count.",
  ],
};

/** A button that asks first. */
function Asking({ what, label, text, entry, act }) {
  const { submission, racer, model } = entry;
  const [question, action, detail] = QUESTIONS[what];
  const go = async () => {
    if (await confirmed(question(`${racer}'s ${model}`), { action, detail }))
      act(what, { submission });
  };
  return html`<button type="button" class="race-small" aria-label=${label} onClick=${go}>${text}</button>`;
}

function Queue({ race, act }) {
  const [moved, setMoved] = useState(null);
  const { driving } = race.moments;
  const entries = new Map(race.submissions.map((entry) => [entry.submission, entry]));
  const names = race.drawn ? [] : [...new Set(race.queue.flatMap((run) => run.split("+")))];
  const move = async (submission, place) => {
    if (place >= 1 && place <= names.length && (await act("move", { submission, place })))
      setMoved(submission);
  };
  return html`
    ${driving && html`<p class="race-driving"><span class="dot good"></span>${driversText(driving)}, driven since ${moment(driving.began_at)}</p>`}
    ${
      names.length
        ? html`
          <p class="quiet">${inPairs(race) ? "Pairs are made in this order." : "They drive in this order."} The arrows move a submission; so do Alt and the arrow keys.</p>
          <ol class="race-queue">${names.map(
            (name, k) =>
              html`<${Waiting} key=${name} entry=${entries.get(name)} at=${k} last=${k === names.length - 1}
                focused=${moved === name} onFocused=${() => setMoved(null)} move=${move} act=${act} />`,
          )}</ol>`
        : html`<p class="quiet">${race.drawn ? `The bracket is drawn; ${waitText(race.queue.length)}.` : "The queue is empty."}</p>`
    }`;
}

function Waiting({ entry, at, last, focused, onFocused, move, act }) {
  const place = useRef(null);
  const { submission, racer, model } = entry;
  const who = `${racer}, ${model}`;
  useEffect(() => {
    if (!focused) return;
    place.current.focus(); // it has lost it on its way
    onFocused();
  }, [focused]);
  const up = () => move(submission, at);
  const down = () => move(submission, at + 2);
  const press = (event) => {
    const go = event.altKey && { ArrowUp: up, ArrowDown: down }[event.key];
    if (!go) return;
    event.preventDefault();
    go();
  };
  return html`
    <li ref=${place} tabindex="0" data-key=${`item-${submission}`} aria-label=${`${at + 1}. ${who}`} aria-keyshortcuts="Alt+ArrowUp Alt+ArrowDown" onKeyDown=${press}>
      <div>
        <span class="race-who"><strong>${racer}</strong><span class="quiet"> ${model}</span></span>
        <span class="race-buttons">
          <button type="button" class="race-small" disabled=${at === 0} aria-label=${`Move ${who} up`} onClick=${up}>↑</button>
          <button type="button" class="race-small" disabled=${last} aria-label=${`Move ${who} down`} onClick=${down}>↓</button>
          <${Asking} what="withdraw" label=${`Withdraw ${who}`} text="Withdraw" entry=${entry} act=${act} />
        </span>
      </div>
    </li>`;
}

const ENTRY_STATES = {
  queued: "waits",
  running: "is driven now",
  done: "was driven",
  failed: "failed",
  "over the limit": "does not count: the racer has more submissions than the rules allow",
};

function Submissions({ race, act, watch }) {
  const [open, setOpen] = useState(null);
  const count = race.submissions.length;
  return html`
    <section class="race-page-part" aria-label="Submissions">
      <${Folded} title=${html`<h2>Submissions (${number(count)})</h2>`} open=${open ?? count <= MOST_SHOWN} onToggle=${setOpen}>
        <ul class="race-submissions">${race.submissions.map((entry) => html`<${Entry} key=${entry.submission} entry=${entry} act=${act} watch=${watch} />`)}</ul>
      <//>
    </section>`;
}

function Entry({ watch, ...props }) {
  const { entry } = props;
  const { racer, model, state, message, remedy } = entry;
  const name = `${racer}, ${model}`;
  const laps = entry.lap_s.length ? entry.lap_text.join("; ") : (ENTRY_STATES[state] ?? state);
  return html`
    <li>
      <div>
        <strong>${racer}</strong> ${model}, checkpoint ${checkpointNumber(entry)} <span class="quiet">${entry.submission}, ${dateText(entry.submitted_at)}</span>
        <p class=${state === "failed" && "race-failed"}>${laps}${message && `: ${message} ${remedy}`}</p>
        ${entry.notes.map((note) => html`<p key=${note} class="quiet">${note}</p>`)}
      </div>
      <span class="race-buttons">
        ${entry.video && html`<${WatchButton} video=${entry.video} name=${name} watch=${watch} />`}
        ${(state === "done" || state === "failed") && html`<${Asking} what="restart" label=${`Drive ${name} again`} text="Drive again" ...${props} />`}
        ${state !== "queued" && html`<${Asking} what="withdraw" label=${`Withdraw ${name}`} text="Withdraw" ...${props} />`}
      </span>
    </li>`;
}
