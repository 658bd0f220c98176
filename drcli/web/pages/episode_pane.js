// One lap at one step: camera, numbers, choices of the policy, reward and its parameters.

import { number } from "/text.js";
import { Choice, Failure, Folded, Table, Tick, Tiles, html } from "/ui.js";
import { useEffect, useMemo, useRef, useState } from "/ui.js";

const quiet = (...text) => html`<p class="quiet">${text}</p>`;

/** The newest value that was there: what is shown stays while the next is fetched. */
function useLast(value) {
  const last = useRef(null);
  if (value) last.current = value;
  return last.current;
}

/**
 * @param {{data: any, row: number, name: string, color: string, links: any}} props data: the EpisodeData
 */
export function EpisodePane({ data, row, name, color, links }) {
  const { facts, lap } = data;
  const summary = facts.episodes[Number(data.query.episode)];
  const total = useMemo(() => {
    let sum = 0;
    return lap.reward.map((value) => (sum += value ?? 0));
  }, [lap]);
  const [open, setOpen] = useState(matchMedia("(min-width: 700px)").matches);
  useEffect(() => data.want(row), [data, row]);
  const choice = data.choice(row);
  const last = useLast(choice && { ...choice, row });
  const problems = [data.problem, data.policyProblem].filter(Boolean);
  const inTrace = lap.step[0] === 1 ? "" : ` (${number(lap.step[row])} in the trace)`;
  return html`
    <section class="episode-pane" aria-label=${`${name}: ${data.query.model}`}>
      <h2><span class=${`swatch ink-${color}`}></span>${facts.title}, episode ${summary?.number}</h2>
      <p class="quiet">${`${data.query.model}${facts.world ? ` on ${facts.world}` : ""}: ${summary?.text ?? ""}, progress ${number(summary?.progress, 1, "%")}, ${number(summary?.seconds, 2, "s")}`}</p>
      ${facts.notes.map((note) => html`<p key=${note} class="problem">${note}</p>`)}
      ${problems.map((error) => html`<${Failure} key=${error.message} error=${error} />`)}
      ${problems.length > 0 && html`<p><button type="button" onClick=${() => data.retry()}>Try again</button></p>`}
      <p class="actions">${links}</p>
      <div class="pane-columns">
        <${CameraPicture} data=${data} row=${row} name=${name} />
        <div class="pane-choices">
          <h3>Choice of the policy at this picture</h3>
          <div class="choices">${choicesOf(data, last)}</div>
          <${Tick} label="Show which pixels move the action (key E)" on=${data.explains}
            disabled=${data.checkpoint === null} set=${(on) => data.explain(on)} />
          ${policyChoice(data)}
        </div>
      </div>
      <${Tiles} values=${[
        ["Step", `${row + 1} of ${data.rows}${inTrace}`],
        ["Time", number(lap.time_s[row], 2, "s")],
        ["Progress", number(lap.progress[row], 1, "%")],
        ["Speed driven", number(lap.driven_mps[row], 2, "m/s")],
        ["Speed asked for", number(lap.speed_mps[row], 2, "m/s")],
        ["Steering", `${number(lap.steering_deg[row], 1)}°`],
        ["Reward", number(lap.reward[row], 4)],
        ["Reward so far", number(total[row], 2)],
        ["State", lap.state[row]],
        ["Critic expects", choice?.value ? number(choice.value[choice.at], 2) : "–"],
      ]} />
      <${Folded} title="Reward parameters of this step" open=${open} onToggle=${setOpen}>
        <div class="parameters"><${Parameters} data=${data} row=${row} /></div>
      <//>
    </section>`;
}

function CameraPicture({ data, row, name }) {
  const [damaged, setDamaged] = useState(null);
  const { blob, explained } = data.picture(row);
  const url = useMemo(() => blob && URL.createObjectURL(blob), [blob]);
  useEffect(() => () => URL.revokeObjectURL(url), [url]);
  const newest = useLast(url);
  const note = () => {
    if (!data.facts.outline) return "The track is not known here, so there are no pictures.";
    if (!blob) return data.problem ? "There is no picture." : "The picture is drawn …";
    if (blob === damaged) return "This picture is damaged.";
    if (explained) return "Camera with the pixels that move the action: yellow most.";
    return data.explains && data.checkpoint !== null && !data.policyProblem
      ? "The map is computed …"
      : "Camera, drawn again from the recorded pose.";
  };
  return html`
    <figure class="camera">
      <img src=${newest} width=${160 * Math.max(data.facts.eyes, 1)} height="120"
        alt=${`Camera of the ${name} at step ${row + 1}`} onError=${() => setDamaged(blob)} />
      <p class="camera-note quiet">${note()}</p>
    </figure>`;
}

/** Which checkpoint looks at the pictures. */
function policyChoice(data) {
  const { checkpoint, available, sentence } = data.facts.policy;
  const options = available.map((each) => [
    String(each),
    each === checkpoint ? `${each} (drove this)` : String(each),
  ]);
  return html`<div>
    ${sentence && quiet(sentence)}
    ${
      available.length > 0 &&
      html`<${Choice} label="Checkpoint that looks" options=${[["", "none"], ...options]}
        value=${String(data.checkpoint ?? "")}
        onChange=${(value) => data.look(value === "" ? null : Number(value))} />`
    }
  </div>`;
}

function choicesOf(data, last) {
  if (data.policyProblem) return quiet("The policy cannot be asked.");
  if (!data.facts.outline) return quiet("Without the track there are no pictures to ask about.");
  if (data.checkpoint === null) return quiet("No checkpoint looks at the pictures.");
  if (!last)
    return quiet("The policy is loaded and asked; the first time this takes some seconds …");
  const next = last.row + 1 < data.rows ? last.row + 1 : null;
  return html`<${last.actions ? Discrete : Continuous} lap=${data.lap} choice=${last} next=${next} />`;
}

function Discrete({ lap, choice, next }) {
  const taken = next === null ? -1 : Number.parseInt(lap.action[next], 10);
  const shares = choice.probabilities[choice.at];
  const most = Math.max(...shares);
  const note =
    next === null
      ? "The episode ends here, so no further action was driven."
      : shares[taken] === undefined
        ? ""
        : "“driven” is the action that followed this picture.";
  return html`
    <ol class="bars" start="0">${choice.actions.map(
      ([angle, speed], k) => html`
      <li key=${k} class=${`${k === taken ? "taken" : ""} ${shares[k] === most ? "most" : ""}`}>
        <span class="bar-name">${k}: ${number(angle, 0)}°, ${number(speed, 1)} m/s</span>
        <span class="bar-room"><span class="bar-fill" style=${{ transform: `scaleX(${shares[k]})` }}></span></span>
        <span class="bar-value">${number(100 * shares[k], 1)} %${k === taken ? " driven" : ""}</span>
      </li>`,
    )}</ol>
    <p class="choice-note quiet">${[note, choice.no_value].filter(Boolean).join(" ")}</p>`;
}

function Continuous({ lap, choice, next }) {
  const { at, low, high } = choice;
  const row = (name, asked, driven, k, digits, unit) => [
    name,
    number(asked[at], digits, unit) +
      (low && high ? ` (${number(low[at][k], 1)} to ${number(high[at][k], 1)} in training)` : ""),
    next === null ? "–" : number(driven[next], digits, unit),
  ];
  const rows = [
    row("Steering", choice.steering_deg, lap.steering_deg, 0, 1, "°"),
    row("Speed", choice.speed_mps, lap.speed_mps, 1, 2, "m/s"),
  ];
  return html`
    <${Table} label="Continuous action" heads=${["Action", "Asked for", "Driven next"]} rows=${rows} />
    ${choice.no_value && quiet(choice.no_value)}`;
}

function Parameters({ data, row }) {
  const found = useLast(data.parameters(row));
  const { outline } = data.facts;
  if (!outline)
    return quiet("The track is not known here, so the parameters cannot be worked out.");
  if (!found) return quiet("The parameters are computed …");
  const { columns, constants, at } = found;
  const values = { ...constants };
  for (const name of Object.keys(columns)) values[name] = columns[name][at];
  const names = [...Object.keys(columns), ...Object.keys(constants)].sort(
    (a, b) => Number(data.isUsed(b)) - Number(data.isUsed(a)),
  );
  const unknown = Object.groupBy(Object.keys(found.unknown), (name) => found.unknown[name]);
  const reasons = Object.entries(unknown).map(([why, of]) => `${of.join(", ")}: ${why}`);
  return html`
    <dl class="parameter-grid">${names.map(
      (name) => html`<div key=${name} class=${data.isUsed(name) ? "used" : null}>
        <dt>${name}</dt><dd data-name=${name}>${valueText(values[name])}</dd></div>`,
    )}</dl>
    ${quiet(
      names.some(data.isUsed)
        ? "Those with a bar at their side are named in the reward function of the model. "
        : "",
      `waypoints: ${outline.center.length} points of the centre line, drawn on the map.`,
    )}
    ${reasons.length > 0 && quiet(`Not known: ${reasons.join(" ")}`)}`;
}

function valueText(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : value.toFixed(3);
  if (Array.isArray(value))
    return value.length > 8 ? `${value.length} values` : `[${value.map(valueText).join(", ")}]`;
  return String(value);
}
