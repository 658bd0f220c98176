"""Every command and script of DeepRacer-for-Cloud, and its counterpart here."""

from dataclasses import dataclass
from typing import Literal

from drcli.cli.command_table import program_names

Verdict = Literal["same", "better", "not needed"]


@dataclass(frozen=True)
class Row:
    """One command or script of the reference.

    Attributes:
        name: What it is called there.
        verdict: "same" and "better" do its work under that name or the one in `here`; "not needed"
            has nothing to do here.
        why: What differs, or why nothing is needed.
        here: Our program or script; the reference's name where it is empty.
    """

    name: str
    verdict: Verdict
    why: str
    here: str = ""

    @property
    def program(self) -> str:
        """What to call here, empty where nothing is needed."""
        return "" if self.verdict == "not needed" else self.here or self.name


_METRICS = "starts TensorBoard; lines for a Grafana of your own: `DR_TELEGRAF_HOST`"
_X_SERVER = "no X server is used"

REFERENCE: tuple[Row, ...] = (
    # Setting up.
    Row(
        "source bin/activate.sh",
        "better",
        "same options, but optional: every command is a program that reads the settings itself, in "
        "any shell, cron job or service; `dr-init` puts a `bin/activate.sh` into the folder",
        "scripts/activate.sh",
    ),
    Row(
        "bin/prepare.sh",
        "better",
        "one script without root, docker, drivers or reboot",
        "scripts/install.sh",
    ),
    Row(
        "bin/init.sh",
        "better",
        "writes a commented working folder; never replaces files without asking",
        "dr-init",
    ),
    Row(
        "bin/autorun.sh",
        "better",
        "an instance needs run.env, system.env and one command, and continues the model in the "
        "bucket",
        "dr-start-training",
    ),
    Row("bin/runonce.sh", "not needed", "no reboot is needed; cron can run the commands"),
    Row(
        "dr-update",
        "better",
        "settings are read at every call; this checks them, with file and line",
    ),
    Row("dr-update-env", "better", "as `dr-update`"),
    Row("dr-reload", "better", "as `dr-update`; silent with `-q`"),
    Row(
        "dr-summary",
        "better",
        "one page; asks only the bucket, for two seconds at most; `--json`",
    ),
    # Training and evaluation.
    Row(
        "dr-start-training",
        "better",
        "same flags `-w -q -s -r -a -v -h`; `-v` shows more numbers: the console needs no refresh; "
        "everything is checked before anything starts; resumes; "
        "`-r` counts workers from 0, as documented there; an unknown flag exits 2",
    ),
    Row(
        "dr-stop-training",
        "better",
        "waits for the last checkpoint, metrics and logs; needs no root",
    ),
    Row(
        "dr-start-evaluation",
        "better",
        "same flags `-q -c`; fails if the model does not exist; never changes the model; "
        "without `-q` it prints the result, with `-q` it drives in the background",
    ),
    Row("dr-stop-evaluation", "same", "the evaluation ends within a second, without results"),
    Row(
        "dr-stop-all",
        "better",
        "stops what was started in this folder, and nothing else on the machine",
    ),
    Row(
        "dr-increment-training",
        "better",
        "same flags and questions; handles names with slashes, without a number, and "
        "numbers above nine; fails if the model has no checkpoint",
    ),
    Row(
        "dr-start-tournament",
        "better",
        "broken in the reference; drives the pairs of a race that `dr-race` has made",
    ),
    # Files and models.
    Row(
        "dr-upload-custom-files",
        "same",
        "copies that of the experiment if one is chosen; nothing is deleted",
    ),
    Row("dr-download-custom-files", "same", "copies back"),
    Row(
        "dr-upload-model",
        "better",
        "same flags and messages; any checkpoint; concurrent uploads are safe",
    ),
    Row(
        "dr-increment-upload-model",
        "better",
        "`-p` works; handles slashes and names without a number",
    ),
    Row("dr-download-model", "better", "same flags; verified before and after the copy"),
    Row("dr-list-aws-models", "better", "broken there; lists the models in the upload bucket"),
    Row("dr-set-upload-model", "better", "broken there; writes DR_UPLOAD_S3_PREFIX"),
    Row(
        "dr-upload-car-zip",
        "better",
        "same flags; any checkpoint (`-c`); the archive is checked by the rules of the car, its "
        "graph compared with the weights, before it is uploaded",
    ),
    Row("dr-local-aws", "same", "adds address, keys and region; starts the server"),
    # Looking.
    Row(
        "dr-logs-sagemaker",
        "same",
        "starts with the last 100 lines instead of the last five minutes",
    ),
    Row("dr-logs-robomaker", "same", "as `dr-logs-sagemaker`; `-n` counts from 1"),
    Row("dr-find-sagemaker", "same", "a process number instead of a container id"),
    Row("dr-find-robomaker", "same", "process numbers, one per line"),
    Row("dr-get-robomaker-stats", "better", "real-time factor and steps/s in one line; `--json`"),
    Row(
        "dr-start-viewer",
        "better",
        "the console, one page for live pictures, curves, models and races; `-p -b` as there; "
        "`-w -h -q -t` are accepted, the page chooses them itself; asks for a token; for this "
        "machine only, unless DR_WEBVIEWER_HOST opens it to others",
    ),
    Row("dr-stop-viewer", "same", "prints that nothing is running and exits 0"),
    Row(
        "dr-update-viewer",
        "better",
        "only needed for changed settings: new workers and trainings appear by themselves",
    ),
    Row(
        "dr-view-stream",
        "better",
        "same options; prints one MJPEG address for each worker, below the port of the console",
    ),
    Row(
        "dr-start-loganalysis",
        "better",
        "writes the report of `dr-analyze`, one HTML file, instead of starting a notebook server",
    ),
    Row("dr-stop-loganalysis", "same", "says that nothing runs; the report is a file"),
    Row("dr-logs-loganalysis", "same", "says that nothing runs; the report is a file"),
    Row("dr-url-loganalysis", "same", "the address of the report that was written last"),
    Row("dr-start-metrics", "better", _METRICS),
    Row("dr-stop-metrics", "better", "stops TensorBoard"),
    Row(
        "droa-list-models",
        "better",
        "one row per model, no fixed widths; `--json` prints an object with the list inside",
    ),
    Row(
        "droa-get-model",
        "better",
        "also takes the name of a model; `--json` has what the interface says under `values`",
    ),
    Row(
        "droa-download-logs",
        "better",
        "the whole file or nothing; never replaces a file without asking",
    ),
    Row(
        "droa-delete-model",
        "better",
        "also takes the name of a model; asks unless `-f` or `-y`, and exits 1 after a no",
    ),
    Row(
        "droa-import-model",
        "better",
        "checks the rules of DeepRacer on AWS before anything is sent, takes archives too, and "
        "waits for the verdict",
    ),
    # utils/
    Row(
        "utils/timed-stop.sh",
        "better",
        "commands need no activation: `0 6 * * * cd FOLDER && dr-stop-training`; or "
        "DR_TRAIN_MAX_MINUTES",
        "dr-stop-training",
    ),
    Row(
        "utils/evaluate.sh",
        "better",
        "the same in a cron job: `cd FOLDER && dr-stop-evaluation && dr-start-evaluation -q`",
        "dr-start-evaluation",
    ),
    Row(
        "utils/upload-rotate.sh",
        "better",
        "`dr-upload-model -f1` raises the number in the name and uploads; `dr-config set` writes "
        "a prefix to a settings file; iteration and entropy: `dr-status --json`",
        "dr-upload-model",
    ),
    Row(
        "utils/sample-createspot.sh",
        "better",
        "`dr-spot create` makes the machine, installs drcli on it, trains, and goes on after "
        "interruptions; `dr-spot stop` saves the model and removes the machine",
        "dr-spot",
    ),
    Row(
        "utils/download-car-model.py",
        "better",
        "`dr-export car -p PREFIX` makes the archive of any model in the bucket",
        "dr-export",
    ),
    Row("utils/setup-xorg.sh", "not needed", _X_SERVER),
    Row("utils/start-xorg.sh", "not needed", _X_SERVER),
    Row("utils/start-local-browser.sh", "not needed", _X_SERVER),
    Row(
        "utils/cuda-check.sh",
        "better",
        "`dr-summary` names the GPU and whether torch can use it",
        "dr-summary",
    ),
)

SCRIPTS = ("scripts/activate.sh", "scripts/install.sh")
"""Entries of the table that are not commands."""


def missing() -> list[str]:
    """Programs of the table that do not exist here; there should be none."""
    known = {*program_names(), *SCRIPTS}
    return [row.program for row in REFERENCE if row.program and row.program not in known]
