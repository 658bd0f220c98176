// The picture of a reward function: reward at each place of the track, and along the lap.

import { boundsOf } from "/map_parts.js";
import { Plot } from "/plot.js";
import { number, short } from "/text.js";
import { TrackMap } from "/track_map.js";
import { Table, html, useMemo, useRef } from "/ui.js";

const COLORS = ["c1", "c2", "c3", "c4", "c5", "c6"];
const AXES = { x: "Progress, %", left: "Reward" };

/** Where the places of a course lie on the map, with the numbers of their rewards. */
function placesOf({ rows, columns, edges, closed }) {
  const corner = (row, column) => edges[row * columns + (column % columns)];
  // From the outside in: where parts of the track are close together, the road is on top.
  const far = (row) => Math.abs(row - (rows >> 1));
  const outside = Array.from({ length: rows }, (_, row) => row).sort((a, b) => far(b) - far(a));
  return outside.flatMap((row) =>
    Array.from({ length: closed ? columns : columns - 1 }, (_, column) => ({
      index: row * columns + column,
      corners: [
        ...[corner(row, column), corner(row, column + 1)],
        ...[corner(row + 1, column + 1), corner(row + 1, column)],
      ],
    })),
  );
}

/** Middle and heading of an object, of which the corners are known. */
function poseOf([a, b, c]) {
  return [(a[0] + c[0]) / 2, (a[1] + c[1]) / 2, Math.atan2(b[1] - a[1], b[0] - a[0])];
}

/** @param {{course: any, report: any}} props the answer of /api/reward/check, and the newest course that one had */
export function RewardPicture({ course, report }) {
  const kept = useRef(null);
  const curved = useRef(null); // the map is there before the curves
  if (report?.picture) kept.current = report;
  const { picture, report: numbers } = kept.current ?? {};
  if (picture?.curves.length) curved.current = picture;
  const map = useMemo(() => {
    if (!course) return null;
    const [x, y, yaw] = course.start;
    return {
      ...{ track: course, within: boundsOf(course.edges), places: placesOf(course) },
      ...{ objects: course.objects.map(poseOf), cars: [{ x, y, yaw, color: "paper" }] },
    };
  }, [course]);
  const cells = useMemo(
    () =>
      map &&
      picture && {
        name: "Reward per step",
        range: [picture.low, picture.high],
        corners: map.places.map((place) => place.corners),
        values: map.places.map((place) => picture.rewards[place.index]),
      },
    [map, picture],
  );
  const plot = useMemo(() => {
    const { curves, progress } = curved.current ?? {};
    return (
      curves && {
        series: curves.map((each, k) => ({ name: each.name, color: COLORS[k % 6], digits: 3 })),
        data: [progress, ...curves.map((each) => each.rewards)],
      }
    );
  }, [curved.current]);
  const old = report && !report.picture && picture;
  const about = old
    ? "This is the picture of an earlier version."
    : picture && course
      ? `${course.world}, ${course.race_type}; the car requests ${number(course.speed_mps, 1, "m/s")}. The arrow is the start.`
      : "";
  return html`
    <figure class=${`reward-picture${old ? " old" : ""}`}>
      <figcaption><strong>Reward on the track</strong> for a car at this place that points along the track</figcaption>
      <${TrackMap} label="Map of rewards; the tables below have the numbers" height=${null} ...${map ?? { track: null }} cells=${cells} />
      <p class="readout">${about}</p>
      <div class="reward-curves">${plot && html`<${Plot} title="Reward along the lap" hint="of scripted drivers, per step" x="Progress" axes=${AXES} height=${220} ...${plot} />`}</div>
      ${numbers && html`<${Numbers} report=${numbers} />`}
    </figure>`;
}

function Numbers({ report }) {
  const place = (extreme) => (extreme ? `${short(extreme.reward)} (${extreme.place})` : "–");
  const drivers = report.drivers.map(({ name, about, progress, seconds, total, mean }) => [
    ...[name, about, number(progress, 1), number(seconds, 1), short(total), short(mean)],
  ]);
  const time =
    report.time &&
    `A call takes ${number(report.time.median_us, 1)} µs (median), which makes the simulation ${number(report.time.slower_percent, 1)} % slower.`;
  return html`
    <details>
      <summary>Numbers of the check</summary>
      <${Table} caption="Drivers" heads=${["Driver", "Drives", "Progress, %", "Time, s", "Sum of rewards", "Mean"]} rows=${drivers} />
      <p>${number(report.calls)} calls. Least reward ${place(report.least)}, greatest ${place(report.greatest)}. ${time}</p>
      <${Table} caption="Parameters" heads=${["Parameter", "Least", "Greatest", "Read"]}
        rows=${report.parameters.map((each) => [each.name, short(each.least), short(each.greatest), each.read ? "yes" : "no"])} />
    </details>`;
}
