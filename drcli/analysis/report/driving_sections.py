"""Sections on actions, steering, ends of episodes and the horizon."""

import base64
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from drcli.analysis.findings.action_use import ActionShare, ActionUse
from drcli.analysis.findings.driven_steps import DiscountHorizon, EpisodeEnds
from drcli.analysis.findings.reward_rate import RewardFunctionTime, RewardRate
from drcli.analysis.findings.steering import Snaking, SteeringBalance, WheelsOff
from drcli.analysis.report.graphs import Graph, Section, dots_note, many_points
from drcli.analysis.report.markup import (
    UNKNOWN,
    Content,
    Html,
    bar,
    count,
    digits,
    element,
    percent,
    seconds,
    table,
)
from drcli.analysis.run import Run, StoredEvaluation
from drcli.base.installation import lazy_imports
from drcli.base.png_picture import INK, LINES, png
from drcli.tracks.limit_store import StoredLimit
from drcli.tracks.track_limit import LapRow, LostPlace, limit_text, lost_places
from drsim.arrays import Floats
from drsim.limit.fastest_line import points_of
from drsim.track.track import Track

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

with lazy_imports():
    from matplotlib import collections


def ends_section(ends: EpisodeEnds | None, off: WheelsOff | None) -> Section | None:
    if ends is None:
        return None
    most = max((part.ends for part in ends.parts), default=0)
    rows: list[list[Content]] = [
        [
            f"{part.first} to {part.last}",
            bar(part.ends / most if most else 0.0, kind="warm" if part.ends == most else ""),
            count(part.ends),
            count(part.passes),
            percent(100 * part.share),
        ]
        for part in ends.parts
    ]
    head = ["waypoints", "", "episodes that end there", "that came there", "share"]
    content: list[Content] = [
        element(
            "p",
            f"Late in the training {count(ends.episodes)} episodes ended, "
            f"{count(ends.complete)} of them with a clean lap.",
        ),
        table("Ends of episodes along the lap", head, rows, texts=2),
    ]
    if off is not None and off.steps:
        content.append(element("h3", "Wheels off the track"))
        laps = (
            ""
            if off.lap_share is None
            else f", and in {percent(100 * off.lap_share)} of those of clean laps"
        )
        content.append(
            element(
                "p", f"A wheel is off the track in {percent(100 * off.share)} of the steps{laps}."
            )
        )
        if off.places:
            places = [
                [str(place.waypoint), count(place.steps), percent(100 * place.share)]
                for place in off.places
            ]
            content.append(
                table(
                    "Waypoints with most of these steps",
                    ["waypoint", "steps", "share of the steps there"],
                    places,
                )
            )
    look = (
        "Look for one part of the lap in which many of the episodes that reach it end: one corner "
        "needs another speed or line. Ends all over the lap mean that it has not learned enough."
    )
    return Section("ends", "Where episodes end", "Ends", look, tuple(content))


def action_section(use: ActionUse | None) -> Section | None:
    if use is None:
        return None
    most = max((action.share for action in use.actions), default=0.0) or 1.0
    rows: list[list[Content]] = [
        [
            str(action.index) if not use.continuous else "",
            _number(action.steering_deg),
            _number(action.speed_mps),
            bar(action.share / most, kind="dead" if action.index in use.dead else ""),
            percent(100 * action.share),
            percent(100 * action.early_share),
            _remark(action, use),
        ]
        for action in use.actions
    ]
    head = ["action", "steering (degrees)", "speed (m/s)", "", "late", "first third", ""]
    if use.continuous:
        rows = [row[1:] for row in rows]
        head = head[1:]
    kind = "Cells of the continuous action space" if use.continuous else "Actions"
    look = (
        "Look for actions that are hardly used: each costs exploration, and a smaller action "
        "space learns faster; one action that is used almost always means that the car no "
        "longer tries others."
    )
    content = (
        _kept(use),
        table(f"{kind}, in {count(use.steps)} steps late in the training", head, rows, texts=0),
    )
    return Section("actions", "Actions", "Actions", look, content)


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else digits(value)


def _remark(action: ActionShare, use: ActionUse) -> str:
    if action.index in use.dead:
        return "dead"
    if action.index not in use.kept:
        return "rare"
    return "most used" if action.index == use.top else ""


def _kept(use: ActionUse) -> Html:
    all_, kept = len(use.actions), len(use.kept)
    noun = "cells" if use.continuous else "actions"
    if kept == all_:
        text = f"All {all_} {noun} are used in at least 2 % of the steps: none can be left out."
    else:
        text = (
            f"{kept} of {all_} {noun} are used in at least 2 % of the steps each; together they "
            f"are {percent(100 * use.kept_share)} of all steps, which a smaller action space "
            "with only these would keep."
        )
    if use.dead:
        text += f" Dead: {', '.join(map(str, use.dead))}."
    if use.variety is not None:
        text += (
            " At the same place of the lap the action varies by "
            f"{percent(100 * use.variety, digits=0)} of what chance would give"
        )
        if use.early_variety is not None:
            text += f" (at the beginning {percent(100 * use.early_variety, digits=0)})"
        text += "."
    return element("p", text)


def steering_section(balance: SteeringBalance | None, snaking: Snaking | None) -> Section | None:
    content: list[Content] = []
    if balance is not None:
        rows: list[list[Content]] = [
            [
                side,
                bar(share),
                percent(100 * share),
                UNKNOWN if needed is None else percent(100 * needed),
            ]
            for side, share, needed in (
                ("left", balance.left, balance.needed_left),
                ("right", balance.right, balance.needed_right),
            )
        ]
        head = ["side", "", "share of the steps", "where the track bends there"]
        content.append(table("Steering to each side, late in the training", head, rows, texts=2))
        mean = f"The mean steering is {balance.mean_deg:+.1f} degrees (left is positive)"
        if balance.needed_deg is not None:
            mean += f"; the track needs {balance.needed_deg:+.1f} at these speeds"
        content.append(element("p", f"{mean}."))
    if snaking is not None:
        text = (
            f"The steering changes its side {digits(snaking.changes_per_m)} times a metre, and "
            f"{percent(100 * snaking.hard_changes)} of the steps go from hard on one side to hard "
            "on the other."
        )
        if snaking.regularity > 0:
            text += (
                f" It swings by about {digits(snaking.amplitude_deg)} degrees every "
                f"{digits(snaking.period_s)} s (regularity {digits(snaking.regularity)}, where 0 "
                "is chance and 2 a pure swing)."
            )
        content += [element("h3", "Snaking"), element("p", text)]
    if not content:
        return None
    look = (
        "Look for a side that is used although the track does not bend there, and for steering "
        "that swings from side to side: both cost speed, and the physical car shows them worse."
    )
    return Section("steering", "Steering", "Steering", look, tuple(content))


def horizon_section(
    horizon: DiscountHorizon | None, time: RewardFunctionTime | None
) -> Section | None:
    content: list[Content] = []
    if horizon is not None:
        if math.isinf(horizon.steps):
            text = "The discount factor is 1: rewards count the same however late they come."
        else:
            text = (
                f"With a discount factor of {horizon.discount:g} the learner looks about "
                f"{digits(horizon.steps)} steps ahead, {digits(horizon.seconds)} s"
            )
            if horizon.metres is not None:
                text += f", which is {digits(horizon.metres)} m at the present speed"
            if horizon.lap_m is not None and horizon.lap_share is not None:
                text += (
                    f": {percent(100 * horizon.lap_share, digits=0)} of a lap of "
                    f"{digits(horizon.lap_m)} m"
                )
            text += "."
        if horizon.lap_share is not None:
            content.append(bar(horizon.lap_share, title="Horizon as a part of the lap", alone=True))
        content.insert(0, element("p", text))
    if time is not None:
        content += [
            element("h3", "Time in the reward function"),
            element(
                "p",
                f"Half of the calls took at most {digits(time.p50_ms)} ms and 99 % at most "
                f"{digits(time.p99_ms)} ms; {count(time.calls)} calls took "
                f"{digits(time.total_s)} s together.",
            ),
        ]
    if not content:
        return None
    look = (
        "Look at whether the horizon reaches past the next corner: what happens beyond it hardly "
        "changes what the car learns."
    )
    return Section("horizon", "How far it looks ahead", "Horizon", look, tuple(content))


# The section with the trials of evaluations on their own.


_ROWS = 100


def evaluation_section(run: Run) -> Section | None:
    if not run.evaluations:
        return None
    rows = [_summary(evaluation) for evaluation in run.evaluations]
    head = [
        "evaluation",
        "track",
        "laps",
        "clean",
        "finished",
        "resets",
        "best clean (s)",
        "median clean (s)",
        "best finished (s)",
    ]
    content: list[Content] = [table("Evaluations, the oldest first", head, rows, texts=2)]
    for evaluation in run.evaluations:
        trials = [_trial(trial) for _, trial in evaluation.trials[:_ROWS].iterrows()]
        columns = [
            *("lap", "clean", "finished", "time (s)", "driven (s)", "penalty (s)"),
            *("progress", "before a reset", "crashes", "off track", "resets"),
        ]
        name = f"Trials of {evaluation.stamp}"
        content.append(element("details", element("summary", name), table(name, columns, trials)))
    look = (
        "A clean lap has neither a reset nor a penalty. A finished lap may have both: its time "
        "contains them. Look at whether every lap is clean, and whether the times are close "
        "together: a race counts what happens every time."
    )
    return Section("evaluations", "Evaluations", "Evaluations", look, tuple(content))


def _summary(evaluation: StoredEvaluation) -> list[Content]:
    trials, laps = evaluation.trials, evaluation.laps
    finished = trials[trials["complete"].astype(bool)]
    return [
        evaluation.stamp,
        evaluation.world or "",
        count(laps.driven),
        count(laps.clean),
        count(len(finished)),
        count(evaluation.resets),
        seconds(math.nan if laps.fastest_s is None else laps.fastest_s),
        seconds(math.nan if laps.median_s is None else laps.median_s),
        seconds(finished["time"].min() if len(finished) else math.nan),
    ]


def _trial(row: Any) -> list[Content]:
    return [
        count(row["trial"]),
        "yes" if row["clean"] else "no",
        "yes" if row["complete"] else "no",
        seconds(row["time"]),
        seconds(row["driven_s"]),
        seconds(row["penalty_s"]),
        percent(row["progress"]),
        percent(row["alone_progress"]),
        count(row["crashed"]),
        count(row["off_track"]),
        count(row["resets"]),
    ]


# Compares the fastest lap with the car's fastest line.


_WIDTH_IN = 10.0


def limit_section(run: Run) -> Section | None:
    clean, track, limit = run.episodes[run.episodes["complete"].astype(bool)], run.track, run.limit
    if clean.empty or limit is None or track is None:
        return None
    number = clean["time"].astype(float).idxmin()
    lap = run.steps[run.steps["unique_episode"] == number]
    if len(lap) < 2:
        return None
    places = _places(lap, track, limit)
    lap_s = float(clean.loc[number, "time"])
    content: list[Content] = [element("p", f"The fastest lap, {limit_text(lap_s, limit)}.")]
    if places:
        items = [element("li", str(place)) for place in places]
        content += [element("p", "Most time is lost at:"), element("ol", *items)]
    picture = base64.b64encode(_picture(track, limit, lap)).decode("ascii")
    caption = "The fastest line of this car, coloured by its speed, and the fastest lap over it"
    content.append(
        element(
            "figure",
            element("img", src=f"data:image/png;base64,{picture}", alt=caption, loading="lazy"),
            element("figcaption", caption),
        )
    )
    look = (
        "Look at where the lap leaves the line, and where it is slower: there the reward function "
        "pays for something else than time."
    )
    return Section("limit", "The fastest line", "Fastest line", look, tuple(content))


def _places(lap: "pd.DataFrame", track: Track, limit: StoredLimit) -> list[LostPlace]:
    rows = [
        LapRow(float(progress), int(waypoint))
        for progress, waypoint in zip(lap["progress"], lap["closest_waypoint"], strict=True)
    ]
    first = lap[["x", "y"]].to_numpy(np.float64)[:1]
    start = float(track.locate(first).distance_m[0]) / track.length_m
    return lost_places(rows, start - rows[0].progress % 100.0 / 100.0, limit)


def _picture(track: Track, limit: StoredLimit, lap: "pd.DataFrame") -> bytes:
    line = points_of(track, np.array(limit.offset_mm) / 1000.0)
    speed: Floats = np.array(limit.speed_mmps) / 1000.0
    low_x, low_y, high_x, high_y = track.bounds

    def draw(figure: "Figure") -> None:
        axes = figure.subplots()
        for border in (track.inner, track.outer):
            axes.plot(*border.T, color=INK, linewidth=0.9)
        ends = np.stack([line, np.roll(line, -1, axis=0)], axis=1)
        colored = collections.LineCollection(
            ends.tolist(), array=speed, cmap="viridis", linewidths=5.0
        )
        axes.add_collection(colored)
        figure.colorbar(colored, ax=axes, label="m/s", shrink=0.7)
        axes.plot(lap["x"], lap["y"], color=LINES[1], linewidth=1.4)
        axes.set(aspect="equal")
        axes.grid(False)
        axes.set_axis_off()

    ratio = (high_y - low_y) / (high_x - low_x)
    return png(draw, (_WIDTH_IN, min(max(_WIDTH_IN * ratio, 3.0), 14.0)))


# The section on what the reward function really pays for.


_LEAST_LAPS = 5
_PAYS = {
    "slow": "Slow laps earn more in all than fast ones: the more time a lap takes, the more steps "
    "are paid. A learner that is paid like this has a reason to drive slowly.",
    "fast": "Fast laps earn more in all than slow ones.",
    "same": "Fast and slow laps earn about the same in all.",
}


def reward_rate_section(run: Run, rate: RewardRate | None) -> Section | None:
    episodes = run.episodes
    driven = np.maximum(episodes["steps"].to_numpy(np.float64) - 1, 1)
    per_step = episodes["reward"].to_numpy(np.float64) / driven
    if not np.isfinite(per_step).any():
        return None
    graphs = [
        Graph(
            "rate-progress",
            "Reward per step against progress, each episode",
            "progress (%)",
            [many_points("reward per step", episodes["progress"], per_step, "c1")],
            "reward per step",
            whole_x=False,
            x_decimals=1,
            near=1.0,
            height=240,
        )
    ]
    full = episodes["complete"].to_numpy(bool)
    if full.sum() >= _LEAST_LAPS:
        time_s = episodes["time"].to_numpy(np.float64)[full]
        reward = episodes["reward"].to_numpy(np.float64)[full]
        graphs.append(
            Graph(
                "rate-time",
                "Reward of clean laps against their time",
                "lap time (s)",
                [
                    many_points("reward of the lap", time_s, reward, "c2"),
                    many_points("per step", time_s, per_step[full], "c1", "right"),
                ],
                "reward of the lap",
                "reward per step",
                whole_x=False,
                x_decimals=2,
                near=0.2,
                height=240,
            )
        )
    content: list[Content] = [*_sentences(rate)]
    content.append(element("div", *(graph.as_html() for graph in graphs), class_="graphs"))
    content.append(dots_note(len(episodes), "episode"))
    if rate is not None and len(rate.by_speed) > 1:
        most = max(abs(group.reward) for group in rate.by_speed) or 1.0
        rows: list[list[Content]] = [
            [
                digits(group.speed_mps),
                bar(abs(group.reward) / most),
                digits(group.reward),
                count(group.steps),
            ]
            for group in rate.by_speed
        ]
        head = ["requested speed (m/s)", "", "mean reward of a step", "steps"]
        content.append(table("What steps earn, by speed", head, rows, texts=2))
    look = (
        "Look at whether the fastest laps lie at the top: a reward of a lap that grows with its "
        "time pays for driving slowly, whatever a single step pays."
    )
    return Section(
        "reward-rate",
        "What the reward pays for",
        "Reward rate",
        look,
        tuple(content),
        tuple(graphs),
    )


def _sentences(rate: RewardRate | None) -> list[Content]:
    if rate is None:
        return []
    content: list[Content] = []
    if rate.pays is not None:
        content.append(element("p", element("strong", _PAYS[rate.pays])))
    laps = "clean laps" if rate.complete else "episodes, scaled to a lap"
    halves = (rate.slow_s, rate.slow_reward, rate.fast_s, rate.fast_reward)
    if all(value is not None for value in halves):
        slow_s, slow_reward, fast_s, fast_reward = (value or 0.0 for value in halves)
        content.append(
            element(
                "p",
                f"Of {count(rate.episodes)} {laps}, the slower half took {seconds(slow_s)} s and "
                f"earned {digits(slow_reward)}, the faster half took {seconds(fast_s)} s and "
                f"earned {digits(fast_reward)}.",
            )
        )
    if rate.slower is not None and rate.pays == "slow":
        content.append(element("p", rate.slower.sentence))
    content.append(
        element(
            "p",
            f"Late in the training a step earned {digits(rate.per_step)} and a second "
            f"{digits(rate.per_s)}; the requested speed was {digits(rate.early_mps)} m/s in the "
            f"first third of the training and {digits(rate.late_mps)} m/s in the last.",
        )
    )
    return content
