"""An analysed training: tables, verdict and advice."""

import dataclasses
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

from drcli.analysis.findings.advice import advise
from drcli.analysis.findings.advice_item import Advice
from drcli.analysis.findings.evidence import Evidence, gather
from drcli.analysis.findings.reward_rate import reward_function_time
from drcli.analysis.findings.verdict import Verdict, judge
from drcli.analysis.run import Run, StoredEvaluation
from drcli.base.json_record import plain
from drcli.base.report import Col, Curve, Rows, Styled, View, bold, counted, dim, table
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


_PARTS, _ADVICE = 5, 2


def _mean(name: str, key: str, form: str, none: str = "-") -> Col:
    def of(rows: list[dict[str, Any]]) -> float | None:
        known = [row[key] for row in rows if row[key] is not None]
        return fmean(known) if known else None

    return Col(name, form, of=of, none=none)


def _span(rows: list[dict[str, Any]]) -> str:
    first, last = rows[0]["iteration"], rows[-1]["iteration"]
    return str(first) if first == last else f"{first}-{last}"


def _best_lap(rows: list[dict[str, Any]]) -> float | None:
    return min((row["best_lap_s"] for row in rows if row["best_lap_s"] is not None), default=None)


_COLUMNS = (
    Col("iterations", of=_span),
    _mean("reward", "mean_reward", "{:,.1f}"),
    _mean("progress", "mean_progress", "{:.1f} %"),
    Col("clean laps", "{:,.0f}", of=lambda rows: sum(row["complete_laps"] for row in rows)),
    Col("best lap", "{:.3f} s", of=_best_lap),
    _mean("evaluation", "eval_mean_progress", "{:.1f} %", none=""),
    _mean("clean on other tracks", "second_clean", "{:.0f} %", none=""),
)


@dataclass(frozen=True)
class AnalysisReport:
    """The result of `dr-analyze`."""

    model: Annotated[str, "Its name."]
    origin: Annotated[str, "Where it was read."]
    layout: Annotated[str, "drfc, drfc-workers, console, droa or upload."]
    world: Annotated[str | None, "Its track; None if unknown."]
    track_length_m: Annotated[float | None, "Length of that."]
    parent: Annotated[str | None, "The model that it was started from; None if unknown."]
    workers: Annotated[int, "Simulation workers whose steps were read."]
    episodes: Annotated[int, "Training episodes."]
    steps: Annotated[int, "Steps that were read."]
    complete_laps: Annotated[
        int,
        "Training episodes that were complete laps. All are clean: a training episode "
        "ends where the car breaks a rule.",
    ]
    best_lap_s: Annotated[float | None, "The fastest of them; None without one."]
    iterations: Annotated[list[dict[str, Any]], "The table `Run.iterations`, row by row."]
    learner: Annotated[list[dict[str, Any]], "The table `Run.learner`, row by row."]
    evaluations: Annotated[
        list[dict[str, Any]],
        "Stand-alone evaluations, the oldest first, with their trials. `best_lap_s` and "
        "`median_lap_s` are of clean laps; `complete_laps` and `best_finished_s` are of "
        "finished ones, which may have resets.",
    ]
    verdict: Annotated[dict[str, Any], "kind, sentence and numbers."]
    advice: Annotated[
        list[dict[str, Any]], "id, title, evidence, numbers, setting and command of each."
    ]
    findings: Annotated[
        dict[str, Any],
        "What verdict and advice rest on, by subject; None where too little is known.",
    ]
    hyperparameters: Annotated[dict[str, Any], "As in their file."]
    machine_hours: Annotated[float | None, "Of all starts; None if unknown."]
    cost_usd: Annotated[float | None, "What they cost; None if unknown."]
    problems: Annotated[list[str], "What was wrong with the files, a sentence each."] = field(
        default_factory=list
    )
    html: Annotated[str | None, "The report that was written."] = None
    png: Annotated[list[str], "The pictures that were written."] = field(default_factory=list)
    limit: Annotated[
        str, "How far that is from the limit of the car on the track; empty if unknown."
    ] = ""

    def view(self) -> View:
        track = self.world or "an unknown track"
        if self.track_length_m:
            track += f", {self.track_length_m:.1f} m"
        driven = ", ".join(
            counted(number, word)
            for number, word in (
                (len(self.iterations), "iteration"),
                (self.episodes, "episode"),
                (self.steps, "step"),
            )
        )
        best = "" if self.best_lap_s is None else f", best {self.best_lap_s:.3f} s"
        styles = {"improving": "green", "converged": "green"}
        styles |= dict.fromkeys(("collapsed", "declining", "not_learning"), "red")
        style = styles.get(self.verdict["kind"], "yellow")
        yield bold(f"{self.model} ({track})")
        yield f"{driven}; {counted(self.complete_laps, 'clean lap')}{best}"
        yield self.limit and f"The best lap, {self.limit}."
        yield (bold("Verdict: "), Styled(self.verdict["sentence"], style))
        if self.iterations:
            yield self._curve("reward", "{:.1f}", "cyan", None)
            yield self._curve("progress", "{:.0f} %", "green", 100.0)
            yield self._parts()
        newest = self.evaluations[-1]["summary"] if self.evaluations else ""
        yield newest and f"{counted(len(self.evaluations), 'evaluation')}; the newest: {newest}"
        for number, item in enumerate(self.advice[:_ADVICE], 1):
            yield (bold(f"{number}. {item['title']}. "), item["evidence"])
            yield [Styled(item["command"], "cyan")]
        more = "; ".join(item["title"] for item in self.advice[_ADVICE:])
        yield more and dim(f"Also: {more}.")
        yield not self.advice and dim("No advice: nothing in the data shows a fault.")
        yield from (f"Wrote {path}" for path in filter(None, [self.html, *self.png]))

    def _curve(self, name: str, form: str, style: str, top: float | None) -> Curve | None:
        known = [row[f"mean_{name}"] for row in self.iterations if row[f"mean_{name}"] is not None]
        if not known:
            return None
        ends = f"{form.format(known[0])} to {form.format(known[-1])}"
        return Curve(name, known, ends, style, top)

    def _parts(self) -> Rows:
        """Means of some parts of the training."""
        count = min(_PARTS, len(self.iterations))
        edges = [round(i * len(self.iterations) / count) for i in range(count + 1)]
        return table([self.iterations[start:end] for start, end in pairwise(edges)], *_COLUMNS)


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
