// The pairs of a race: a table of everybody against everybody, or a bracket whose winners go on.

import { html } from "/ui.js";

function Side({ pair, side }) {
  const id = pair[side];
  const alone = pair.state === "alone";
  const won = !alone && pair.winner && pair.winner === id;
  return html`
    <div class=${`race-side${won ? " won" : ""}`}>
      <span>${id ? pair[`${side}_racer`] : alone ? "nobody" : "not known yet"}${won && html`<span class="race-won"> wins</span>`}</span>
      <span class="quiet">${pair.state === "done" && pair[`${side}_text`]}</span>
    </div>`;
}

function Pair({ pair, watch }) {
  const { state, said, first_racer: first, second_racer: second } = pair;
  return html`
    <li><div class=${`race-pair ${state}`}>
      <${Side} pair=${pair} side="first" />
      <${Side} pair=${pair} side="second" />
      <p class="race-pair-state">${said}${
        watch &&
        pair.videos.map(
          (video, k) =>
            html`<button type="button" key=${video} class="race-small"
            onClick=${() => watch(video, `${first} against ${second}, car of ${k ? second : first}`)}>${k ? "Video 2" : "Video"}</button>`,
        )
      }</p>
    </div></li>`;
}

/** @param {{race: Object, watch?: ((video: string, name: string) => void) | null}} props */
export function Pairs({ race, watch = null }) {
  if (!race.pairs.length)
    return html`<p class="quiet">Two submissions make a pair. There are not enough yet.</p>`;
  const bracket = race.rules.pairing === "bracket";
  const all = Object.entries(Object.groupBy(race.pairs, (pair) => pair.round_name));
  const rounds = all.map(
    ([name, pairs]) => html`
      <section key=${name} class=${bracket && "race-round"}>
        <h3>${name}</h3>
        <ol>${pairs.map((pair, k) => html`<${Pair} key=${k} pair=${pair} watch=${watch} />`)}</ol>
      </section>`,
  );
  if (!bracket) return html`<div class="race-rounds">${rounds}</div>`;
  return html`
    ${!race.drawn && html`<p class="quiet">The bracket is drawn when its first pair is driven, in the order of the queue; until then it changes with every submission.</p>`}
    <div class="scroll" tabindex="0" role="region" aria-label="Bracket"><div class="race-bracket">${rounds}</div></div>`;
}
