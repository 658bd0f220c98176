"""Advice on laps of evaluations that are not clean."""

import shlex

from drcli.analysis.findings.action_advice import LEARNED, TOP_SHARE, named
from drcli.analysis.findings.advice_item import TRAIN_ON, Advice
from drcli.analysis.findings.curve_trend import rise
from drcli.analysis.findings.evaluated_laps import EvaluatedLaps
from drcli.analysis.findings.evidence import Evidence
from drcli.analysis.findings.reward_advice import REWARD_CHECK
from drcli.analysis.findings.verdict import NOT_LEARNING


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
    if found.crashed:
        seen.append(f"{_counted(found.crashed, 'crash')}")
    if found.resets:
        seen.append(_counted(found.resets, "reset"))
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
