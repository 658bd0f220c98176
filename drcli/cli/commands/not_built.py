"""Names of the reference behind which nothing is built, or nothing is needed."""

from collections.abc import Callable

from drcli.base.errors import NotAvailable
from drcli.cli.options import AsJson

_DROA = "DeepRacer on AWS is not spoken to from here yet: models, logs and imports stay there."
_DROA_REMEDY = (
    "Use its web page for now; `dr-upload-model` puts a model into any bucket, in the layout that "
    "its import takes."
)
_VIEWER = "There is no viewer yet; it will show the cars in a browser while they train."
_VIEWER_REMEDY = (
    "`dr-start-training` draws curves in the terminal, `dr-status` shows them at any time."
)
_NOTEBOOKS = "There is no notebook server yet; it will open analyses of the logs in a browser."
_NOTEBOOKS_REMEDY = (
    "Traces and metrics have the reference's format: point deepracer-utils at the folder or "
    "address that `dr-url model` prints."
)


def _refusal(command: str, message: str, remedy: str) -> Callable[[], None]:
    """A command that says why it does nothing and what to use now. Exits 7."""

    def refuse() -> None:
        raise NotAvailable(message, remedy=remedy)

    refuse.__doc__ = f"{message}\n\n{remedy} Exits 7.\n\nExample: {command}"
    return refuse


def _nothing(command: str, message: str) -> Callable[[], None]:
    """A command that ends what cannot run. Exits 0."""

    def answer(as_json: AsJson = False) -> None:
        from drcli.cli import console
        from drcli.runs.stopping import StopReport

        console.say(message)
        if as_json:
            console.emit(StopReport(), "", as_json=True)

    answer.__doc__ = f"{message}\n\nExits 0.\n\nExample: {command}"
    return answer


upload_car_zip = _refusal(
    "dr-upload-car-zip -fL",
    "Archives for the car are not made yet; this will put carfile.tar.gz below the model.",
    "`dr-upload-model` copies the model itself; keep its checkpoint until then.",
)
start_viewer = _refusal("dr-start-viewer", _VIEWER, _VIEWER_REMEDY)
update_viewer = _refusal("dr-update-viewer", _VIEWER, _VIEWER_REMEDY)
view_stream = _refusal("dr-view-stream", _VIEWER, _VIEWER_REMEDY)
stop_viewer = _nothing("dr-stop-viewer", "No viewer is running.")
start_metrics = _refusal(
    "dr-start-metrics",
    "There is no Grafana yet; this will show curves of all runs in a browser.",
    "`dr-status` draws the curves, `dr-status --json` gives every number of every iteration.",
)
stop_metrics = _nothing("dr-stop-metrics", "No metrics server is running.")
start_loganalysis = _refusal("dr-start-loganalysis", _NOTEBOOKS, _NOTEBOOKS_REMEDY)
stop_loganalysis = _nothing("dr-stop-loganalysis", "No log analysis is running.")
logs_loganalysis = _refusal("dr-logs-loganalysis", _NOTEBOOKS, _NOTEBOOKS_REMEDY)
url_loganalysis = _refusal("dr-url-loganalysis", _NOTEBOOKS, _NOTEBOOKS_REMEDY)
start_tournament = _refusal(
    "dr-start-tournament",
    "Tournaments are not needed: an evaluation races two models, as the reference's does by now.",
    "Set DR_RACE_TYPE=HEAD_TO_MODEL and DR_EVAL_OPP_S3_MODEL_PREFIX, then `dr-evaluate`.",
)
droa_list_models = _refusal("droa-list-models", _DROA, _DROA_REMEDY)
droa_get_model = _refusal("droa-get-model ID", _DROA, _DROA_REMEDY)
droa_download_logs = _refusal("droa-download-logs ID", _DROA, _DROA_REMEDY)
droa_delete_model = _refusal("droa-delete-model ID", _DROA, _DROA_REMEDY)
droa_import_model = _refusal("droa-import-model --best", _DROA, _DROA_REMEDY)
