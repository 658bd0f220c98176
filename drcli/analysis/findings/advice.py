"""What a racer should change, the most important first."""

import shlex
from collections.abc import Callable

import numpy as np

from drcli.analysis.findings import driving_advice, update_advice
from drcli.analysis.findings.advice_item import TRAIN_ON, Advice, rounded, train_on
from drcli.analysis.findings.driving_advice import LEARNED, REWARD_CHECK, TOP_SHARE, named
from drcli.analysis.findings.evaluated_laps import EvaluatedLaps
from drcli.analysis.findings.evidence import Evidence, algorithm_of
from drcli.analysis.findings.learning_curve import LEAST_GAIN, UNDER, decline, rise, window
from drcli.analysis.findings.update_advice import LOW_LR, USUAL_LR, lower_lr
from drcli.analysis.findings.verdict import LEAST_ITERATIONS, LOW, NOT_LEARNING

# Advice that the learning curve gives.


BEHIND, BEHIND_T = 15.0, 3.5
"""In healthy trainings evaluations are ahead of the training episodes, which explore."""


def collapse(evidence: Evidence) -> Advice | None:
    fall, curve = evidence.fall, evidence.curve
    if fall is None:
        return None
    at = int(curve.iteration[fall.at])
    unit = " %" if evidence.fallen == "progress" else ""
    digits = 0 if unit or fall.before >= 10 else 2
    seen = (
        f"Mean {evidence.fallen} was {fall.before:.{digits}f}{unit} before iteration {at} and "
        f"{fall.after:.{digits}f}{unit} since, in {len(curve) - fall.at} iterations. The fall is "
        f"{fall.sigmas:.0f} times as large as chance makes it. "
    )
    numbers = {"iteration": at, "before": fall.before, "after": fall.after, "sigmas": fall.sigmas}
    if evidence.paid:
        first, second = curve.reward[max(0, fall.at - 5) : fall.at], curve.reward[fall.at :]
        return Advice(
            "collapse",
            f"Progress collapsed at iteration {at}, and the reward paid for it",
            f"{seen}But the mean reward rose from {first.mean():.4g} to {second.mean():.4g}: the "
            "car does what it is paid for. Pay for progress.",
            numbers | {"reward_before": float(first.mean()), "reward_after": float(second.mean())},
            "reward_function.py",
            REWARD_CHECK,
        )
    lr = lower_lr(evidence)
    return Advice(
        "collapse",
        f"The policy collapsed at iteration {at}",
        f"{seen}Go back to the best checkpoint, and learn more carefully from there.",
        numbers,
        "lr",
        train_on(f"lr={lr}", checkpoint="best"),
    )


def over_training(evidence: Evidence) -> Advice | None:
    if evidence.fall is not None:
        return None
    lost = decline(evidence.curve)
    if lost is None:
        return None
    return Advice(
        "over-training",
        "Trained for too long",
        f"Progress of the {lost.what} was best near iteration {lost.at} ({lost.best:.0f} % of the "
        f"lap) and is {lost.now:.0f} % now, after {int(evidence.curve.iteration[-1]) - lost.at} "
        "more iterations. The best checkpoint drives better than the last one.",
        {"iteration": lost.at, "before": lost.best, "after": lost.now, "t": lost.t},
        "DR_LOCAL_S3_PRETRAINED_CHECKPOINT",
        train_on(f"lr={lower_lr(evidence)}", checkpoint="best"),
    )


def evaluation_behind(evidence: Evidence) -> Advice | None:
    gap = evidence.gap
    if gap is None or gap.behind < BEHIND or gap.t < BEHIND_T:
        return None
    what = f"the last {gap.count} evaluations" if not gap.alone else f"{gap.count} trials"
    key, usual = algorithm_of(evidence.run).entropy
    lower = rounded((evidence.number(key) or usual) / 3.0)
    return Advice(
        "evaluation-behind",
        "Evaluations are far behind the training",
        f"Training episodes get {gap.training:.0f} % of the lap, but {what} only "
        f"{gap.evaluation:.0f} %. An evaluation always takes the most likely action, so the "
        "policy gets round by its random actions. Make it surer of itself.",
        {"training": gap.training, "evaluation": gap.evaluation, "behind": gap.behind, "t": gap.t},
        key,
        train_on(f"{key}={lower}"),
    )


def under_training(evidence: Evidence) -> Advice | None:
    curve = evidence.curve
    if evidence.fall is not None or len(curve) < LEAST_ITERATIONS or evidence.level >= UNDER:
        return None
    count = window(len(curve))
    evaluation = curve.evaluation[-count:]
    if np.isfinite(evaluation).any() and float(np.nanmean(evaluation)) >= UNDER:
        return None
    trend = rise(curve)
    if trend is None or curve.laps[-trend.count :].mean() > 0.1:
        return None
    return Advice(
        "under-training",
        "Not trained for long enough",
        f"Mean progress rose by {trend.gain:.0f} points in the last {trend.count} iterations, to "
        f"{evidence.level:.0f} % of the lap, and it has not stopped rising. More training is "
        "likely to help more than any change.",
        {"progress": evidence.level, "gain": trend.gain, "t": trend.t, "iterations": len(curve)},
        *TRAIN_ON,
    )


def not_learning(evidence: Evidence) -> Advice | None:
    curve = evidence.curve
    if evidence.fall is not None or len(curve) < NOT_LEARNING or evidence.level >= LOW:
        return None
    whole = curve.progress
    third = len(whole) // 3
    gained = float(whole[-third:].mean() - whole[:third].mean())
    if gained >= LEAST_GAIN or rise(curve) is not None:
        return None
    lr = evidence.number("lr")
    numbers = {"progress": evidence.level, "gain": gained, "iterations": float(len(curve))}
    seen = (
        f"After {len(curve)} iterations, mean progress is {evidence.level:.0f} % of the lap, and "
        f"was {whole[:third].mean():.0f} % in the first third. "
    )
    if lr is not None and lr <= LOW_LR:
        return Advice(
            "not-learning",
            "The car does not learn",
            f"{seen}A learning rate of {lr:g} hardly changes the weights.",
            {**numbers, "lr": lr},
            "lr",
            train_on(f"lr={rounded(USUAL_LR)}"),
        )
    return Advice(
        "not-learning",
        "The car does not learn",
        f"{seen}Check that driving on earns more than anything else.",
        numbers,
        "reward_function.py",
        "dr-reward check",
    )


# Advice on laps of evaluations that are not clean.


def unclean_laps(evidence: Evidence) -> Advice | None:
    alone, trained = evidence.evaluated, evidence.evaluated_in_training
    if alone is not None and alone.unclean:
        return _advice(evidence, alone)
    curve = evidence.curve
    settled = len(curve) >= NOT_LEARNING and evidence.fall is None and rise(curve) is None
    if trained is not None and settled and trained.unclean:
        return _advice(evidence, trained)
    return None


def _advice(evidence: Evidence, found: EvaluatedLaps) -> Advice:
    laps, run = found.laps, evidence.run
    what = "the newest evaluation" if found.stamp else "the newest evaluations of the training"
    elsewhere = bool(found.world and run.world and found.world != run.world)
    where = f" on {found.world}" if elsewhere else ""
    numbers = {
        "laps": float(laps.driven),
        "clean": float(laps.clean),
        "resets": float(found.resets),
        "off_track": float(found.off_track),
        "crashed": float(found.crashed),
    }
    seen = [f"{_counted(found.off_track, 'time')} off the track"]
    for count, word in ((found.crashed, "crash"), (found.resets, "reset")):
        if count:
            seen.append(_counted(count, word))
    evidence_ = f"In {what}{where}, {laps.clean} of {laps.driven} laps are clean: {', '.join(seen)}"
    if found.alone is not None and found.alone < 100.0:
        numbers["alone"] = found.alone
        evidence_ += f"; the car breaks a rule for the first time after {found.alone:.0f} %"
        evidence_ += " of the lap on average"
    sentences = [f"{evidence_}."]
    place = found.place
    if place is not None and place.count >= 3 and 3 * place.count >= place.of:
        numbers |= {"first": float(place.first), "last": float(place.last)}
        sentences.append(
            f"{place.count} of {place.of} faults are between waypoints {place.first} and "
            f"{place.last}."
        )
    title = "Many laps are not clean" if laps.clean else "The car does not get round without help"
    use = found.actions
    if use is not None and use.top_share >= TOP_SHARE and len(use.actions) > 1:
        title = "The car takes one action only"
        numbers["top_share"] = use.top_share
        share = f"{100 * use.top_share:.0f} %"
        sentences.append(f"It takes {named(use, use.top)} in {share} of the steps.")
    setting, command = _remedy(evidence, found, elsewhere=elsewhere)
    return Advice(
        "unclean-laps",
        title,
        " ".join(sentences),
        numbers,
        setting,
        command,
    )


def _remedy(evidence: Evidence, found: EvaluatedLaps, *, elsewhere: bool) -> tuple[str, str]:
    if elsewhere:
        return "DR_WORLD_NAME", shlex.join(["dr-config", "set", f"DR_WORLD_NAME={found.world}"])
    young = len(evidence.curve) < NOT_LEARNING or rise(evidence.curve) is not None
    if evidence.level < LEARNED and young:
        return TRAIN_ON
    return "reward_function.py", REWARD_CHECK


def _counted(count: int, word: str) -> str:
    plural = f"{word}es" if word.endswith("sh") else f"{word}s"
    return f"{count} {word if count == 1 else plural}"


# Advice on where the car drives and where episodes end.


OFF_SHARE = 0.2
"""Recorded trainings have 0.04 to 0.1 while they learn."""


OFF_PLACES, OFF_IN_PLACES = 0.1, 0.6
"""Or less, if most of it is at places where every second step is off."""


GETS_ROUND, OFF_LAPS, LAP_PLACES = 0.8, 0.1, 0.03
"""For a car that completes so many of its laps, this share of their steps is enough, or this at
places where most laps are off. Healthy ones have 0.03 and 0.
"""


PLACE_SHARE, PLACE_ENDS, PLACE_PASSES = 0.6, 20, 0.5


def cutting(evidence: Evidence) -> Advice | None:
    off = evidence.off
    if off is None:
        return None
    surely = max(off.sure_share, off.sure_lap_share)
    at_places = surely >= OFF_PLACES and off.places_share >= OFF_IN_PLACES
    in_laps = off.complete_share >= GETS_ROUND and (
        off.sure_lap_share >= OFF_LAPS or off.lap_places_share >= LAP_PLACES
    )
    if surely < OFF_SHARE and not at_places and not in_laps:
        return None
    share = off.share
    if off.lap_share is not None and off.sure_lap_share > off.sure_share:
        share = off.lap_share
    worst = ", ".join(str(place.waypoint) for place in sorted(off.places, key=lambda p: p.waypoint))
    paid = ""
    if off.reward_share is not None and off.reward_share > 0.5:
        paid = f" Such a step still earns {100 * off.reward_share:.0f} % of an ordinary one."
    return Advice(
        "cutting",
        "The car drives with wheels off the track",
        f"In {100 * share:.0f} % of the steps, long before an episode ends, a wheel is off the "
        f"track; most often near waypoint {worst}.{paid} A race counts that, or ends there.",
        {
            "share": share,
            "places_share": off.places_share,
            "lap_places_share": off.lap_places_share,
        },
        "reward_function.py",
        REWARD_CHECK,
    )


def hard_place(evidence: Evidence) -> Advice | None:
    ends, table = evidence.ends, evidence.run.episodes
    part = None if ends is None else ends.densest
    if ends is None or part is None or evidence.level >= LEARNED:
        return None
    if len(evidence.curve) < NOT_LEARNING:
        return None  # the first bend stops every beginner; it is a fault if it goes on doing so
    failed = ends.episodes - ends.complete
    if part.ends < PLACE_ENDS or part.ends < PLACE_SHARE * failed or part.share < PLACE_PASSES:
        return None
    starts = np.asarray(table["start_at"].fillna(-1), dtype=np.int64)
    _, counts = np.unique(starts, return_counts=True)
    if counts.max() < 0.9 * len(starts):
        return None
    return Advice(
        "one-place",
        "Almost every episode ends at the same place",
        f"{part.ends} of {failed} episodes end between waypoints {part.first} and {part.last}, and "
        "all start at the same place. So the car practises the way there again and again, and "
        "rarely what comes after.",
        {"ends": part.ends, "failed": failed, "first": part.first, "last": part.last},
        "DR_TRAIN_CHANGE_START_POSITION",
        "dr-config set DR_TRAIN_CHANGE_START_POSITION=True",
    )


RULES: tuple[tuple[str, Callable[[Evidence], Advice | None]], ...] = (
    ("collapse", collapse),
    ("slow-driving", driving_advice.slow_driving),
    ("one-sided-steering", driving_advice.one_sided),
    ("snaking", driving_advice.snakes),
    ("no-exploration", driving_advice.no_exploration),
    ("standing-still", driving_advice.standing_still),
    ("cutting", cutting),
    ("over-training", over_training),
    ("evaluation-behind", evaluation_behind),
    ("even-probabilities", update_advice.even_probabilities),
    ("unclean-laps", unclean_laps),
    ("unstable", update_advice.unstable),
    ("entropy-rises", update_advice.entropy_rises),
    ("dead-action", driving_advice.dead_actions),
    ("one-place", hard_place),
    ("short-horizon", update_advice.short_horizon),
    ("not-learning", not_learning),
    ("under-training", under_training),
)
"""Causes come before what follows from them."""

IMPLIED = {
    "slow-driving": {"dead-action", "standing-still"},
    "one-sided-steering": {"dead-action", "no-exploration", "one-place"},
    "snaking": {"dead-action", "no-exploration"},
    "collapse": {"not-learning", "unclean-laps"},
    "evaluation-behind": {"unclean-laps"},
    "no-exploration": {"dead-action", "one-place", "not-learning", "unclean-laps"},
    "even-probabilities": {"not-learning", "unclean-laps"},
    "not-learning": {"unclean-laps"},
    "unclean-laps": {"under-training"},
    "over-training": {"evaluation-behind"},
    "standing-still": {"not-learning"},
}
TAUGHT = ("slow-driving", "standing-still", "cutting")
"""The cause if progress fell and reward rose."""


OF_OWN_LEARNING = {
    "no-exploration",
    "over-training",
    "evaluation-behind",
    "even-probabilities",
    "unclean-laps",
    "unstable",
    "entropy-rises",
    "short-horizon",
    "not-learning",
    "under-training",
}
"""Left out while a teacher learns, or a student from it."""


def advise(evidence: Evidence) -> tuple[Advice, ...]:
    """Advice on a training; empty without evidence."""
    own = evidence.curve.is_own_driving
    rules = [rule for name, rule in RULES if own or name not in OF_OWN_LEARNING]
    found = [item for rule in rules if (item := rule(evidence)) is not None]
    if evidence.paid:
        found.sort(key=lambda item: item.id not in TAUGHT)
    implied = set().union(*(IMPLIED.get(item.id, set()) for item in found))
    return tuple(item for item in found if item.id not in implied)
