"""An analysed training: tables, verdict and advice."""

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from drcli.analysis.findings.advice import advise
from drcli.analysis.findings.advice_item import Advice
from drcli.analysis.findings.evidence import Evidence, gather
from drcli.analysis.findings.reward_rate import reward_function_time
from drcli.analysis.findings.verdict import Verdict, judge
from drcli.analysis.run import Run, StoredEvaluation
from drcli.base.json_record import plain
from drcli.tracks.track_limit import limit_text

if TYPE_CHECKING:
    import pandas as pd

_NOT_FINDINGS = ("run", "curve", "fallen", "late")


@dataclass(frozen=True, eq=False)
class Analysis:
    """An analysed training."""

    run: Run
    evidence: Evidence
    verdict: Verdict
    advice: tuple[Advice, ...]

    def as_json(self) -> dict[str, Any]:
        return vars(self.report())

    def report(self, *, html: str | None = None, png: tuple[str, ...] = ()) -> "AnalysisReport":
        run = self.run
        laps = run.iterations["best_lap_s"].dropna()
        tables = run.iterations
        findings = {
            item.name: plain(getattr(self.evidence, item.name))
            for item in dataclasses.fields(self.evidence)
            if item.name not in _NOT_FINDINGS
        }
        findings["reward_function_time"] = plain(reward_function_time(run.steps))
        return AnalysisReport(
            model=run.name,
            origin=run.origin,
            layout=run.layout,
            world=run.world,
            track_length_m=None if run.track is None else round(run.track.length_m, 4),
            parent=run.parent,
            workers=int(run.steps["worker"].nunique()),
            episodes=int(tables["episodes"].sum()),
            steps=len(run.steps),
            complete_laps=int(tables["complete_laps"].sum()),
            best_lap_s=float(laps.min()) if len(laps) else None,
            iterations=rows_of(tables, index="iteration"),
            learner=rows_of(run.learner, index="iteration"),
            evaluations=[_evaluation(each) for each in run.evaluations],
            verdict=plain(self.verdict),
            advice=[plain(each) for each in self.advice],
            findings=findings,
            hyperparameters=plain(run.hyperparameters),
            machine_hours=run.machine_hours,
            cost_usd=run.cost_usd,
            problems=list(run.problems),
            html=html,
            png=list(png),
            limit=limit_text(float(laps.min()) if len(laps) else None, run.limit),
        )


@dataclass(frozen=True)
class AnalysisReport:
    """The result of `dr-analyze`.

    Attributes:
        model: Its name.
        origin: Where it was read.
        layout: drfc, drfc-workers, console, droa or upload.
        world: Its track; None if unknown.
        track_length_m: Length of that.
        parent: The model that it was started from; None if unknown.
        workers: Simulation workers whose steps were read.
        episodes: Training episodes.
        steps: Steps that were read.
        complete_laps: Training episodes that were complete laps. All are clean: a training episode
            ends where the car breaks a rule.
        best_lap_s: The fastest of them; None without one.
        limit: How far that is from the limit of the car on the track; empty if unknown.
        iterations: The table `Run.iterations`, row by row.
        learner: The table `Run.learner`, row by row.
        evaluations: Stand-alone evaluations, the oldest first, with their trials. `best_lap_s` and
            `median_lap_s` are of clean laps; `complete_laps` and `best_finished_s` are of finished
            ones, which may have resets.
        verdict: kind, sentence and numbers.
        advice: id, title, evidence, numbers, setting and command of each.
        findings: What verdict and advice rest on, by subject; None where too little is known.
        hyperparameters: As in their file.
        machine_hours: Of all starts; None if unknown.
        cost_usd: What they cost; None if unknown.
        problems: What was wrong with the files, a sentence each.
        html: The report that was written.
        png: The pictures that were written.
    """

    model: str
    origin: str
    layout: str
    world: str | None
    track_length_m: float | None
    parent: str | None
    workers: int
    episodes: int
    steps: int
    complete_laps: int
    best_lap_s: float | None
    iterations: list[dict[str, Any]]
    learner: list[dict[str, Any]]
    evaluations: list[dict[str, Any]]
    verdict: dict[str, Any]
    advice: list[dict[str, Any]]
    findings: dict[str, Any]
    hyperparameters: dict[str, Any]
    machine_hours: float | None
    cost_usd: float | None
    problems: list[str] = field(default_factory=list)
    html: str | None = None
    png: list[str] = field(default_factory=list)
    limit: str = ""


def analyse(run: Run) -> Analysis:
    evidence = gather(run)
    return Analysis(run, evidence, judge(evidence), advise(evidence))


def _evaluation(stored: StoredEvaluation) -> dict[str, Any]:
    trials, laps = stored.trials, stored.laps
    finished = trials.loc[trials["complete"].astype(bool), "time"]
    return {
        "stamp": stored.stamp,
        "world": stored.world,
        "summary": str(stored),
        "clean_laps": laps.clean,
        "best_lap_s": laps.fastest_s,
        "median_lap_s": laps.median_s,
        "resets": stored.resets,
        "complete_laps": len(finished),
        "best_finished_s": float(finished.min()) if len(finished) else None,
        "trials": rows_of(trials),
    }


def rows_of(table: "pd.DataFrame", *, index: str | None = None) -> list[dict[str, Any]]:
    if index is not None:
        table = table.rename_axis(index).reset_index()
    rows: list[dict[str, Any]] = plain(table.to_dict("records"))
    return rows
