"""Advice on which actions the policy takes."""

import shlex

from drcli.analysis.findings.action_use import ActionUse
from drcli.analysis.findings.advice_item import Advice, rounded, train_on
from drcli.analysis.findings.curve_trend import LEAST_GAIN, present_trend
from drcli.analysis.findings.evidence import Evidence, is_sac

TOP_SHARE = 0.9

VARIETY = 0.12
"""A new policy has nearly 1; recorded trainings end with 0.5 to 0.8."""


LEARNED = 80.0
"""Percent of mean progress from which a policy may be sure."""


def no_exploration(evidence: Evidence) -> Advice | None:
    use = evidence.actions
    if use is None or evidence.level >= LEARNED or len(use.actions) < 2:
        return None
    trend = present_trend(evidence.curve)
    improving = evidence.fall is None and trend.rises and trend.gain >= LEAST_GAIN
    single = use.top_share >= TOP_SHARE
    known = [spread for spread in (use.variety, evidence.spread) if spread is not None]
    same = bool(known) and min(known) <= VARIETY
    if not single and (not same or improving):
        return None
    numbers = {"top_share": use.top_share, "progress": evidence.level}
    seen = ""
    if use.variety is not None:
        numbers["variety"] = use.variety
        seen = (
            f" At the same place of the lap it varies its actions by {100 * use.variety:.0f} % of "
            "what is possible."
        )
    if evidence.spread is not None:
        numbers["spread"] = evidence.spread
    setting, value = _more_exploration(evidence)
    return Advice(
        "no-exploration",
        "The car no longer tries anything new",
        f"It takes {named(use, use.top)} in {100 * use.top_share:.0f} % of the steps.{seen} But "
        f"it only gets {evidence.level:.0f} % of the lap, so it needs to find something better.",
        numbers,
        setting,
        train_on(f"{setting}={value}"),
    )


def _more_exploration(evidence: Evidence) -> tuple[str, str]:
    if is_sac(evidence.run):
        alpha = evidence.number("sac_alpha") or 0.1
        return "sac_alpha", rounded(2.0 * alpha)
    beta = evidence.number("beta_entropy") or 0.0
    return "beta_entropy", rounded(min(0.3, max(0.01, 3.0 * beta)))


def dead_actions(evidence: Evidence) -> Advice | None:
    use = evidence.actions
    if use is None or not use.dead:
        return None
    one = len(use.dead) == 1
    names = ", ".join(named(use, number) for number in use.dead)
    counts = sum(use.actions[number].count for number in use.dead)
    never = "never" if counts == 0 else f"in only {counts}"
    seen = (
        f"{never} of the last {use.steps:,} steps"
        if counts
        else f"in none of the last {use.steps:,} steps"
    )
    rarest = min(action.share for action in use.actions if action.index not in use.dead)
    prefix = shlex.quote(evidence.run.name) if evidence.run.name else ""
    where = f" -p {prefix}" if prefix else ""
    return Advice(
        "dead-action",
        f"{'An action is' if one else 'Some actions are'} dead",
        f"{names[0].upper()}{names[1:]} {'was' if one else 'were'} used {seen}; every other action "
        f"in {100 * rarest:.1f} % or more. A new model without {'it' if one else 'them'} has less "
        "to learn. The number of actions of this model cannot change.",
        {"dead": float(len(use.dead)), "action": float(use.dead[0]), "steps": float(use.steps)},
        "action_space",
        f"dr-action-space from-histogram{where} --write",
    )


def named(use: ActionUse, number: int) -> str:
    action = use.actions[number]
    if use.continuous:
        return f"steering near {action.steering_deg:.0f} degrees at {action.speed_mps:.1f} m/s"
    return f"action {number} ({action.steering_deg:g} degrees, {action.speed_mps:g} m/s)"
