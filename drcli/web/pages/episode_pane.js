// One lap at one step: camera, numbers, choices of the policy, reward and its parameters.

import { failure, fill, h, number, tiles } from "/dom.js";
import { STATUS, traceTitle } from "/episode_chooser.js";

const TILES = [
  "Step",
  "Time",
  "Progress",
  "Speed driven",
  "Speed asked for",
  "Steering",
  "Reward",
  "Reward so far",
  "State",
  "Critic expects",
];

/** The pane of an episode; returns its element and `show(row)`. */
export function episodePane(data, { name, color, links }, signal) {
  const { facts, lap } = data,
    summary = facts.episodes[Number(data.query.episode)];
  const eyes = Math.max(facts.eyes, 1);
  const canvas = h("canvas", {
    width: 160 * eyes,
    height: 120,
    role: "img",
    "aria-label": `Camera of the ${name}`,
  });
  const caption = h("p", { class: "camera-note quiet" }, " ");
  const [figures, setFigures] = tiles(TILES);
  const bars = h("div", { class: "choices" }),
    parameters = h("div", { class: "parameters" }),
    trouble = h("div", {});
  const explain = h("input", {
    type: "checkbox",
    change: () => {
      data.explain(explain.checked);
      show(shown);
    },
  });
  const total = sums(lap.reward);
  const choose = policySelect(data, () => show(shown));
  const element = h(
    "section",
    { class: "episode-pane", "aria-label": `${name}: ${data.query.model}` },
    h(
      "h2",
      {},
      h("span", { class: `swatch ink-${color}` }),
      `${traceTitle(facts)}, episode ${summary?.number ?? ""}`,
    ),
    h(
      "p",
      { class: "quiet" },
      `${data.query.model}${facts.world ? ` on ${facts.world}` : ""}: ${summary?.text ?? ""}, progress ${number(summary?.progress, 1, "%")}, ${number(summary?.seconds, 2, "s")}`,
    ),
    facts.notes.map((note) => h("p", { class: "problem" }, note)),
    trouble,
    h("p", { class: "actions" }, links),
    h(
      "div",
      { class: "pane-columns" },
      h("figure", { class: "camera" }, canvas, caption),
      h(
        "div",
        { class: "pane-choices" },
        h("h3", {}, "Choice of the policy at this picture"),
        bars,
        h(
          "label",
          { class: "tick" },
          explain,
          h("span", {}, "Show which pixels move the action (key E)"),
        ),
        choose,
      ),
    ),
    figures,
    h(
      "details",
      { class: "parameter-list", open: matchMedia("(min-width: 700px)").matches },
      h("summary", {}, "Reward parameters of this step"),
      parameters,
    ),
  );
  if (data.checkpoint === null) explain.disabled = true;
  let shown = 0,
    turn = 0,
    painted = null;

  async function paint(row) {
    const { blob, explained } = data.picture(row);
    if (!facts.outline) {
      caption.textContent = "The track is not known here, so there are no pictures.";
      return;
    }
    if (blob === null) {
      caption.textContent = data.problem ? "There is no picture." : "The picture is drawn …";
      return;
    }
    caption.textContent = explained
      ? "Camera with the pixels that move the action: yellow most."
      : data.explains && data.checkpoint !== null && !data.policyProblem
        ? "The map is computed …"
        : "Camera, drawn again from the recorded pose.";
    if (blob === painted) return;
    const mine = ++turn;
    try {
      const bitmap = await createImageBitmap(blob);
      if (mine !== turn || signal.aborted) return;
      if (canvas.width !== bitmap.width) canvas.width = bitmap.width;
      canvas.getContext("2d").drawImage(bitmap, 0, 0);
      bitmap.close();
      painted = blob;
    } catch {
      caption.textContent = "This picture is damaged.";
    }
  }

  function show(row) {
    shown = row;
    explain.checked = data.explains;
    explain.disabled = data.checkpoint === null;
    data.want(row);
    paint(row);
    const choice = data.choice(row);
    setFigures([
      lap.step[0] === 1
        ? `${row + 1} of ${data.rows}`
        : `${row + 1} of ${data.rows} (${number(lap.step[row])} in the trace)`,
      number(lap.time_s[row], 2, "s"),
      number(lap.progress[row], 1, "%"),
      number(lap.driven_mps[row], 2, "m/s"),
      number(lap.speed_mps[row], 2, "m/s"),
      `${number(lap.steering_deg[row], 1)}°`,
      number(lap.reward[row], 4),
      number(total[row], 2),
      STATUS[lap.status[row]] ?? lap.status[row],
      choice?.value ? number(choice.value[choice.at], 2) : "–",
    ]);
    showChoices(bars, data, row, choice);
    showParameters(parameters, data, row);
    const problems = [data.problem, data.policyProblem].filter(Boolean);
    if (problems.length !== trouble.childElementCount / 2) {
      fill(
        trouble,
        problems.flatMap((error) => [
          failure(error),
          h(
            "p",
            {},
            h(
              "button",
              {
                type: "button",
                click: () => {
                  data.retry();
                  show(shown);
                },
              },
              "Try again",
            ),
          ),
        ]),
      );
    }
  }

  return {
    element,
    show,
    toggleExplanation() {
      if (!explain.disabled) {
        data.explain(!data.explains);
        show(shown);
      }
    },
  };
}

/** Which checkpoint looks at the pictures. */
function policySelect(data, changed) {
  const { checkpoint, available, sentence } = data.facts.policy;
  const note = sentence ? h("p", { class: "quiet" }, sentence) : null;
  if (!available.length) return note;
  const text = (number) => (number === checkpoint ? `${number} (drove this)` : `${number}`);
  const select = h(
    "select",
    {
      change: () => {
        data.look(select.value === "" ? null : Number(select.value));
        changed();
      },
    },
    h("option", { value: "" }, "none"),
    available.map((each) =>
      h("option", { value: String(each), selected: each === data.checkpoint }, text(each)),
    ),
  );
  return h(
    "div",
    {},
    note,
    h("label", { class: "pick" }, h("span", {}, "Checkpoint that looks"), select),
  );
}

function showChoices(place, data, row, choice) {
  if (data.checkpoint === null || data.policyProblem || !data.facts.outline) {
    fill(
      place,
      h(
        "p",
        { class: "quiet" },
        data.policyProblem
          ? "The policy cannot be asked."
          : !data.facts.outline
            ? "Without the track there are no pictures to ask about."
            : "No checkpoint looks at the pictures.",
      ),
    );
    return;
  }
  if (!choice) {
    if (!place.childElementCount)
      fill(
        place,
        h(
          "p",
          { class: "quiet" },
          "The policy is loaded and asked; the first time this takes some seconds …",
        ),
      );
    return;
  }
  const next = row + 1 < data.rows ? row + 1 : null;
  if (choice.actions) discrete(place, data, choice, next);
  else continuous(place, data, choice, next);
}

function discrete(place, data, choice, next) {
  const taken = next === null ? -1 : Number.parseInt(data.lap.action[next], 10),
    shares = choice.probabilities[choice.at];
  if (place.dataset.rows !== String(shares.length)) {
    place.dataset.rows = String(shares.length);
    fill(
      place,
      h(
        "ol",
        { class: "bars" },
        choice.actions.map(([angle, speed]) =>
          h(
            "li",
            {},
            h("span", { class: "bar-name" }, `${number(angle, 0)}°, ${number(speed, 1)} m/s`),
            h("span", { class: "bar-room" }, h("span", { class: "bar-fill" })),
            h("span", { class: "bar-value" }),
          ),
        ),
      ),
      h("p", { class: "choice-note quiet" }),
    );
  }
  const most = Math.max(...shares);
  [...place.firstChild.children].forEach((item, k) => {
    item.classList.toggle("taken", k === taken);
    item.classList.toggle("most", shares[k] === most);
    item.querySelector(".bar-fill").style.setProperty("transform", `scaleX(${shares[k]})`);
    item.querySelector(".bar-value").textContent =
      `${number(100 * shares[k], 1)} %${k === taken ? " driven" : ""}`;
  });
  const note =
    next === null
      ? "The episode ends here, so no further action was driven."
      : taken >= 0 && taken < shares.length
        ? "“driven” is the action that followed this picture."
        : "";
  place.querySelector(".choice-note").textContent = [note, choice.no_value]
    .filter(Boolean)
    .join(" ");
}

function continuous(place, data, choice, next) {
  delete place.dataset.rows;
  const { at, low, high } = choice,
    spread = (k) =>
      low && high ? ` (${number(low[at][k], 1)} to ${number(high[at][k], 1)} in training)` : "";
  const driven =
    next === null
      ? ["–", "–"]
      : [`${number(data.lap.steering_deg[next], 1)}°`, number(data.lap.speed_mps[next], 2, "m/s")];
  fill(
    place,
    h(
      "table",
      {},
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          ["", "Asked for", "Driven next"].map((head) => h("th", { scope: "col" }, head)),
        ),
      ),
      h(
        "tbody",
        {},
        h(
          "tr",
          {},
          h("th", { scope: "row" }, "Steering"),
          h("td", {}, `${number(choice.steering_deg[at], 1)}°${spread(0)}`),
          h("td", {}, driven[0]),
        ),
        h(
          "tr",
          {},
          h("th", { scope: "row" }, "Speed"),
          h("td", {}, `${number(choice.speed_mps[at], 2)} m/s${spread(1)}`),
          h("td", {}, driven[1]),
        ),
      ),
    ),
    choice.no_value ? h("p", { class: "quiet" }, choice.no_value) : null,
  );
}

function showParameters(place, data, row) {
  const found = data.parameters(row);
  if (!found) {
    if (!place.childElementCount || !data.facts.outline)
      fill(
        place,
        h(
          "p",
          { class: "quiet" },
          data.facts.outline
            ? "The parameters are computed …"
            : "The track is not known here, so the parameters cannot be worked out.",
        ),
      );
    return;
  }
  const names = [...Object.keys(found.columns), ...Object.keys(found.constants)].sort(
    (a, b) => Number(data.isUsed(b)) - Number(data.isUsed(a)),
  );
  const key = names.join();
  if (place.dataset.names !== key) {
    place.dataset.names = key;
    const unknown = Object.entries(found.unknown);
    const waypoints = data.facts.outline
      ? `waypoints: ${data.facts.outline.center.length} points of the centre line, drawn on the map.`
      : "";
    fill(
      place,
      h(
        "dl",
        { class: "parameter-grid" },
        names.map((name) =>
          h(
            "div",
            { class: data.isUsed(name) ? "used" : null },
            h("dt", {}, name),
            h("dd", { "data-name": name }),
          ),
        ),
      ),
      h(
        "p",
        { class: "quiet" },
        names.some(data.isUsed)
          ? "Those with a bar at their side are named in the reward function of the model. "
          : "",
        waypoints,
      ),
      unknown.length
        ? h(
            "p",
            { class: "quiet" },
            "Not known: ",
            [...new Set(unknown.map(([, why]) => why))].map(
              (why) =>
                `${unknown
                  .filter(([, each]) => each === why)
                  .map(([name]) => name)
                  .join(", ")}: ${why} `,
            ),
          )
        : null,
    );
  }
  for (const cell of place.querySelectorAll("dd")) {
    const { name } = cell.dataset,
      text = valueText(
        name in found.columns ? found.columns[name][found.at] : found.constants[name],
      );
    if (cell.textContent !== text) cell.textContent = text;
  }
}

function valueText(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : value.toFixed(3);
  if (Array.isArray(value))
    return value.length > 8 ? `${value.length} values` : `[${value.map(valueText).join(", ")}]`;
  return String(value);
}

function sums(values) {
  let sum = 0;
  return values.map((value) => (sum += value ?? 0));
}
