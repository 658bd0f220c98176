"""Sections on actions, steering, ends of episodes and the horizon."""

import math

from drcli.analysis.findings.action_use import ActionShare, ActionUse
from drcli.analysis.findings.discount_horizon import DiscountHorizon
from drcli.analysis.findings.episode_ends import EpisodeEnds
from drcli.analysis.findings.reward_function_time import RewardFunctionTime
from drcli.analysis.findings.snaking import Snaking
from drcli.analysis.findings.steering_balance import SteeringBalance
from drcli.analysis.findings.wheels_off import WheelsOff
from drcli.analysis.report.markup import Content, Html, bar, element, table
from drcli.analysis.report.section import Section
from drcli.analysis.report.words import count, digits, percent


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
            [side, bar(share), percent(100 * share), _share(needed)]
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


def _share(value: float | None) -> str:
    return digits(math.nan) if value is None else percent(100 * value)


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
