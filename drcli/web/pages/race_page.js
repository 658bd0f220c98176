// One race: leaderboard, submissions, queue, pairs, and everything that its organiser and its racers do.

import { post, remove } from "/api.js";
import { aboutField } from "/ask.js";
import { useDraft } from "/drafts.js";
import { notify } from "/notices.js";
import { asked, keep, showLog, submitted, watch } from "/race_actions.js";
import { RaceForm } from "/race_form.js";
import { Pairs } from "/race_pairs.js";
import {
  StateBadge,
  checkpointNumber,
  dateText,
  driversText,
  inPairs,
  nightLink,
  racePath,
} from "/race_words.js";
import { setQuery, useGet, useTopic } from "/store.js";
import { moment, number } from "/text.js";
import { Button, Columns, Empty, Failure, Folded, useTitle } from "/ui.js";
import { html, useEffect, useRef, useState } from "/vendor/preact/preact.js";

export const title = "Race";

const MOST_SHOWN = 8;

export function Page({ params: [id], query }) {
  const told = useTopic(`race:${id}`);
  const folder = useGet("/api/new-folder").value?.directory;
  const [race, take] = useState(null);
  const before = useRef(Promise.resolve());
  useEffect(() => {
    if (told.value) take(told.value);
  }, [told.value]);
  useTitle(race && `${race.rules.name} – DeepRacer console`);

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
  const act = async (name, body = {}) => {
    const answer = await post(racePath(id, name), body);
    if (answer.race) take(answer.race);
    return answer;
  };
  const change = (name, body = {}, said = "") =>
    after(async () => {
      const answer = await act(name, body);
      if (said) notify(said);
      return answer;
    });
  const ask = (name, given = {}, send = (body) => act(name, body)) =>
    after(() => asked(id, name, given, send));
  const error = told.error && aboutField(told.error);
  const back = html`<p><a href="#/races">All races</a></p>`;
  if (!race)
    return html`${back}<h1>Race</h1>
    ${error ? html`<${Failure} error=${error} />` : html`<p class="quiet">Reading the bucket …</p>`}`;
  const props = { id, race, folder, change, after, ask, take };
  const film = (video, name) => watch(id, video, name);
  return html`
    ${back}
    <${Head} race=${race} />
    <${Actions} ...${props} />
    <div role="status">
      ${error && html`<${Failure} error=${error} />`}
      ${race.damaged.map((message) => html`<${Failure} key=${message} error=${{ message }} />`)}
    </div>
    ${folder && race.changeable && html`<${Rules} key=${folder} open=${query.has("rules")} ...${props} />`}
    <section class="race-page-part"><h2>Leaderboard</h2><${Board} race=${race} film=${film} /></section>
    <div class="race-columns">
      <section aria-label="Queue"><h2>Queue</h2><${Queue} ...${props} /></section>
      ${
        inPairs(race) &&
        html`<section class=${race.rules.pairing === "bracket" && "wide"} aria-label="Pairs">
          <h2>Pairs</h2><${Pairs} race=${race} watch=${film} />
        </section>`
      }
    </div>
    ${race.submissions.length > 0 && html`<${Submissions} ...${props} film=${film} />`}`;
}

const Head = ({ race: { rules, words, badge } }) => html`
  <div class="race-head">
    <h1>${rules.name} <${StateBadge} badge=${badge} /></h1>
    <p>${words.place}. ${words.decides} ${words.penalties}</p>
    <p class="race-standing" role="status">${words.standing}</p>
    <p class="quiet">${words.facts}</p>
  </div>`;

function Actions({ id, race, change, after, ask, take }) {
  const open = race.state === "open";
  const scheduled = race.state === "scheduled";
  const submit = async () => {
    const answer = await submitted(id);
    if (!answer) return;
    const { taken } = answer;
    take(answer.race);
    notify(
      `${taken.racer} has submitted checkpoint ${checkpointNumber(taken)} of ${taken.model}.${taken.queue ? "" : " Drive the queue to see its laps."}`,
    );
  };
  const savePage = ({ videos }) => keep(id, `page.html${videos ? "?videos=1" : ""}`, `${id}.html`);
  const erase = async () => {
    await remove(racePath(id));
    notify(`The race ${race.rules.name} was deleted.`);
    location.hash = "#/races";
  };
  const button = (text, onClick, kind = null) =>
    html`<${Button} key=${text} class=${kind} onClick=${onClick}>${text}<//>`;
  return html`
    <p class="actions race-actions">
      ${open && button("Submit a model", () => after(submit), "main")}
      ${race.runner && race.here && button("Stop the queue", () => change("stop", {}, "The queue was stopped. What was driven is kept."))}
      ${!race.runner && race.queue.length > 0 && button("Drive the queue", () => ask("run"), open ? null : "main")}
      <a class="button" href=${nightLink(id)}>Race night</a>
      ${(open || scheduled) && button("Close for submissions", () => ask("close"))}
      ${!open && button(scheduled ? "Open now" : "Open again", () => ask("open"))}
      ${button("Save as CSV", () => after(() => keep(id, "table.csv", `${id}.csv`)))}
      ${button("Save as a page", () => ask("page", {}, savePage))}
      ${button("Log of the queue", () => after(() => showLog(id)))}
      ${race.changeable && button("Change the rules", () => setQuery({ rules: "1" }))}
      ${button("Delete", () => ask("delete", {}, erase), "danger")}
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

const WatchButton = ({ video, name, film }) => html`
  <button type="button" class="race-small" aria-label=${`Watch the video of ${name}`} onClick=${() => film(video, name)}>Watch</button>`;

function Board({ race, film }) {
  const { leaderboard, rules, submissions, state } = race;
  if (!leaderboard.length) {
    const nobody = state === "open" ? "Nobody has submitted a model yet." : "Nobody has driven.";
    const next = race.runner ? "The first result appears here." : "Drive the queue.";
    const text = submissions.length ? `Nobody has driven yet. ${next}` : nobody;
    return html`<${Empty} text=${text} />`;
  }
  const paired = inPairs(race);
  // What decides and the gap stay on a small screen, details do not.
  const figure = (name, key, decides = false) => [
    ...[name, (row) => row[key], `figure ${decides ? "decides" : "detail"}`],
  ];
  const time = (name, ranking, key) => figure(name, key, ranking === rules.ranking);
  const model = (row) =>
    html`${row.model}<span class="quiet race-checkpoint"> checkpoint ${checkpointNumber(row)}</span>`;
  const watchIt = ({ video, racer }) =>
    video && html`<${WatchButton} video=${video} name=${racer} film=${film} />`;
  const results = paired
    ? [
        ["Points", (row) => row.points_text, "figure decides"],
        ["Won, drawn, lost", (row) => `${row.wins}, ${row.draws}, ${row.losses}`, "figure gap"],
        figure("Best lap", "best_lap_text"),
      ]
    : [
        time("Best lap", "best-lap", "best_lap_text"),
        time(
          `Best average of ${rules.average_laps === 1 ? "1 lap" : `${rules.average_laps} laps`}`,
          "best-average",
          "best_average_text",
        ),
        time("Total time", "total-time", "total_text"),
        ["Gap", (row) => row.gap, "figure gap"],
      ];
  const columns = [
    ["Rank", (row) => row.rank ?? "–", "rank"],
    ["Racer", (row) => row.racer, "racer"],
    ["Model", model, "model"],
    ...results,
    figure("Laps", "laps_text"),
    figure("Off track", "off_track"),
    figure("Crashes", "crashes"),
    ["Video", watchIt, "film"],
  ];
  return html`
    ${race.limit && html`<p class="quiet">The best lap, ${race.limit}.</p>`}
    <${Columns} kind="race-table race-board" label="Leaderboard" columns=${columns} rows=${leaderboard}
      caption=${`Times in minutes:seconds; penalties are included.${paired ? "" : " The column in bold decides."}`}
      keyOf=${(row) => row.submission} kindOf=${(row) => row.rank === 1 && "first"} />`;
}

function Queue({ race, change, ask }) {
  const [moved, setMoved] = useState(null);
  const { driving } = race.moments;
  const entries = new Map(race.submissions.map((entry) => [entry.submission, entry]));
  const names = race.drawn ? [] : [...new Set(race.queue.flatMap((run) => run.split("+")))];
  const move = async (submission, place) => {
    if (place >= 1 && place <= names.length && (await change("move", { submission, place })))
      setMoved(submission);
  };
  const order = inPairs(race) ? "Pairs are made in this order." : "They drive in this order.";
  return html`
    ${driving && html`<p class="race-driving"><span class="dot good"></span>${driversText(driving)}, driven since ${moment(driving.began_at)}</p>`}
    ${
      names.length
        ? html`
          <p class="quiet">${order} The arrows move a submission; so do Alt and the arrow keys.</p>
          <ol class="race-queue">${names.map(
            (name, k) =>
              html`<${Waiting} key=${name} entry=${entries.get(name)} at=${k} last=${k === names.length - 1}
                focused=${moved === name} onFocused=${() => setMoved(null)} move=${move} ask=${ask} />`,
          )}</ol>`
        : html`<p class="quiet">${race.drawn ? "The bracket is drawn." : "The queue is empty."}</p>`
    }`;
}

function Waiting({ entry, at, last, focused, onFocused, move, ask }) {
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
  const button = (text, does, go, disabled = false) => html`
    <button type="button" class="race-small" disabled=${disabled} aria-label=${does} onClick=${go}>${text}</button>`;
  return html`
    <li ref=${place} tabindex="0" data-key=${`item-${submission}`} aria-label=${`${at + 1}. ${who}`} aria-keyshortcuts="Alt+ArrowUp Alt+ArrowDown" onKeyDown=${press}>
      <div>
        <span class="race-who"><strong>${racer}</strong><span class="quiet"> ${model}</span></span>
        <span class="race-buttons">
          ${button("↑", `Move ${who} up`, up, at === 0)}
          ${button("↓", `Move ${who} down`, down, last)}
          ${button("Withdraw", `Withdraw ${who}`, () => ask("withdraw", { submission }))}
        </span>
      </div>
    </li>`;
}

function Submissions({ race, ...props }) {
  const [open, setOpen] = useState(null);
  const count = race.submissions.length;
  return html`
    <section class="race-page-part" aria-label="Submissions">
      <${Folded} title=${html`<h2>Submissions (${number(count)})</h2>`} open=${open ?? count <= MOST_SHOWN} onToggle=${setOpen}>
        <ul class="race-submissions">${race.submissions.map((entry) => html`<${Entry} key=${entry.submission} entry=${entry} ...${props} />`)}</ul>
      <//>
    </section>`;
}

function Entry({ entry, film, ask }) {
  const { submission, racer, model, state, said, video } = entry;
  const name = `${racer}, ${model}`;
  const button = (text, does, about) => html`
    <button type="button" class="race-small" aria-label=${does} onClick=${() => ask(about, { submission })}>${text}</button>`;
  return html`
    <li>
      <div>
        <strong>${racer}</strong> ${model}, checkpoint ${checkpointNumber(entry)} <span class="quiet">${submission}, ${dateText(entry.submitted_at)}</span>
        <p class=${state === "failed" && "race-failed"}>${said}</p>
        ${entry.notes.map((note) => html`<p key=${note} class="quiet">${note}</p>`)}
      </div>
      <span class="race-buttons">
        ${video && html`<${WatchButton} video=${video} name=${name} film=${film} />`}
        ${(state === "done" || state === "failed") && button("Drive again", `Drive again: ${name}`, "restart")}
        ${state !== "queued" && button("Withdraw", `Withdraw ${name}`, "withdraw")}
      </span>
    </li>`;
}
