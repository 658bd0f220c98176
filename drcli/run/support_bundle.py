"""Packs what helps to understand a fault into an archive, without secrets.

Every text goes through `Redactor`; the archive is searched again.
"""

import gzip
import io
import json
import os
import tarfile
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Annotated

from drcli.base import log
from drcli.base.errors import DrError, ProblemsError, SettingsError
from drcli.base.files import find_files, refuse_existing
from drcli.base.report import Col, Styled, View, bold, counted, table
from drcli.bucket.connect import open_running_bucket
from drcli.bucket.endpoint import keys_in_use
from drcli.bucket.server.server_process import own_file
from drcli.checks.doctor.diagnose import diagnose
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.config.settings_report import inspect_values
from drcli.live.live_record import LIVE_FILES
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.run.known_secrets import known_secrets, private_words
from drcli.run.periodic import within
from drcli.run.read_logs import text_tail
from drcli.run.redaction import Redactor
from drcli.run.status import inspect

# Writes the archive of a support bundle, and searches it for secrets.


FOLDER = "drcli-support"


def check_writable(target: Path) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except OSError as error:
        raise _unwritable(target, error) from error


def write_checked(target: Path, texts: Mapping[str, str], redactor: Redactor) -> None:
    """Write the archive, search it for secrets, and only then give it its name.

    Raises:
        SettingsError: It cannot be written, or a secret was found in it.
    """
    try:
        number, scratch = tempfile.mkstemp(prefix=f".{target.name}-", dir=target.parent)
    except OSError as error:
        raise _unwritable(target, error) from error
    try:
        with os.fdopen(number, "wb") as file:
            file.write(_archive(texts))
        leaks = _leaks(Path(scratch), redactor)
        if leaks:
            raise SettingsError(
                f"The bundle would contain a secret: {'; '.join(leaks[:5])}.",
                remedy="No bundle was written. Report this as a fault of drcli, without the file.",
            )
        Path(scratch).replace(target)
    except OSError as error:
        raise _unwritable(target, error) from error
    finally:
        Path(scratch).unlink(missing_ok=True)


def _archive(texts: Mapping[str, str]) -> bytes:
    packed = io.BytesIO()
    now = int(time.time())
    with (
        gzip.GzipFile(filename="", fileobj=packed, mode="wb", mtime=now) as compressed,
        tarfile.open(fileobj=compressed, mode="w", format=tarfile.PAX_FORMAT) as archive,
    ):
        for name, text in texts.items():
            data = text.encode()
            entry = tarfile.TarInfo(f"{FOLDER}/{name}")
            entry.size, entry.mtime, entry.mode = len(data), now, 0o644
            archive.addfile(entry, io.BytesIO(data))
    return packed.getvalue()


def _leaks(path: Path, redactor: Redactor) -> list[str]:
    found = []
    with tarfile.open(path) as archive:
        for entry in archive:
            content = archive.extractfile(entry)
            text = "" if content is None else content.read().decode()
            found += [f"{entry.name}: {kind}" for kind in redactor.leaks(text)]
            found += [f"a file name: {kind}" for kind in redactor.leaks(entry.name)]
    return found


def _unwritable(target: Path, error: OSError) -> SettingsError:
    return SettingsError(
        f"{target}: the bundle cannot be written ({error.strerror or error}).",
        remedy="Name a file in a folder that you can write.",
    )


# What a support bundle takes from the bucket: the journal, and the model's keys.


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
            found["bucket-keys.txt"] = _listing(ModelStore(bucket, settings.model_prefix))
            _read_journal(ModelStore(bucket, settings.model_prefix), found)
        except DrError as error:
            reason.append(str(error))

    if not within(PATIENCE_S, read):
        reason.append(f"it did not answer within {PATIENCE_S:.0f} s.")
    return dict(found), " ".join(reason)


def _listing(model: ModelStore) -> str:
    lines = []
    for folder in (
        keys.folder(model.prefix),
        keys.run_folder(model.prefix),
        keys.rollouts_folder(model.prefix),
    ):
        lines += [
            f"{item.size_bytes:>12} {item.modified:%Y-%m-%d %H:%M:%S} {item.key}"
            for item in model.bucket.list(folder)
        ]
    more = len(lines) - MOST_KEYS
    end = [f"and {more:,} more"] if more > 0 else []
    return "\n".join([*lines[:MOST_KEYS], *end]) + "\n"


def _read_journal(model: ModelStore, found: dict[str, str]) -> None:
    folder = keys.journal_folder(model.prefix)
    for item in model.bucket.list(folder)[-MOST_STARTS:]:
        data = model.bucket.get(item.key)
        if len(data) > JOURNAL_BYTES:  # whole lines from the end
            _, _, data = data[-JOURNAL_BYTES:].partition(b"\n")
        name = item.key.removeprefix(folder)
        found[f"journal/{name}"] = data.decode("utf-8", "replace")


MANIFEST = "manifest.json"
MOST_BYTES = 12 << 20
LOG_BYTES = 1 << 20
"""The end of a log; its beginning has up to a sixteenth of that."""

RECORD_BYTES = 256 << 10
MOST_CRASHES = 5

README = """Support bundle of drcli, made {when}.

Read it before you send it to anybody: all of it is text. Secrets were removed; {manifest} lists
each removal with file, line and kind, and everything that was left out. After the archive was
written, it was searched again for the {known} secret values that this machine knows, and none was
found.

What programs cannot recognise is still there: a password in a comment, names of people, what a
reward function prints.
"""


@dataclass(frozen=True)
class BundledFile:
    """A file in the archive."""

    name: Annotated[str, "Its name in the archive.", Col("file")]
    size_bytes: Annotated[int, "Its size there.", Col("bytes", "{:,}")]
    redactions: Annotated[
        int,
        "How many secrets were removed from it.",
        Col("removed", lambda count: f"{count:,} removed" if count else "", style="dim"),
    ]


@dataclass(frozen=True)
class BundleReport:
    """The archive that `dr support-bundle` wrote."""

    file: Annotated[str, "The archive."]
    size_bytes: Annotated[int, "Its size."]
    files: Annotated[tuple[BundledFile, ...], "What is in it."]
    redactions: Annotated[Mapping[str, int], "How many secrets were removed, by kind."]
    known_secrets: Annotated[int, "Number of secret values that were searched for."]
    left_out: Annotated[tuple[str, ...], "What is not in it, and why."]

    def view(self) -> View:
        removed = [f"{count:,} x {kind}" for kind, count in self.redactions.items()]
        known = counted(self.known_secrets, "known secret value")
        return [
            table(self.files, "name", "size_bytes", "redactions"),
            bold("Removed:") if removed else "Nothing had to be removed.",
            removed,
            *(Styled(f"Left out: {reason}", "yellow") for reason in self.left_out),
            f"Searched again for {known}: none is in the archive.",
            bold(f"Wrote {self.file} ({self.size_bytes:,} bytes)."),
        ]


def make_bundle(
    directory: Path, target: Path, *, with_custom_files: bool = True, overwrite: bool = False
) -> BundleReport:
    """`directory` need not have settings.

    Raises:
        SettingsError: The archive exists or cannot be written, or a secret was found in it.
    """
    refuse_existing(target, force=overwrite)
    check_writable(target)  # before collecting, which takes a while
    return _Bundle(directory, with_custom_files=with_custom_files).write(target)


class _Bundle:
    def __init__(self, directory: Path, *, with_custom_files: bool) -> None:
        self._directory = directory
        self._with_custom_files = with_custom_files
        self._left_out: list[str] = []
        self._texts: dict[str, str] = {}
        self._bytes = 0
        self._settings = self._load()
        data_dir = directory / "data" / "s3"
        if self._settings is not None and self._settings.storage.cloud == "local":
            data_dir = self._settings.storage.data_dir
        self._data_dir = data_dir

    def write(self, target: Path) -> BundleReport:
        for name, text in self._everything():
            self._add(name, text)
        # The secrets last: some appear only when a bucket is used.
        home = _home()
        secrets = known_secrets(self._directory, self._data_dir, os.environ, home)
        secrets |= self._of_bucket()
        redactor = Redactor(secrets, private_words(home))
        names = {name: redactor.clean("names", name).replace(" ", "_") for name in self._texts}
        redactor.redactions.clear()
        texts = {names[name]: redactor.clean(names[name], t) for name, t in self._texts.items()}
        left_out = tuple(redactor.clean(MANIFEST, text) for text in self._left_out)
        when = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime())
        readme = README.format(when=when, manifest=MANIFEST, known=redactor.known)
        texts = {
            "README.txt": readme,
            MANIFEST: _manifest(texts, redactor, left_out),
            **texts,
        }
        write_checked(target, texts, redactor)
        return _report(target, texts, redactor, left_out)

    def _load(self) -> Settings | None:
        if not (self._directory / "run.env").is_file():
            self._left_out.append(f"settings: there is no run.env in {self._directory}.")
            return None
        try:
            return load_settings(self._directory)
        except ProblemsError as error:
            self._left_out.append(f"settings.json, status.json, bucket: {error}")
            return None

    def _add(self, name: str, text: str) -> None:
        size = len(text.encode("utf-8", "replace"))
        if self._bytes + size > MOST_BYTES:
            self._left_out.append(f"{name}: the bundle has {MOST_BYTES >> 20} MB already.")
            return
        self._bytes += size
        self._texts[name] = text

    def _everything(self) -> Iterator[tuple[str, str]]:
        """The most telling texts first."""
        yield "doctor.json", _json(asdict(diagnose(self._directory)))
        yield "packages.txt", _packages()
        if self._settings is not None:
            yield "settings.json", _json(asdict(inspect_values(self._settings)))
            try:
                yield "status.json", _json(asdict(inspect(self._settings.run)))
            except DrError as error:
                self._left_out.append(f"status.json: {error}")
        yield from self._settings_files()
        if self._with_custom_files:
            yield from self._custom_files()
        else:
            self._left_out.append("custom_files: --without-files was given.")
        yield from self._run_records()
        if self._settings is not None:
            found, reason = objects_of(self._settings)
            yield from found.items()
            if reason:
                self._left_out.append(f"bucket: {reason}")
        yield from self._logs()

    def _settings_files(self) -> Iterator[tuple[str, str]]:
        for pattern in ("*.env", "experiments/*/*.env"):
            for path in sorted(self._directory.glob(pattern)):
                yield from self._file(path, RECORD_BYTES)

    def _custom_files(self) -> Iterator[tuple[str, str]]:
        folders = [self._directory / "custom_files"]
        if self._settings is not None:
            folders.append(self._settings.custom_files_dir)
        for folder in dict.fromkeys(folders):
            for name in ("reward_function.py", "hyperparameters.json", "model_metadata.json"):
                yield from self._file(folder / name, RECORD_BYTES)

    def _run_records(self) -> Iterator[tuple[str, str]]:
        runs = self._directory / "data" / "runs"
        for path in sorted(
            [*find_files(runs, "*/*.json"), *find_files(runs, "*/evaluations/*/*.json")]
        ):
            if path.match(LIVE_FILES):
                continue  # it holds a key
            yield from self._file(path, RECORD_BYTES)

    def _logs(self) -> Iterator[tuple[str, str]]:
        folder = self._directory / "data" / "logs"
        crashes = sorted(folder.glob("crash-*.txt"), reverse=True)
        positions = (log.UPLOADED, log.SENT)
        logs = [path for path in folder.rglob("*.log*") if not path.name.endswith(positions)]
        logs += [own_file(self._data_dir, "log")]
        for path in [*crashes[:MOST_CRASHES], *sorted(logs, key=_age_s)]:
            yield from self._file(path, LOG_BYTES)

    def _file(self, path: Path, most_bytes: int) -> Iterator[tuple[str, str]]:
        if not path.is_file() or (path.is_symlink() and "custom_files" not in path.parts):
            return
        with suppress(ValueError):
            path = path.relative_to(self._directory)
        name = str(path).lstrip("/")
        try:
            yield f"files/{name}", text_tail(self._directory / path, most_bytes)
        except OSError as error:
            self._left_out.append(f"{name}: {error.strerror or error}")

    def _of_bucket(self) -> dict[str, str]:
        """Keys that the AWS library found, such as those of the machine's role."""
        return dict.fromkeys(keys_in_use(), "key of the bucket")


def _manifest(texts: Mapping[str, str], redactor: Redactor, left_out: tuple[str, ...]) -> str:
    return _json(
        {
            "files": [
                {"name": name, "bytes": len(text.encode()), "lines": text.count("\n")}
                for name, text in texts.items()
            ],
            "known_secrets": redactor.known,
            "redactions": [asdict(redaction) for redaction in redactor.redactions],
            "left_out": list(left_out),
        }
    )


def _report(
    target: Path, texts: Mapping[str, str], redactor: Redactor, left_out: tuple[str, ...]
) -> BundleReport:
    by_file: Counter[str] = Counter()
    by_kind: Counter[str] = Counter()
    for each in redactor.redactions:
        by_file[each.file] += each.count
        by_kind[each.kind] += each.count
    files = tuple(
        BundledFile(name, len(text.encode()), by_file[name]) for name, text in texts.items()
    )
    return BundleReport(
        file=str(target),
        size_bytes=target.stat().st_size,
        files=files,
        redactions=dict(by_kind.most_common()),
        known_secrets=redactor.known,
        left_out=left_out,
    )


@lru_cache(maxsize=1)
def _packages() -> str:
    """Not from where: an address may hold a password."""
    found = {f"{each.metadata['Name']}=={each.version}" for each in metadata.distributions()}
    return "\n".join(sorted(found, key=str.casefold)) + "\n"


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:
        return Path("/")


def _age_s(path: Path) -> float:
    try:
        return -path.stat().st_mtime
    except OSError:
        return 0.0


def _json(value: object) -> str:
    return json.dumps(value, indent=1, default=str) + "\n"
