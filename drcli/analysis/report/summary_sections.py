"""The first sections: numbers at a glance, verdict, advice."""

from collections.abc import Mapping, Sequence

from drcli.analysis.findings.advice_item import Advice
from drcli.analysis.findings.verdict import Verdict
from drcli.analysis.report.markup import Content, Html, element, table, tiles
from drcli.analysis.report.section import Section
from drcli.analysis.report.words import count, digits, known, percent, seconds
from drcli.analysis.run import Run


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
    kind = _title(verdict.kind)
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


def _title(kind: str) -> str:
    return kind.replace("_", " ").capitalize()


def _duration(time_s: float) -> str:
    if not known(time_s):
        return digits(time_s)
    return f"{time_s / 3600:.1f} h" if time_s >= 3600 else f"{time_s / 60:.1f} min"
