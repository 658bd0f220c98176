"""Commands of DeepRacer-for-Cloud that are not available in this version, or not needed."""

from collections.abc import Callable

from drcli.base.errors import NotAvailable
from drcli.cli import console
from drcli.cli.options import AsJson

_VIEWER = (
    "The viewer is not available in this version.",
    "`dr-start-training` and `dr-status` show the progress as curves in the terminal.",
)
_NOTEBOOKS = (
    "Log analysis notebooks are not available in this version.",
    "Traces and metrics have the usual DeepRacer format: use deepracer-utils with the folder or "
    "address that `dr-url model` prints.",
)


def _refusal(command: str, message: str, remedy: str) -> Callable[[], None]:
    """A command that says why it is not available, and exits 7."""

    def refuse() -> None:
        raise NotAvailable(message, remedy=remedy)

    refuse.__doc__ = f"{message}\n\n{remedy} Exits 7.\n\nExample: {command}"
    return refuse


def _nothing(command: str, message: str) -> Callable[[], None]:
    """A command that stops something that never runs, and exits 0."""

    def answer(as_json: AsJson = False) -> None:
        console.say(message)
        if as_json:
            from drcli.runs.stopping import StopReport

            console.emit(StopReport(), "", as_json=True)

    answer.__doc__ = f"{message}\n\nExits 0.\n\nExample: {command}"
    return answer


start_viewer = _refusal("dr-start-viewer", *_VIEWER)
update_viewer = _refusal("dr-update-viewer", *_VIEWER)
view_stream = _refusal("dr-view-stream", *_VIEWER)
stop_viewer = _nothing("dr-stop-viewer", "No viewer is running.")
start_metrics = _refusal(
    "dr-start-metrics",
    "Grafana is not available in this version.",
    "`dr-status` draws the curves; `dr-status --json` prints all numbers of all iterations.",
)
stop_metrics = _nothing("dr-stop-metrics", "No metrics server is running.")
start_loganalysis = _refusal("dr-start-loganalysis", *_NOTEBOOKS)
stop_loganalysis = _nothing("dr-stop-loganalysis", "No log analysis is running.")
logs_loganalysis = _refusal("dr-logs-loganalysis", *_NOTEBOOKS)
url_loganalysis = _refusal("dr-url-loganalysis", *_NOTEBOOKS)
start_tournament = _refusal(
    "dr-start-tournament",
    "Tournaments are not available; an evaluation can race two models.",
    "Set DR_RACE_TYPE=HEAD_TO_MODEL and DR_EVAL_OPP_S3_MODEL_PREFIX, then run `dr-evaluate`.",
)
