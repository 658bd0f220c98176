"""What the page Live says about a run, its workers and their cars."""

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from drcli.base.clock import duration
from drcli.base.report import counted
from drcli.live.live_feed import LiveWorker
from drcli.live.live_record import FinishedEpisode, LiveCar, LiveScene, LiveState, ShownCar
from drcli.races.race_words import lap_time
from drcli.records.iteration import IterationRecord, counted_resets
from drcli.records.run_record import LIVE_STATES
from drcli.records.trace import STATUS_LABELS
from drcli.run.seen_in_bucket import DistantRun, DistantWorker
from drcli.run.status import RunReport, WorkerReport
from drcli.web.page_words import in_page

STATES = {
    "starting": ("starts", "warn"),
    "running": ("runs", "good"),
    "finished": ("has finished", "good"),
    "stopped": ("was stopped", ""),
    "interrupted": ("was interrupted", "warn"),
    "failed": ("failed", "bad"),
    "lost": ("ended without saying why", "bad"),
}
"""What a training does, and the colour of its dot."""

LAST_EPISODES = 5
STRAIGHT_DEG = 0.5
SURE_HOURS = 0.1
"""Of requests, before they are told for an hour."""


def number(value: float | None, digits: int = 0, unit: str = "") -> str:
    """A dash for None and NaN."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:,.{digits}f}{unit and ' '}{unit}"


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def run_words(
    report: RunReport, history: Sequence[IterationRecord], own_run: int
) -> dict[str, Any]:
    """A sentence, what to do next, figures, and what the watches say.

    Args:
        report: Of the run.
        history: Its iterations, also those of another machine.
        own_run: DR_RUN_ID of the settings.
    """
    sentence, hint = _state(report, history, own_run)
    return {
        "active": report.state in LIVE_STATES,
        "own": report.run_id == own_run,
        "dot": STATES.get(report.state, ("", ""))[1],
        "sentence": sentence,
        "hint": in_page(hint),
        "figures": _figures(report, history) if report.state != "none" or history else [],
        "said": [
            {"kind": kind, "message": in_page(text), "remedy": in_page(remedy)}
            for kind, text, remedy in _said(report)
        ],
        "spent": _spent(report),
        "others": others_text(report.workers if report.state in LIVE_STATES else ()),
    }


def _state(report: RunReport, history: Sequence[IterationRecord], own_run: int) -> tuple[str, str]:
    if report.state == "none" and report.unreachable:
        unknown = f"Whether {report.prefix} was trained, or another machine trains it, is unknown."
        return f"Nothing runs here. {unknown}", report.unreachable
    if report.state == "none":
        return (
            "There is no training yet.",
            "Set one up: name, track, reward function and actions. It takes some minutes; "
            "everything can be changed later.",
        )
    does = STATES[report.state][0]
    head = f"The training of {report.prefix} on {report.world} {does}."
    if report.state == "starting":
        loads = "The workers load and check everything; the first pictures come in some seconds."
        return f"{head} {loads}", ""
    if report.state == "running":
        return f"{head} {_progress(report, history)}", _ends(report)
    hint = [] if report.state == "failed" else [report.message, report.remedy]
    if report.run_id != own_run:
        hint.append(
            f"To resume it, set DR_RUN_ID to {report.run_id} on the page “Settings”; it is "
            f"{own_run} there."
        )
    return f"{head} {_done(history) if history else ''}", " ".join(filter(None, hint))


def _done(history: Sequence[IterationRecord]) -> str:
    return f"{counted(len(history), 'iteration')} {'is' if len(history) == 1 else 'are'} done."


def _progress(report: RunReport, history: Sequence[IterationRecord]) -> str:
    if report.phase is not None:
        return f"{capital(report.phase.text)}."
    if not history:
        return "The first iteration is being driven."
    last = history[-1]
    laps = f"the cars got {number(last.mean_progress, 0, '%')} of the lap on average"
    if last.full_laps:
        laps = f"{last.full_laps} of {counted(last.episodes, 'episode')} completed a clean lap"
    return f"{_done(history)} In the newest, {laps}."


def _ends(report: RunReport) -> str:
    iterations, time_left_s, money = report.iterations_left, report.time_left_s, report.money_left
    left = [
        "" if iterations is None else counted(iterations, "iteration"),
        "" if time_left_s is None else duration(time_left_s),
        "" if money is None else number(money, 2, "USD"),
    ]
    if any(left):
        return f"It stops by itself after {', or '.join(filter(None, left))} more, or earlier."
    return "It runs until you stop it, or a goal of its settings is reached."


def _figures(report: RunReport, history: Sequence[IterationRecord]) -> list[tuple[str, str]]:
    """How well it drives first, then how far it is."""
    last = history[-1] if history else None
    newest, best, left = report.newest_laps, report.best_laps, report.iterations_left
    share = number(100.0 * newest.clean / newest.laps if newest else None, 0, "%")
    of_newest = f" ({newest.clean} of {newest.laps})" if newest else ""
    of_best = best and f"{best.clean} of {best.laps}, {number(best.median_s, 2, 's')}"
    whole = "" if left is None else f" of {len(history) + left:,}"
    return [
        ("Clean laps", share + of_newest),
        ("Median clean lap", number(newest.median_s if newest else None, 2, "s")),
        ("Best checkpoint", f"{best.checkpoint}: {of_best}" if best else "–"),
        ("Mean reward", number(last.mean_reward if last else None, 1)),
        ("Mean progress", number(last.mean_progress if last else None, 0, "%")),
        ("Iterations done", f"{len(history):,}{whole}" if history else "–"),
        ("Time of training", duration(report.elapsed_s or last.elapsed_s) if last else "–"),
        ("Steps", f"{last.total_steps:,}, {number(last.steps_per_s)} a second" if last else "–"),
    ]


def _said(report: RunReport) -> list[tuple[str, str, str]]:
    """Kind, sentence and remedy."""
    counts, met = report.reward_errors, report.convergence
    dead = [f"{name} does not run; its supervisor starts it again." for name in report.dead]
    said = [("bad", text, "") for text in (*dead, *report.watches, *report.damaged)]
    if report.warning:
        said.append(("warn", f"Learning curve: {report.warning}.", " ".join(report.advice)))
    if counts is not None and counts.failed:
        reason = "see the log"
        if counts.errors:
            reason = f"reward_function.py, {counts.errors[-1].text}"
        share = f"{counts.failed:,} of {counts.calls:,} calls"
        remedy = "Read the prints of the reward function in the log below, and correct it."
        said.append(("bad", f"The reward function failed in {share}: {reason}", remedy))
    if counts is not None and counts.discarded:
        broken = counted(counts.discarded, "episode")
        said.append(("warn", f"The reward function discarded {broken}.", ""))
    if report.budget is not None and report.budget.damaged:
        lost = "Some files of the daily budget cannot be read, so hours may be missing."
        said.append(("warn", lost, ""))
    if met is not None and met.reached:
        both = f"Training ({met.training:.0f} %) and evaluations ({met.evaluation:.0f} %)"
        text = f"{both} have converged: there is little left to learn here."
        said.append(("good", text, "Stop, or go on with a harder track or reward."))
    for each in report.milestones:
        laps = f"{each.laps} of {each.episodes} evaluation laps clean, best {each.best_lap_s:.2f} s"
        name = each.checkpoint.removesuffix(".ckpt")
        said.append(("good", f"Milestone {each.word}: {name}, {laps}.", ""))
    return said


def _spent(report: RunReport) -> list[tuple[str, str]]:
    spending, requests = report.spending, report.requests
    cost = asked = "–"
    if spending is not None:
        usd = "no price set" if spending.usd is None else number(spending.usd, 2, "USD")
        cost = f"{usd}, {number(spending.hours, 2, 'h')}"
    if requests is not None and requests.hours >= SURE_HOURS:
        rate = (requests.puts + requests.gets) / requests.hours
        asked = f"{number(float(f'{rate:.2g}'))} an hour"
    return [("Cost", cost), ("Requests to the bucket", asked)]


def others_text(workers: Sequence[WorkerReport | DistantWorker]) -> str:
    """What the workers do that do not drive."""
    texts = []
    for worker in workers:
        if worker.name == "supervisor" or worker.name.startswith("sim-"):
            continue
        health = worker.health if isinstance(worker, WorkerReport) else None
        gone = isinstance(worker, WorkerReport) and not worker.alive
        memory = f" ({round(health.memory_mb, -1):,.0f} MB)" if health is not None else ""
        texts.append(f"{worker.name} {'does not run' if gone else worker.activity}{memory}.")
    return " ".join(texts)


# Workers.

Card = dict[str, Any]
"""Of a worker: name, place (`live`, `here` without pictures, `bucket`), what it does, its track."""


def cards_here(
    report: RunReport,
    watchable: Sequence[LiveWorker],
    car: Callable[[int, str], int | None],
) -> list[Card]:
    """Of the workers of a run and its evaluations on this machine."""
    found: dict[str, Card] = {}
    if report.state in LIVE_STATES:
        for worker in report.workers:
            if worker.name.startswith("sim-"):
                does, hint = _without_pictures(worker, report.ending)
                words = {"does": does, "hint": hint}
                found[worker.name] = _card(worker.name, "here", report.world) | words
    for live in watchable:
        if live.run_id == report.run_id:
            world = report.world if live.worker in found else None
            shown = {"car": car(live.run_id, live.worker)}
            found[live.worker] = _card(live.worker, "live", world) | shown
    return list(found.values())


def _card(name: str, place: str, world: str | None) -> Card:
    return {"name": name, "place": place, "world": world, "does": "", "hint": ""}


def _without_pictures(worker: WorkerReport, ending: bool) -> tuple[str, str]:
    if not worker.alive and not ending:
        gone = "It has ended before its time. Its pictures come back when it is started again."
        return "Does not run; it is started again.", gone
    starts = "it is just starting"
    if worker.restarts:
        starts = f"it was started again ({counted(worker.restarts, 'time')} by now)"
    activity = worker.activity if worker.alive else "has ended"
    hint = f"It shows no live pictures: {starts}, or DR_LIVE_VIEW is off."
    return f"{capital(activity or 'starts')}.", hint


def distant_words(run: DistantRun) -> dict[str, Any]:
    """What a training on another machine says, and the cards of its workers."""
    if run.host is None:
        return {}
    heard = f"last heard from {duration(run.heard_s or 0.0)} ago"
    there = "Live pictures are shown on that machine only"
    return {
        "sentence": f"The training of {run.prefix} runs on {run.host}, {heard}.",
        "hint": "This page reads the bucket: figures and maps of finished iterations come every "
        f"few seconds. {there}; stop the training there.",
        "others": others_text(run.workers),
        "cards": [
            _card(worker.name, "bucket", run.world)
            | {
                "does": f"{capital(worker.activity)}.",
                "hint": f"Runs on {worker.host}. {there}; the map shows the last finished "
                "iteration.",
            }
            for worker in run.workers
            if worker.name.startswith("sim-")
        ],
    }


def lines_text(iteration: int | None) -> str:
    """Of the lines on the map of a worker."""
    if iteration is None:
        return "The first iteration has not been finished yet."
    return f"Lines: iteration {iteration}, the newest; green where the lap was completed."


LOST = {"does": "The connection to the worker was lost. The page connects again by itself."}


def state_words(state: LiveState) -> dict[str, str]:
    age_s = time.time() - state.since_s
    lasts = f", for {duration(age_s)}" if state.waits and age_s > 1.0 else ""
    return {"does": f"{capital(state.activity)}{lasts}.", "hint": state.hint}


def scene_words(scene: LiveScene, name: str) -> dict[str, Any]:
    """Figures of the car that is looked at, what its policy wants, marks on the map, episodes.

    Args:
        scene: Of the worker.
        name: Of the worker.
    """
    shown, racers = scene.shown, scene.racers
    cars = [each for each in scene.cars if not each.world or each.world == scene.world]
    models = " and ".join(racer.model for racer in racers)
    kind = "Race" if len(racers) > 1 else "Evaluation"
    where = [scene.world, "reversed" if scene.reverse else "", scene.checkpoint]
    legend = ", ".join(filter(None, [counted(len(cars), "car"), *where])).replace(".ckpt", "") + "."
    if len(racers) > 1:
        legend = ", ".join(f"{racer.model}: {racer.color}" for racer in racers)
    figures = [_car_figures(each) for each in cars if shown and each.car == shown.car]
    return {
        "title": f"{kind} of {models}" if name.startswith("evaluation") and models else "",
        "legend": legend,
        "figures": figures[0] if figures else [],
        "actions": [f"{angle:.0f}°, {speed:.1f} m/s" for angle, speed in scene.actions],
        "policy": _policy(shown, discrete=bool(scene.actions)) if shown else "",
        "cars": _marks(scene, cars),
        "objects": [
            (each.x, each.y, math.radians(each.yaw_deg))
            for each in (shown.objects if shown else ())
        ],
        "finished": [_episode(each) for each in scene.finished[: -LAST_EPISODES - 1 : -1]],
    }


def _marks(scene: LiveScene, cars: Sequence[LiveCar]) -> list[dict[str, Any]]:
    """Cars as maps draw them, yaw in radians; the first, which is looked at, is drawn last."""
    looked_at = scene.shown.car if scene.shown else None
    many = len(scene.racers) > 1
    marks = []
    for each in sorted(cars, key=lambda each: each.car != looked_at):
        own = scene.racers[each.racer] if many else None
        color = "c2" if each.phase == "evaluation" and not many else "c1"
        name = f"car {each.car + 1}" if each.car == looked_at else ""
        marks.append(
            {
                **{"car": each.car, "episode": each.episode, "laps": each.laps},
                **{"x": each.x, "y": each.y, "yaw": math.radians(each.yaw_deg)},
                "color": f"rgb({','.join(map(str, own.rgb))})" if own and own.rgb else color,
                "name": own.model if own else name,
            }
        )
    return marks


def _car_figures(car: LiveCar) -> list[str]:
    """Speed, steering, progress, reward of the step, reward so far, lap time."""
    angle = abs(car.steering_deg)
    side = "straight" if angle < STRAIGHT_DEG else "left" if car.steering_deg > 0 else "right"
    return [
        f"{car.speed_mps:.2f} m/s, asked {car.asked_mps:.2f}",
        f"{angle:.0f}° {side}",
        f"{car.progress:.1f} %" + (f", lap {car.laps + 1}" if car.laps else ""),
        number(car.reward, 3),
        f"{number(car.total, 1)} in {counted(car.steps, 'step')}",
        lap_time(car.lap_s).zfill(9) + _and_resets(car.resets),
    ]


def _and_resets(count: int) -> str:
    return f", {counted_resets(count)}" if count else ""


def _policy(shown: ShownCar, *, discrete: bool) -> str:
    texts = []
    if shown.mean and shown.low and shown.high:
        (angle, speed), (right, slow), (left, fast) = shown.mean, shown.low, shown.high
        texts.append(
            f"Steering {angle:.1f}° ({right:.1f} to {left:.1f}), "
            f"speed {speed:.2f} m/s ({slow:.2f} to {fast:.2f})."
        )
    elif shown.probabilities is None and discrete:
        texts.append("The policy gives no probabilities now.")
    if shown.value is not None:
        texts.append(f"The critic expects a return of {number(shown.value, 2)} from here on.")
    return " ".join(texts)


def _episode(each: FinishedEpisode) -> str:
    clean = each.progress >= 100.0 and not each.resets
    end = "clean lap" if clean else STATUS_LABELS.get(each.status, each.status).lower()
    figures = f"{each.progress:.0f} %, {each.time_s:.2f} s, reward {number(each.reward, 1)}"
    return f"{capital(each.phase)} {each.episode}: {end}{_and_resets(each.resets)}, {figures}"
