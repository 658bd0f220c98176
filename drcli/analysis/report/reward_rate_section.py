"""The section on what the reward function really pays for."""

import numpy as np

from drcli.analysis.findings.reward_rate import RewardRate
from drcli.analysis.report.graphs import Graph, dots_note, many_points
from drcli.analysis.report.markup import Content, bar, element, table
from drcli.analysis.report.section import Section
from drcli.analysis.report.words import count, digits, seconds
from drcli.analysis.run import Run

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
            [many_points("reward per step", episodes["progress"], per_step, "--c1")],
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
                    many_points("reward of the lap", time_s, reward, "--c2"),
                    many_points("per step", time_s, per_step[full], "--c1", "right"),
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
