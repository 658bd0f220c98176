"""What a support bundle takes from the bucket: the journal, and the model's keys."""

from drcli.base.errors import DrError
from drcli.config.settings import Settings
from drcli.runs.periodic import within
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.connect import open_running_bucket

PATIENCE_S = 10.0
MOST_STARTS = 50
JOURNAL_BYTES = 256 << 10
MOST_KEYS = 20_000


def objects_of(settings: Settings) -> tuple[dict[str, str], str]:
    """Texts by name, and why some are missing; starts no server."""
    found: dict[str, str] = {}
    reason: list[str] = []

    def read() -> None:
        try:
            bucket = open_running_bucket(settings.storage)
            if bucket is None:
                reason.append("its local server does not run.")
                return
            found["bucket-keys.txt"] = _listing(bucket, settings.model_prefix)
            _read_journal(bucket, settings.model_prefix, found)
        except DrError as error:
            reason.append(str(error))

    if not within(PATIENCE_S, read):
        reason.append(f"it did not answer within {PATIENCE_S:.0f} s.")
    return dict(found), " ".join(reason)


def _listing(bucket: Bucket, prefix: str) -> str:
    lines = []
    for folder in (keys.folder(prefix), keys.run_folder(prefix), keys.rollouts_folder(prefix)):
        lines += [
            f"{item.size_bytes:>12} {item.modified:%Y-%m-%d %H:%M:%S} {item.key}"
            for item in bucket.list(folder)
        ]
    more = len(lines) - MOST_KEYS
    end = [f"and {more:,} more"] if more > 0 else []
    return "\n".join([*lines[:MOST_KEYS], *end]) + "\n"


def _read_journal(bucket: Bucket, prefix: str, found: dict[str, str]) -> None:
    folder = keys.journal_folder(prefix)
    for item in bucket.list(folder)[-MOST_STARTS:]:
        data = bucket.get(item.key)
        if len(data) > JOURNAL_BYTES:  # whole lines from the end
            _, _, data = data[-JOURNAL_BYTES:].partition(b"\n")
        name = item.key.removeprefix(folder)
        found[f"journal/{name}"] = data.decode("utf-8", "replace")
