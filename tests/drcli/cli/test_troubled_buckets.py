"""Every command that reads a bucket, on one that cannot be read: what is unknown is not "none".

The bucket holds a model with checkpoints all the time.
"""

import re
import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from drcli.bucket.s3_bucket import S3Bucket
from drcli.cli.command_table import COMMANDS
from drcli.model import keys
from drcli.records.iteration import encode_history
from drcli.records.run_record import RunRecord, run_folder
from refusing_s3 import Refusals, refusing_server
from stored_models import iteration
from trained_model import put_trained_model

BUCKET, UPLOADS = "troubled", "troubled-uploads"

REFUSED_CALLS = [
    "journal",
    "history",
    "history show model",
    "history compare model model",
    "history tree",
    "logs trainer",
    "logs reward",
    "analyze",
    "analyze compare model other",
    "start-loganalysis --no-open",
    "start-training -q",
    "start-training -w -q",
    "start-training --resume -q",
    "start-training --resume-or-start --no-wait -q",
    "start-worker --join s3://troubled/model",
    "increment-training -f",
    "sweep list",
    "sweep show none",
    "evaluate -q",
    "start-evaluation -q",
    "evaluate --models model",
    "race list",
    "race show cup",
    "race submit cup --racer Ann",
    "race create cup",
    "race delete cup -f",
    "start-tournament",
    "video --gif",
    "saliency -n 1",
    "action-space from-histogram",
    "upload-model -f",
    "upload-model -f -b --dry-run",
    "download-model -s s3://troubled-uploads/model -t copy -f",
    "export car",
    "export pb",
    "import s3://troubled/model -L -t copy -f",
    "import s3://troubled-uploads/model -t copy -f",
    "upload-car-zip -f",
    "list-models",
    "list-models --json",
    "list-checkpoints",
    "list-checkpoints --check",
    "note add words",
    "note list",
    "delete-model model -f",
    "tidy -f",
    "list-aws-models",
    "increment-upload-model -f -w",
    "upload-custom-files",
    "download-custom-files",
]
"""They cannot do their work: exit code 4."""

TOLD_CALLS = {
    "attach": "unknown",
    "status": "unknown",
    "status --json": '"unreachable": "Cannot ',
    "summary": "unknown",
    "validate": "The bucket cannot be used",
    "doctor": "problem",
}
"""They say what they can, and that this is not all."""

LONG = {"validate", "doctor"}
"""Tried once: most of what they do has nothing to do with the bucket."""

WITHOUT_BUCKET = {
    *("stop-training", "stop-all", "stop-evaluation", "find-sagemaker", "find-robomaker"),
    *("get-robomaker-stats", "logs-sagemaker", "logs-robomaker", "url", "url-loganalysis"),
    *("stop-loganalysis", "logs-loganalysis", "start-viewer", "stop-viewer", "update-viewer"),
    *("view-stream", "console", "send-message", "stop-metrics", "set-upload-model", "car", "spot"),
    *("droa-login", "droa-logout", "droa-list-models", "droa-get-model", "droa-download-logs"),
    *("droa-delete-model", "droa-import-model", "init", "bench", "update", "update-env", "reload"),
    *(
        "docs",
        "explain",
        "local-aws",
        "completion",
        "tracks",
        "reward",
        "help",
        "version",
        "droa",
        "metrics",
    ),
    "config",  # its check is that of validate
    "support-bundle",  # it has what doctor and status say
    "start-metrics",  # it shows what is on this machine, and says so
}
"""Rows that read no bucket, or another program's, or only while something runs here."""

CONTRADICTIONS = re.compile(
    r"there (is|are) (no|nothing)|\bhas no\b|no (checkpoint|model|training|journal|race)\b|"
    r"does not exist|is missing|is empty|nothing (was|to)|\b0 (models|checkpoints)|not damaged",
    re.IGNORECASE,
)
DELETES = re.compile(r"(^|[\s`])-w\b|dr-(delete-model|tidy)|start (again|over)|\bdelete\b", re.I)

TROUBLES: dict[str, Callable[[Refusals], None]] = {
    "silent": lambda refusals: refusals.silence.clear(),
    "refuses": lambda refusals: None,
    "denied": lambda refusals: vars(refusals).update(everything=True),
    "expired": lambda refusals: vars(refusals).update(
        everything=True, code="ExpiredToken", status=400, message="The token has expired."
    ),
}
SENTENCES = {
    "silent": "no server answers there",
    "refuses": "no server answers there",
    "denied": "lack the permission",
    "expired": "have expired",
}


@pytest.fixture(scope="module")
def stored() -> Iterator[tuple[str, Refusals]]:
    """The address of a server with two models, and what it refuses."""
    with refusing_server() as (endpoint, refusals):
        own, uploads = S3Bucket(endpoint, BUCKET), S3Bucket(endpoint, UPLOADS)
        for bucket, prefix in ((own, "model"), (own, "other"), (uploads, "model")):
            bucket.ensure_exists()
            put_trained_model(bucket, prefix)
            bucket.put(keys.history(prefix), encode_history([iteration(n) for n in range(3)]))
        assert endpoint.url is not None
        yield endpoint.url, refusals
        for bucket in (own, uploads):
            bucket.delete([info.key for info in bucket.list("")])


@pytest.fixture
def troubled(stored, working_folder, monkeypatch) -> Iterator[Callable[[str], None]]:
    """Puts the bucket of a working folder into one of the troubles."""
    address, refusals = stored
    own_init = S3Bucket.__init__

    def hasty(self, *args, **named):
        limits = {"patience_s": 0.05, "read_timeout_s": 0.2}
        own_init(self, *args, **{**named, **limits})

    monkeypatch.setattr(S3Bucket, "__init__", hasty)
    for name in ("ACCESS_KEY_ID", "SECRET_ACCESS_KEY"):
        monkeypatch.setenv(f"AWS_{name}", "testing")
    custom = working_folder / "custom_files"
    custom.mkdir()
    (custom / "reward_function.py").write_text("def reward_function(params):\n    return 1.0\n")

    def begin(trouble: str) -> None:
        url = f"http://127.0.0.1:{_closed_port()}" if trouble == "refuses" else address
        (working_folder / "system.env").write_text(
            f"DR_CLOUD=remote\nDR_REMOTE_MINIO_URL={url}\nDR_LOCAL_S3_BUCKET={BUCKET}\n"
            f"DR_UPLOAD_S3_ENDPOINT_URL={url}\nDR_UPLOAD_S3_BUCKET={UPLOADS}\n"
        )
        with (working_folder / "run.env").open("a") as file:
            file.write("DR_UPLOAD_S3_PREFIX=model\n")
        TROUBLES[trouble](refusals)

    yield begin
    refusals.silence.set()
    vars(refusals).update(everything=False, code="AccessDenied", status=403, message="")
    for thread in threading.enumerate():
        if "ask" in thread.name:
            thread.join(30)


def _closed_port() -> int:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        return int(closed.getsockname()[1])


@pytest.mark.parametrize("trouble", TROUBLES)
@pytest.mark.parametrize("words", REFUSED_CALLS)
def test_a_command_that_cannot_read_the_bucket_says_why_and_nothing_about_what_is_there(
    troubled, dr, capsys, words, trouble
):
    troubled(trouble)

    code = dr(*words.split())

    said = capsys.readouterr()
    assert code == 4, said.err
    assert SENTENCES[trouble] in said.err
    assert "Try: " in said.err
    assert ".drcli-test" not in said.err.partition("Try: ")[2]
    assert not CONTRADICTIONS.findall(said.out + said.err)
    assert not DELETES.findall(said.out + said.err)


@pytest.mark.parametrize(
    ("words", "trouble"),
    [
        (words, trouble)
        for words in TOLD_CALLS
        for trouble in TROUBLES
        if words not in LONG or trouble == "expired"
    ],
)
def test_a_command_that_tells_what_it_can_says_what_is_unknown(
    troubled, dr, capsys, words, trouble
):
    troubled(trouble)

    dr(*words.split())

    said = capsys.readouterr()
    assert TOLD_CALLS[words] in said.out
    assert not CONTRADICTIONS.findall(said.out + said.err) or words in LONG
    assert not DELETES.findall(said.out + said.err)


@pytest.mark.parametrize("trouble", TROUBLES)
def test_a_training_that_was_stopped_keeps_its_unknown_checkpoints(
    troubled, dr, capsys, trouble, working_folder
):
    troubled(trouble)
    run = RunRecord(0, "s", BUCKET, "model", "reinvent_base", "stopped", 1, 0.0, 1.0)
    run.write(run_folder(working_folder, 0))

    dr("status")

    said = capsys.readouterr().out
    assert "Iterations and checkpoints are unknown: Cannot " in said
    assert not CONTRADICTIONS.findall(said)
    assert not DELETES.findall(said)


def test_every_row_of_the_table_is_tried_or_reads_no_bucket():
    tried = {words.split()[0] for words in (*REFUSED_CALLS, *TOLD_CALLS)}

    rows = {command.name for command in COMMANDS if not command.hidden}
    assert tried | WITHOUT_BUCKET == rows
    assert not tried & WITHOUT_BUCKET
