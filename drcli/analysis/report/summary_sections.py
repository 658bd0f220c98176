"""The first sections: numbers at a glance, verdict, advice."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from drcli.analysis.findings.advice_item import Advice
from drcli.analysis.findings.driven_steps import EpisodeGroup, by_quintile, by_start
from drcli.analysis.findings.verdict import Verdict
from drcli.analysis.report.graphs import Graph, Mark, Section, Series, dots_note, many_points
from drcli.analysis.report.markup import (
    Content,
    Html,
    bar,
    count,
    digits,
    element,
    known,
    percent,
    seconds,
    table,
    tiles,
)
from drcli.analysis.run import Run
from drsim.arrays import Floats

if TYPE_CHECKING:
    import pandas as pd


def overview(run: Run) -> Html:
    episodes, table_ = run.episodes, run.iterations
    clean = episodes[episodes["complete"].astype(bool)]
    facts = [("iterations", count(len(table_))), ("episodes", count(len(episodes)))]
    if len(run.steps):
        facts.append(("steps", count(len(run.steps))))
        facts.append(("simulated", _duration(float(episodes["time"].sum()))))
    facts.append(("clean laps", count(len(clean))))
    if len(clean):
        facts.append(("best lap", f"{seconds(clean['time'].min())} s"))
    last = table_["mean_progress"].dropna()[-3:]
    if len(last):
        facts.append((f"mean progress, last {len(last)}", percent(last.mean())))
    evaluated = table_["eval_mean_progress"].dropna()
    if len(evaluated):
        facts.append(("last evaluation", percent(evaluated.iloc[-1])))
    elsewhere = table_["second_clean"].dropna()
    if len(elsewhere):
        facts.append(("clean laps on other tracks, last evaluation", percent(elsewhere.iloc[-1])))
    if run.evaluations:
        newest = run.evaluations[-1].laps
        facts.append(("clean laps, newest evaluation", f"{newest.clean} of {newest.driven}"))
    best = [lap_s for each in run.evaluations if (lap_s := each.laps.fastest_s) is not None]
    if best:
        facts.append(("best clean lap of evaluations", f"{seconds(min(best))} s"))
    return element("div", tiles(facts), problems_box(run.problems))


def problems_box(
    problems: Sequence[str],
    heading: str = "Something was wrong with the files; the rest is analysed.",
) -> Html | None:
    if not problems:
        return None
    return element(
        "div",
        element("p", element("strong", heading)),
        element("ul", *(element("li", problem) for problem in problems)),
        class_="problems",
    )


def verdict_section(verdict: Verdict, advice: Sequence[Advice]) -> Section:
    kind = verdict.kind.replace("_", " ").capitalize()
    named = verdict.sentence.casefold().startswith(kind.casefold())
    word = None if named else element("strong", f"{kind}.")
    sentence = element("p", word, verdict.sentence, class_="verdict")
    content: list[Content] = [sentence, _numbers("Numbers behind the verdict", verdict.numbers)]
    content.append(element("h3", "Advice"))
    if advice:
        content.append(element("ol", *(_advice(one) for one in advice), class_="advice"))
        look = "Take the first advice alone, train again, and compare: later ones may then be gone."
    else:
        content.append(element("p", "No advice: nothing in these files is evidence of a fault."))
        look = "Look at whether the verdict is what you expected of this training."
    return Section("verdict", "Verdict and advice", "Verdict", look, tuple(content))


def _advice(advice: Advice) -> Html:
    command: Content = None
    if advice.command:
        command = element(
            "div",
            element("pre", element("code", advice.command)),
            element("button", "Copy", type="button", data_copy=True, hidden=True),
            class_="command",
        )
    setting = (
        element("p", "Setting: ", element("code", advice.setting), class_="quiet")
        if advice.setting
        else None
    )
    return element(
        "li",
        element("h3", advice.title),
        element("p", advice.evidence),
        setting,
        command,
        _numbers("Numbers behind it", advice.numbers),
        id=f"advice-{advice.id}",
    )


def _numbers(title: str, numbers: Mapping[str, object]) -> Html | None:
    if not numbers:
        return None
    rows = [[name.replace("_", " "), _text(value)] for name, value in numbers.items()]
    return element("details", element("summary", title), table(title, ["number", "value"], rows))


def _text(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "not known"}[value]
    if isinstance(value, int):
        return count(value) if abs(value) >= 10_000 else str(value)
    if isinstance(value, float):
        return digits(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {_text(part)}" for name, part in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value))
    return str(value)


def _duration(time_s: float) -> str:
    if not known(time_s):
        return digits(time_s)
    return f"{time_s / 3600:.1f} h" if time_s >= 3600 else f"{time_s / 60:.1f} min"


# Sections on rewards, laps, and the learner.


_SPREAD = 0.8
_LEARNER = {
    "entropy": ("Entropy", "entropy (nats)"),
    "kl": ("Change of the policy in an update", "KL divergence"),
    "policy_loss": ("Policy loss", "loss"),
    "value_loss": ("Value loss", "loss"),
    "actor_loss": ("Actor loss", "loss"),
    "critic_loss": ("Critic loss", "loss"),
    "alpha": ("Temperature", "alpha"),
    "imitation_loss": ("Distance of the student from its teacher", "loss"),
    "clip_fraction": ("Clipped steps", "share of the steps"),
    "explained_variance": ("How well the critic predicts", "explained variance"),
    "learning_rate": ("Learning rate", "learning rate"),
    "update_s": ("Time of an update", "seconds"),
    "learn_s": ("Time of an update", "seconds"),
    "drive_s": ("Time of driving", "seconds"),
    "exchange_s": ("Time of the exchange", "seconds"),
    "steps_per_s": ("Speed of the training", "steps per second"),
    "real_time_factor": ("Speed of the simulation", "real-time factor"),
}
_SHOWN_ELSEWHERE = ("episodic_return", "episodic_length", "SPS")


def reward_section(run: Run) -> Section | None:
    """Drawn as the DeepRacer console draws it."""
    if run.iterations.empty:
        return None
    table_, episodes = run.iterations, run.episodes
    at = table_.index.to_numpy(np.float64)
    dots = spread_over_iterations(episodes)
    series = [
        many_points("reward of an episode", dots, episodes["reward"], "c1", alone=False),
        Series("mean reward", at, table_["mean_reward"], "c1"),
        many_points(
            "progress of an episode",
            dots,
            episodes["progress"],
            "c2",
            "right",
            1,
            on=False,
            alone=False,
        ),
        Series("mean progress", at, table_["mean_progress"], "c2", axis="right", decimals=1),
    ]
    evaluated = [
        Series("mean reward of the evaluation", at, table_["eval_mean_reward"], "c6"),
        Series(
            "mean progress of the evaluation",
            at,
            table_["eval_mean_progress"],
            "c3",
            axis="right",
            decimals=1,
        ),
    ]
    series += [one for one in evaluated if np.isfinite(np.asarray(one.y, np.float64)).any()]
    best = best_iteration(run)
    graph = Graph(
        "reward",
        "Reward and progress over the iterations",
        "iteration",
        series,
        "reward of an episode",
        "progress (%)",
        marks=[*_phase_marks(table_), *([] if best is None else [Mark(best, f"best: {best}")])],
        right_range=(0.0, 102.0),
        height=400,
    )
    look = (
        "Look for lines that rise together: where the mean reward rises and the progress does "
        "not, the reward function pays for something other than driving on."
    )
    content = (graph.as_html(), dots_note(len(episodes), "episode"), _iteration_table(run))
    return Section("reward", "Reward graph", "Reward", look, content, (graph,))


def _phase_marks(table_: "pd.DataFrame") -> list[Mark]:
    if "phase" not in table_:
        return []
    named = table_["phase"][table_["phase"] != ""]
    begun = named[named != named.shift()]
    return [Mark(int(number), str(phase)) for number, phase in begun.items()]


def best_iteration(run: Run) -> int | None:
    """By the evaluation's progress, then lap time; without any, by the training's."""
    table_ = run.iterations
    for progress, lap in (
        ("eval_mean_progress", "eval_best_lap_s"),
        ("mean_progress", "best_lap_s"),
    ):
        known = table_[np.isfinite(table_[progress].to_numpy(np.float64))]
        if len(known):
            order = known.sort_values([progress, lap], ascending=[False, True], kind="stable")
            return int(order.index[0])
    return None


def spread_over_iterations(episodes: "pd.DataFrame") -> Floats:
    """Positions of episodes, each within its iteration."""
    if episodes.empty:
        return np.zeros(0)
    groups = episodes.groupby("iteration")["episode"]
    place = (groups.rank(method="first") - 0.5) / groups.transform("size")
    found: Floats = (episodes["iteration"] + _SPREAD * (place - 0.5)).to_numpy(np.float64)
    return found


def _iteration_table(run: Run) -> Html:
    names: dict[str, tuple[str, Any]] = {
        "episodes": ("episodes", count),
        "steps": ("steps", count),
        "mean_reward": ("mean reward", digits),
        "median_reward": ("median reward", digits),
        "std_reward": ("deviation", digits),
        "best_reward": ("best reward", digits),
        "mean_progress": ("mean progress (%)", lambda value: percent(value, sign="")),
        "complete_laps": ("clean laps", count),
        "best_lap_s": ("best lap (s)", seconds),
        "mean_lap_s": ("mean lap (s)", seconds),
        "eval_mean_reward": ("evaluation: reward", digits),
        "eval_mean_progress": ("evaluation: progress (%)", lambda value: percent(value, sign="")),
        "eval_laps": ("evaluation: clean laps", count),
        "eval_best_lap_s": ("evaluation: best lap (s)", seconds),
    }
    shown = {
        name: texts
        for name, texts in names.items()
        if name in run.iterations and run.iterations[name].notna().any()
    }
    rows = [
        [str(number), *(form(row[name]) for name, (_, form) in shown.items())]
        for number, row in run.iterations.iterrows()
    ]
    head = ["iteration", *(title for title, _ in shown.values())]
    numbers = table("Every iteration", head, rows, texts=0)
    return element("details", element("summary", "Numbers of every iteration"), numbers)


def lap_section(run: Run) -> Section | None:
    if run.episodes.empty:
        return None
    table_ = run.iterations
    at = table_.index.to_numpy(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = 100 * table_["complete_laps"].to_numpy(float) / table_["episodes"].to_numpy(float)
    evaluated = table_["eval_mean_progress"]
    completion = [
        Series("clean laps of the training", at, share, "c1", decimals=0),
        Series("mean progress of the evaluation", at, evaluated, "c3", decimals=1),
    ]
    graphs = [
        Graph(
            "completion",
            "Episodes that ended with a clean lap",
            "iteration",
            completion if evaluated.notna().any() else completion[:1],
            "clean laps (%)",
            left_range=(0.0, 102.0),
            height=240,
        )
    ]
    complete = run.episodes["complete"].to_numpy(bool)
    if complete.any():
        lap_s = table_["best_lap_s"].to_numpy(np.float64)
        best_s = np.minimum.accumulate(np.where(np.isfinite(lap_s), lap_s, np.inf))
        best_s = np.where(np.isfinite(best_s), best_s, np.nan)
        dots = spread_over_iterations(run.episodes)[complete]
        evaluated_s = table_["eval_best_lap_s"]
        times = [
            many_points("lap", dots, run.episodes["time"][complete], "c1", decimals=2),
            Series("mean lap time", at, table_["mean_lap_s"], "c1", decimals=2),
            Series("best so far", at, best_s, "c3", decimals=2),
            Series("best lap of the evaluation", at, evaluated_s, "c2", "marks", decimals=2),
        ]
        times = [one for one in times if np.isfinite(np.asarray(one.y, np.float64)).any()]
        graphs.append(
            Graph("lap-times", "Lap times of clean laps", "iteration", times, "seconds", height=240)
        )
    look = (
        "Look at whether clean laps become more frequent and faster, and whether one start "
        "position is much worse than the others: the corner after it is the one to work on."
    )
    content: tuple[Content, ...] = (
        element("div", *(graph.as_html() for graph in graphs), class_="graphs"),
        dots_note(int(complete.sum()), "lap"),
        _groups("Each fifth of the training, in order", "fifth", by_quintile(run)),
        _groups("By start position, last third of the training", "waypoints", by_start(run)),
    )
    return Section("laps", "Laps", "Laps", look, content, tuple(graphs))


def _groups(caption: str, name: str, groups: Sequence[EpisodeGroup]) -> Html | None:
    if len(groups) < 2:
        return None
    rows: list[list[Content]] = [
        [
            group.name.replace("-", " to "),
            bar(group.mean_progress / 100),
            percent(group.mean_progress),
            count(group.episodes),
            digits(group.mean_reward),
            percent(100 * group.complete_share, digits=0),
            seconds(math.nan if group.best_lap_s is None else group.best_lap_s),
        ]
        for group in groups
    ]
    head = [name, "", "mean progress", "episodes", "mean reward", "clean laps", "best lap (s)"]
    return table(caption, head, rows, texts=2)


def learner_section(run: Run) -> Section | None:
    graphs = []
    at = run.learner.index.to_numpy(np.float64)
    for name in [*_LEARNER, *(name for name in run.learner if name not in _LEARNER)]:
        if name not in run.learner or name in _SHOWN_ELSEWHERE:
            continue
        values = run.learner[name]
        if values.dtype.kind not in "fiu" or not np.isfinite(values.to_numpy(np.float64)).any():
            continue
        title, unit = _LEARNER.get(name, (str(name).replace("_", " ").capitalize(), str(name)))
        series = [Series(unit, at, values, "c1")]
        graphs.append(Graph(f"learner-{name}", title, "iteration", series, unit, height=200))
    if not graphs:
        return None
    look = (
        "Look for an entropy that falls slowly: falling to its floor early means that the car "
        "has stopped trying other actions; a KL divergence or a loss that jumps means that "
        "updates are too large."
    )
    content = element("div", *(graph.as_html() for graph in graphs), class_="graphs")
    return Section(
        "learner", "What the learner reports", "Learner", look, (content,), tuple(graphs)
    )
