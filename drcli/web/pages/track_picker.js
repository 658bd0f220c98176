// Tracks to choose from: outline, name, length, width, direction; with search and sort.

import { Field } from "/fields.js";
import { Empty, html, useState } from "/ui.js";

function Outline({ outline }) {
  if (!outline) return html`<svg class="track-outline" aria-hidden="true"></svg>`;
  const { box, road, edges, start, margin } = outline;
  return html`
    <svg class="track-outline" aria-hidden="true" viewBox=${box}>
      <path class="track-road" fill-rule="evenodd" d=${road} />
      ${edges.map((edge) => html`<path key=${edge} class="track-edge" d=${edge} stroke-width=${margin / 5} />`)}
      <circle class="track-start" cx=${start[0]} cy=${start[1]} r=${margin / 1.6} />
    </svg>`;
}

const byOrder = (order) => (a, b) =>
  (typeof a[order] === "number"
    ? a[order] - b[order]
    : String(a[order]).localeCompare(String(b[order]))) || a.name.localeCompare(b.name);

/**
 * A list of tracks of which one is chosen, and others are trained too.
 * @param {{found: {tracks: Object[], orders: string[][], community: string[], unreadable: string[]}, chosen: string, further: string,
 *   onChoose: (name: string) => void, onFurther: (words: string) => void}} props
 *   `found` is the answer of /api/track-list; `further` the words of DR_TRAIN_WORLDS
 */
export function TrackPicker({ found, chosen, further, onChoose, onFurther }) {
  const [wanted, setWanted] = useState("");
  const [order, setOrder] = useState("name");
  const words = further.split(/[\s,]+/).filter(Boolean);
  const train = (name, too) => {
    const others = words.filter((word) => word !== name);
    onFurther((too ? [...others, name] : others).join(", "));
  };
  const installed = found.tracks.some((track) => track.name === chosen);
  const isOfCommunity = found.community.includes(chosen);
  const letters = wanted.trim().toLowerCase();
  const shown = found.tracks
    .filter((track) =>
      `${track.name} ${track.direction} ${track.about}`.toLowerCase().includes(letters),
    )
    .sort(byOrder(order));
  return html`
    <div class="track-picker">
      <div class="row">
        <${Field} label="Search tracks" type="search" value=${wanted} set=${setWanted} placeholder="Name or direction" />
        <${Field} label="Sort by" options=${found.orders} value=${order} set=${setOrder} />
      </div>
      <div class="tracks" role="radiogroup" aria-label="Track" data-key="DR_WORLD_NAME">
        ${shown.map(
          (track) => html`<div class="track-card" key=${track.name}>
          <label class="track">
            <input type="radio" name="track" value=${track.name} checked=${track.name === chosen} onChange=${() => onChoose(track.name)} />
            <${Outline} outline=${track.outline} />
            <span class="track-name">${track.name}</span>
            <span class="quiet">${track.facts}</span>
          </label>
          <label class="track-further">
            <input type="checkbox" aria-label=${`Train on ${track.name} too`} checked=${words.includes(track.name)}
              disabled=${track.name === chosen} onChange=${(event) => train(track.name, event.currentTarget.checked)} />
            Train here too
          </label>
        </div>`,
        )}
        ${!shown.length && html`<${Empty} text="No installed track has these letters."><button type="button" onClick=${() => setWanted("")}>Show all</button><//>`}
      </div>
      <p class="readout" role="status">${shown.length} of ${found.tracks.length} installed tracks</p>
      ${found.unreadable.length > 0 && html`<ul class="problem">${found.unreadable.map((text) => html`<li>${text}</li>`)}</ul>`}
      ${
        found.community.length > 0 &&
        html`<details>
        <summary>${found.community.length} tracks of the community, not installed</summary>
        <${Field} label="Track of the community" value=${isOfCommunity ? chosen : ""}
          options=${[["", "Choose one"], ...found.community]} set=${(name) => name && onChoose(name)}
          help="It is downloaded when the training starts, after a question. Your own tracks are files in tracks/." />
      </details>`
      }
      <p class="quiet" role="status">${installed ? "" : `Chosen: ${chosen || "none"}${isOfCommunity ? ", which is not installed yet" : ""}.`}</p>
    </div>`;
}
