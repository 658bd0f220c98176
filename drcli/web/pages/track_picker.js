// Tracks to choose from: outline, name, length, width, direction; with search and sort.

import { empty, fill, h, number, prose } from "/dom.js";
import { svg } from "/svg.js";

const ORDERS = [
  ["name", "Name"],
  ["length_m", "Length"],
  ["width_m", "Width"],
  ["direction", "Direction"],
];

function outlineOf(track) {
  const drawing = svg("svg", { class: "track-outline", "aria-hidden": "true" });
  if (!track.outline) return drawing;
  const { inner, outer, start } = track.outline,
    all = [...inner, ...outer];
  const xs = all.map(([x]) => x),
    ys = all.map(([, y]) => -y);
  const [left, top] = [Math.min(...xs), Math.min(...ys)],
    wide = Math.max(...xs) - left,
    high = Math.max(...ys) - top;
  const margin = 0.06 * Math.max(wide, high);
  drawing.setAttribute(
    "viewBox",
    `${left - margin} ${top - margin} ${wide + 2 * margin} ${high + 2 * margin}`,
  );
  const line = (points) =>
    points.map(([x, y], k) => `${k ? "L" : "M"} ${x} ${-y}`).join(" ") + (track.closed ? " Z" : "");
  const add = (tag, attributes) => drawing.append(svg(tag, attributes));
  add("path", {
    class: "track-road",
    "fill-rule": "evenodd",
    d: track.closed
      ? `${line(outer)} ${line(inner)}`
      : `${line(outer)} ${line([...inner].reverse()).replace("M", "L")} Z`,
  });
  for (const border of [inner, outer])
    add("path", { class: "track-edge", d: line(border), "stroke-width": margin / 5 });
  add("circle", { class: "track-start", cx: start[0], cy: -start[1], r: margin / 1.6 });
  return drawing;
}

/**
 * A list of tracks of which one is chosen, and others are trained too.
 * @param {{tracks: Object[], community: string[]}} found answer of /api/track-list
 * @param {{choose: function(string): void, setFurther: function(string): void}} changed
 *   called with the name; with the words of DR_TRAIN_WORLDS
 */
export function trackPicker(found, changed) {
  let chosen = "",
    further = [],
    wanted = "",
    order = "name";
  const search = h("input", {
    type: "search",
    id: "track-search",
    placeholder: "Name or direction",
    autocomplete: "off",
    input: () => {
      wanted = search.value.trim().toLowerCase();
      draw();
    },
  });
  const sort = h(
    "select",
    {
      id: "track-sort",
      change: () => {
        order = sort.value;
        draw();
      },
    },
    ORDERS.map(([value, name]) => h("option", { value }, name)),
  );
  const list = h("div", { class: "tracks", role: "radiogroup", "aria-label": "Track" });
  const count = h("p", { class: "readout", role: "status" });
  const community = h(
    "select",
    {
      id: "track-community",
      change: () => {
        if (community.value) choose(community.value);
      },
    },
    h("option", { value: "" }, "Choose one"),
    found.community.map((name) => h("option", { value: name }, name)),
  );
  const now = h("p", { class: "quiet", role: "status" });
  const element = h(
    "div",
    { class: "track-picker" },
    h(
      "div",
      { class: "row" },
      h("div", { class: "field" }, h("label", { for: "track-search" }, "Search tracks"), search),
      h("div", { class: "field" }, h("label", { for: "track-sort" }, "Sort by"), sort),
    ),
    list,
    count,
    found.unreadable.length
      ? h(
          "ul",
          { class: "problem" },
          found.unreadable.map((text) => h("li", {}, text)),
        )
      : null,
    found.community.length
      ? h(
          "details",
          {},
          h("summary", {}, `${found.community.length} tracks of the community, not installed`),
          h(
            "div",
            { class: "field" },
            h("label", { for: "track-community" }, "Track of the community"),
            community,
            h(
              "p",
              { class: "help" },
              prose(
                "It is downloaded when the training starts, after a question. `dr-tracks fetch NAME` does it now; your own tracks are files in tracks/.",
              ),
            ),
          ),
        )
      : null,
    now,
  );

  function choose(name) {
    chosen = name;
    mark();
    changed.choose(name);
  }
  function train(name, too) {
    further = further.filter((word) => word !== name);
    if (too) further.push(name);
    changed.setFurther(further.join(", "));
  }
  function mark() {
    for (const input of list.querySelectorAll("input")) {
      const also = input.type === "checkbox";
      input.checked = also ? further.includes(input.value) : input.value === chosen;
      if (also) input.disabled = input.value === chosen;
    }
    community.value = found.community.includes(chosen) ? chosen : "";
    now.textContent = found.tracks.some((track) => track.name === chosen)
      ? ""
      : `Chosen: ${chosen || "none"}${found.community.includes(chosen) ? ", which is not installed yet" : ""}.`;
  }
  function draw() {
    const shown = found.tracks
      .filter((track) =>
        `${track.name} ${track.direction} ${track.about}`.toLowerCase().includes(wanted),
      )
      .sort(
        (a, b) =>
          (typeof a[order] === "number"
            ? a[order] - b[order]
            : String(a[order]).localeCompare(String(b[order]))) || a.name.localeCompare(b.name),
      );
    fill(
      list,
      shown.map((track) =>
        h(
          "div",
          { class: "track-card" },
          h(
            "label",
            { class: "track" },
            h("input", {
              type: "radio",
              name: "track",
              value: track.name,
              change: () => choose(track.name),
            }),
            outlineOf(track),
            h("span", { class: "track-name" }, track.name),
            h(
              "span",
              { class: "quiet" },
              `${number(track.length_m, 1, "m")} long, ${number(track.width_m, 2, "m")} wide, ${track.direction}${track.difficulty ? `, ${track.difficulty}` : ""}`,
            ),
          ),
          h(
            "label",
            { class: "track-further" },
            h("input", {
              type: "checkbox",
              value: track.name,
              "aria-label": `Train on ${track.name} too`,
              change: (event) => train(track.name, event.target.checked),
            }),
            "Train here too",
          ),
        ),
      ),
    );
    if (!shown.length)
      fill(
        list,
        empty(
          "No installed track has these letters.",
          h(
            "button",
            {
              type: "button",
              click: () => {
                search.value = "";
                wanted = "";
                draw();
                search.focus();
              },
            },
            "Show all",
          ),
        ),
      );
    count.textContent = `${shown.length} of ${found.tracks.length} installed tracks`;
    mark();
  }
  draw();
  return {
    element,
    set(name, words) {
      chosen = name;
      further = words.split(/[\s,]+/).filter(Boolean);
      mark();
    },
    focus: () => (list.querySelector("input[type=radio]:checked") ?? search).focus(),
  };
}
