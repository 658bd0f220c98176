// Tracks to choose from: outline, name, length, width, direction; with search and sort.

import { number } from "/text.js";
import { SelectField, TextField } from "/fields.js";
import { Empty, Prose, html, useState } from "/ui.js";

const ORDERS = [
  ["name", "Name"],
  ["length_m", "Length"],
  ["width_m", "Width"],
  ["direction", "Direction"],
];

function Outline({ track }) {
  if (!track.outline) return html`<svg class="track-outline" aria-hidden="true"></svg>`;
  const { inner, outer, start } = track.outline;
  const points = [...inner, ...outer];
  const xs = points.map(([x]) => x);
  const ys = points.map(([, y]) => -y);
  const [left, top] = [Math.min(...xs), Math.min(...ys)];
  const [wide, high] = [Math.max(...xs) - left, Math.max(...ys) - top];
  const margin = 0.06 * Math.max(wide, high);
  const line = (list) =>
    list.map(([x, y], k) => `${k ? "L" : "M"} ${x} ${-y}`).join(" ") + (track.closed ? " Z" : "");
  const road = track.closed
    ? `${line(outer)} ${line(inner)}`
    : `${line(outer)} ${line([...inner].reverse()).replace("M", "L")} Z`;
  return html`
    <svg class="track-outline" aria-hidden="true" viewBox=${`${left - margin} ${top - margin} ${wide + 2 * margin} ${high + 2 * margin}`}>
      <path class="track-road" fill-rule="evenodd" d=${road} />
      ${[inner, outer].map((border) => html`<path class="track-edge" d=${line(border)} stroke-width=${margin / 5} />`)}
      <circle class="track-start" cx=${start[0]} cy=${-start[1]} r=${margin / 1.6} />
    </svg>`;
}

const byOrder = (order) => (a, b) =>
  (typeof a[order] === "number"
    ? a[order] - b[order]
    : String(a[order]).localeCompare(String(b[order]))) || a.name.localeCompare(b.name);

/**
 * A list of tracks of which one is chosen, and others are trained too.
 * @param {{found: {tracks: Object[], community: string[], unreadable: string[]}, chosen: string, further: string,
 *   onChoose: (name: string) => void, onFurther: (words: string) => void}} props
 *   `found` is the answer of /api/track-list; `further` the words of DR_TRAIN_WORLDS
 */
export function TrackPicker({ found, chosen, further, onChoose, onFurther }) {
  const [wanted, setWanted] = useState("");
  const [order, setOrder] = useState("name");
  const words = further.split(/[\s,]+/).filter(Boolean);
  const train = (name, too) => {
    const others = words.filter((word) => word !== name);
    onFurther([...others, ...(too ? [name] : [])].join(", "));
  };
  const letters = wanted.trim().toLowerCase();
  const shown = found.tracks
    .filter((track) =>
      `${track.name} ${track.direction} ${track.about}`.toLowerCase().includes(letters),
    )
    .sort(byOrder(order));
  const about = (track) => [
    `${number(track.length_m, 1, "m")} long`,
    `${number(track.width_m, 2, "m")} wide`,
    track.direction,
    track.difficulty,
  ];
  return html`
    <div class="track-picker">
      <div class="row">
        <${TextField} label="Search tracks" type="search" value=${wanted} onInput=${setWanted} placeholder="Name or direction" />
        <${SelectField} label="Sort by" options=${ORDERS} value=${order} onChange=${setOrder} />
      </div>
      <div class="tracks" role="radiogroup" aria-label="Track" data-key="DR_WORLD_NAME">
        ${shown.map(
          (track) => html`<div class="track-card" key=${track.name}>
          <label class="track">
            <input type="radio" name="track" value=${track.name} checked=${track.name === chosen} onChange=${() => onChoose(track.name)} />
            <${Outline} track=${track} />
            <span class="track-name">${track.name}</span>
            <span class="quiet">${about(track).filter(Boolean).join(", ")}</span>
          </label>
          <label class="track-further">
            <input type="checkbox" aria-label=${`Train on ${track.name} too`} checked=${words.includes(track.name)}
              disabled=${track.name === chosen} onChange=${(event) => train(track.name, event.currentTarget.checked)} />
            Train here too
          </label>
        </div>`,
        )}
        ${
          !shown.length &&
          html`<${Empty} text="No installed track has these letters.">
          <button type="button" onClick=${() => setWanted("")}>Show all</button>
        <//>`
        }
      </div>
      <p class="readout" role="status">${shown.length} of ${found.tracks.length} installed tracks</p>
      ${found.unreadable.length > 0 && html`<ul class="problem">${found.unreadable.map((text) => html`<li>${text}</li>`)}</ul>`}
      ${
        found.community.length > 0 &&
        html`<details>
        <summary>${found.community.length} tracks of the community, not installed</summary>
        <${SelectField} label="Track of the community" value=${found.community.includes(chosen) ? chosen : ""}
          options=${[["", "Choose one"], ...found.community]} onChange=${(name) => name && onChoose(name)}
          help="It is downloaded when the training starts, after a question. Your own tracks are files in tracks/." />
      </details>`
      }
      <p class="quiet" role="status">${
        found.tracks.some((track) => track.name === chosen)
          ? ""
          : html`<${Prose}
        text=${`Chosen: ${chosen || "none"}${found.community.includes(chosen) ? ", which is not installed yet" : ""}.`} />`
      }</p>
    </div>`;
}
