"""Stored evaluations as the page shows them: names, rows of tables, figures to compare."""

from collections.abc import Sequence
from typing import Any

from drcli.base.json_record import plain
from drcli.base.report import counted
from drcli.races.race_words import lap_time
from drcli.run.evaluation_report import EvaluationList, ListedEvaluation


def stamp_text(stamp: str) -> str:
    """Fourteen digits of a local time as a time; other names stay as they are."""
    if len(stamp) != 14 or not stamp.isdecimal():
        return stamp
    clock = ":".join((stamp[8:10], stamp[10:12], stamp[12:]))
    return f"{stamp[:4]}-{stamp[4:6]}-{stamp[6:8]} {clock}"


def lap_text(seconds: float | None) -> str:
    """As consoles write it: 00:13.600."""
    return "–" if seconds is None else lap_time(seconds).zfill(9)


def _joined(parts: Sequence[str | bool | None], by: str) -> str:
    return by.join(str(part) for part in parts if part)


def _label(each: ListedEvaluation) -> str:
    checkpoint = each.checkpoint.split("_")[0]
    return _joined(
        (
            stamp_text(each.stamp),
            each.world,
            each.reverse and "reverse",
            checkpoint and f"checkpoint {checkpoint}",
            f"{each.clean_laps} of {counted(len(each.trials), 'lap')} clean",
            each.best_lap_s is not None and lap_text(each.best_lap_s),
        ),
        " · ",
    )


def _about(each: ListedEvaluation) -> str:
    parts = (
        each.world and f"Track {each.world}{', in reverse' if each.reverse else ''}",
        each.race_type.lower().replace("_", " "),
        each.checkpoint and f"checkpoint {each.checkpoint}",
        each.summary,
    )
    return f"{_joined(parts, '; ')}."


def _figures(each: ListedEvaluation) -> list[tuple[str, str, float | None]]:
    """Name, text, and the seconds that can be subtracted."""
    direction = {None: "–", True: "reverse", False: "as built"}[each.reverse]
    trials, count = each.trials, len(each.trials)
    mean = "Mean of finished laps, with penalties"
    return [
        ("Track", each.world or "–", None),
        ("Direction", direction, None),
        ("Checkpoint", each.checkpoint or "–", None),
        ("Clean laps", f"{each.clean_laps} of {count}", None),
        ("Finished laps", f"{each.complete_laps} of {count}", None),
        ("Best clean lap", lap_text(each.best_lap_s), each.best_lap_s),
        (mean, lap_text(each.mean_lap_s), each.mean_lap_s),
        ("Off-tracks", str(sum(trial.off_track for trial in trials)), None),
        ("Crashes", str(sum(trial.crashes for trial in trials)), None),
        ("Resets", str(sum(trial.resets for trial in trials)), None),
    ]


def _note(each: ListedEvaluation) -> str:
    said = "Times are those of the simulation, penalties included."
    if each.off_track_penalty_s is None or each.collision_penalty_s is None:
        return said
    costs = f"{each.off_track_penalty_s:.1f} s, a crash {each.collision_penalty_s:.1f} s"
    return f"{said} Leaving the track costs {costs}."


_VIEWS = {
    "camera-pip": "from behind, with the camera",
    "camera-45degree": "from behind",
    "camera-topview": "from above",
}


def _films(each: ListedEvaluation, listed: EvaluationList) -> list[tuple[str, str]]:
    """Names of its videos with their views: its own, and of the newest also those of the model."""
    own = f"evaluation-{each.stamp}/video.mp4"
    found = [(own, "this evaluation")] if own in listed.videos else []
    if each is listed.evaluations[0]:
        views = [name for name in listed.videos if name.startswith("mp4/")]
        found += [(name, f"newest, {_VIEWS.get(name.split('/')[1], name)}") for name in views]
    return found


def shown_evaluations(listed: EvaluationList) -> dict[str, Any]:
    """The report, with these words beside each evaluation."""
    evaluations = []
    for each in listed.evaluations:
        rows = [
            (
                *(
                    str(trial.trial),
                    trial.time_text,
                    f"{trial.progress:.0f} %",
                    trial.ended().capitalize(),
                ),
                *(str(trial.off_track), str(trial.crashes), str(trial.resets)),
            )
            for trial in each.trials
        ]
        words = {"name": stamp_text(each.stamp), "label": _label(each), "about": _about(each)}
        more = {
            "rows": rows,
            "figures": _figures(each),
            "footnote": _note(each),
            "films": _films(each, listed),
        }
        evaluations.append(plain(each) | words | more)
    return {**plain(listed), "evaluations": evaluations}
