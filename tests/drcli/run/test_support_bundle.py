"""A bundle helps, and takes no secret along, wherever one was planted."""

import base64
import bz2
import gzip
import io
import json
import lzma
import re
import stat
import tarfile
import zlib
from functools import cache
from pathlib import Path
from urllib.parse import quote

import pytest

from drcli.bucket import endpoint
from drcli.checks.doctor.findings import DoctorReport, Finding
from drcli.model import keys
from drcli.records.run_record import JournalEntry, RunRecord, run_folder
from drcli.run import support_bundle
from drcli.run.redaction import Redactor

CANARIES = {
    "environment": "env/Canary+0123456789abcdefghijklmnop=",
    "token": "tok-canary-9f8e7d6c5b4a",
    "password in an address": "p4ss-canary%2Fword",
    "run.env": "run-env-canary-77",
    "system.env": "system-env-canary-78",
    "worker-1.env": "worker-env-canary-79",
    "credentials": "Aws/Cred+Canary/abcdefghij0123456789ABCD",
    "other profile": "OtherProfileCanary0123456789abcdefghijkl",
    "sso": "sso-canary-access-token-000111222333",
    "droa": "droa-canary-session-token-444555666",
    "cookie": "car-cookie-canary-777888",
    "server": "server-canary-secret-999000aaa",
    "netrc": "netrc-canary-pw",
    "hook": "T0CANARY/B0CANARY/hookcanary",
    "presigned": "0f1e2d3c4b5a69788796a5b4c3d2e1f0canary",
    "bearer": "bearer-canary-abcdefghijkl",
    "key id": "AKIACANARYCANARY1234",
}


@pytest.fixture(autouse=True)
def no_keys_of_other_tests(monkeypatch):
    """Their keys are those of this process, and may be single letters."""
    monkeypatch.setattr(endpoint, "_used", [])


@cache
def everything(text: str) -> str:
    """A line as a careless program logs it, with all secrets in many forms."""
    lines = []
    for value in CANARIES.values():
        data = value.encode()
        coded = [base64.b64encode(pack(b"x=" + data)).decode() for pack in PACKERS]
        forms = [value, quote(value, safe=""), json.dumps(value), data.hex(), *coded]
        lines += [f"{text} {form}" for form in forms if value not in UNKNOWN]
    lines += [
        f"Authorization: Bearer {CANARIES['bearer']}",
        f"GET https://b.s3.amazonaws.com/k?X-Amz-Signature={CANARIES['presigned']}&x=1",
        f"POST https://hooks.slack.com/services/{CANARIES['hook']}",
        f"found {CANARIES['key id']} in a file",
    ]
    return "\n".join([*lines, "a harmless line"]) + "\n"


UNKNOWN = {CANARIES[name] for name in ("presigned", "bearer", "hook", "key id")}
"""No file holds them: they are found by their form alone."""

PACKERS = (bytes, base64.b64encode, gzip.compress, zlib.compress, bz2.compress, lzma.compress)


@pytest.fixture
def home(tmp_path_factory, monkeypatch) -> Path:
    home = tmp_path_factory.mktemp("jane")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("LOGNAME", "jane-canary")
    for name in ("XDG_CACHE_HOME", "AWS_SHARED_CREDENTIALS_FILE", "AWS_CONFIG_FILE"):
        monkeypatch.delenv(name, raising=False)
    return home


def write(path: Path, text: str | bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode() if isinstance(text, str) else text)


@pytest.fixture
def folder(working_folder, home, monkeypatch) -> Path:
    """A working folder with a secret in every place."""
    c = CANARIES
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", c["environment"])
    monkeypatch.setenv("GITHUB_TOKEN", c["token"])
    monkeypatch.setenv("DB_URL", f"postgres://me:{c['password in an address']}@host/db")
    for name in ("run.env", "system.env"):
        with (working_folder / name).open("a") as file:
            file.write(f"MY_SECRET={c[name]}  # {c[name]}\n")
    write(working_folder / "worker-1.env", f"MY_API_KEY='{c['worker-1.env']}'\n")
    write(
        home / ".aws/credentials",
        f"[default]\naws_access_key_id = AKIACANARYDEFAULT0\n"
        f"aws_secret_access_key = {c['credentials']}\n\n[minio]\naws_access_key_id = minio-canary\n"
        f"aws_secret_access_key={c['other profile']}\n",
    )
    write(home / ".aws/sso/cache/a.json", json.dumps({"accessToken": c["sso"], "region": "x"}))
    write(home / ".droa-cache/b.json", json.dumps({"session_token": c["droa"], "expiry": "2026"}))
    write(home / ".cache/drcli/cars/c.json", json.dumps({"cookies": {"deepracer": c["cookie"]}}))
    write(home / ".netrc", f"machine x login y password {c['netrc']}\n")
    write(
        working_folder / "data/s3/.server.json",
        json.dumps(
            {"engine": "rclone", "port": 1, "access_key": "AKsrv", "secret_key": c["server"]}
        ),
    )
    reward = f"# key: {c['credentials']}\ndef reward_function(params):\n    return 1.0\n"
    write(working_folder / "custom_files/reward_function.py", reward)
    said = everything("I was told").encode() + b"\xff\xfe\0binary"
    for name in ("robomaker/sim-0.log", "sagemaker/trainer.log", "crash-20261122-000000.txt"):
        write(working_folder / "data/logs/model" / name, said)
    write(working_folder / "data/logs/crash-20261122-000000.txt", everything("Traceback"))
    record = RunRecord(
        run_id=0,
        session="s",
        bucket="bucket",
        prefix="model",
        world="w",
        state="failed",
        pid=1,
        pid_started=1.0,
        started_at=1.0,
        message=f"refused {c['environment']}",
    )
    record.write(run_folder(working_folder, 0))
    journal = JournalEntry(1.0, "fault", everything("failed"), {"url": c["environment"]})
    bucket = working_folder / "data/s3/bucket"
    write(bucket / keys.journal("model", 1, "abc"), journal.encode_line())
    write(bucket / f"model/{c['token']}/object", b"")
    return working_folder


@pytest.fixture(autouse=True)
def doctor_answers(monkeypatch):
    """The doctor's own tests examine machines; this takes no time."""
    found = Finding("bucket", "problem", f"refused {CANARIES['environment']}")
    monkeypatch.setattr(
        support_bundle, "diagnose", lambda folder: DoctorReport(str(folder), 0.1, (found,))
    )


def contents(archive: Path) -> dict[str, str]:
    with tarfile.open(archive) as tar:
        return {
            entry.name.removeprefix("drcli-support/"): tar.extractfile(entry).read().decode()
            for entry in tar
        }


def forms_of(value: str) -> list[str]:
    """What may not be found: the value, as it is, for addresses, in JSON, hex and base64."""
    data = value.encode()
    cores = []
    for before in range(3):
        coded = base64.b64encode(b"\0" * before + data).decode().rstrip("=")
        cores.append(coded[-(-8 * before // 6) : (before + len(data)) * 8 // 6])
    return [value, quote(value, safe=""), json.dumps(value)[1:-1], data.hex(), *cores]


def unpacked(text: str) -> list[bytes]:
    """Everything in a text that is base64 of compressed data."""
    found = []
    for word in re.findall(r"[A-Za-z0-9+/]{16,}={0,2}", text):
        try:
            data = base64.b64decode(word)
        except ValueError:
            continue
        for unpack in (gzip.decompress, zlib.decompress, bz2.decompress, lzma.decompress):
            try:
                found.append(unpack(data))
            except (OSError, ValueError, EOFError, zlib.error, lzma.LZMAError):
                continue
    return found


def test_nothing_that_was_planted_leaves_and_each_removal_is_listed(folder, home, dr, capsys):
    assert dr("support-bundle", "out.tar.gz", "--json") == 0
    printed = capsys.readouterr()

    texts = contents(folder / "out.tar.gz")
    raw = gzip.decompress((folder / "out.tar.gz").read_bytes()).decode("latin-1")
    for where, value in {**CANARIES, "2nd": "minio-canary", "3rd": "AKIACANARYDEFAULT0"}.items():
        for form in forms_of(value):
            assert form not in raw, f"{where}: {form}"
            assert form not in printed.out + printed.err
        for data in unpacked(raw):
            assert value.encode() not in data
    assert str(home) not in raw
    assert "jane-canary" not in raw
    assert "canary" not in raw.lower()

    manifest = json.loads(texts["manifest.json"])
    removed = {(each["file"], each["kind"]) for each in manifest["redactions"]}
    for file in ("files/run.env", "files/system.env", "files/worker-1.env", "doctor.json"):
        assert any(name == file for name, _ in removed), file
    assert ("files/data/logs/model/robomaker/sim-0.log", "AWS key id") in removed
    lines = texts["files/data/logs/model/robomaker/sim-0.log"].splitlines()
    assert lines.count("a harmless line") == 1
    for each in manifest["redactions"]:
        assert "(hidden: " in texts[each["file"]].splitlines()[each["line"] - 1]
    report = json.loads(printed.out.splitlines()[-1])
    assert sum(report["redactions"].values()) == sum(e["count"] for e in manifest["redactions"])
    assert report["known_secrets"] >= len(CANARIES) - len(UNKNOWN)


def test_what_helps_is_in_it_and_nothing_else(folder, dr, capsys):
    write(folder / "custom_files/notes.txt", "private notes")
    write(folder / "data/logs/model/robomaker/picture.png", b"\x89PNG")
    write(folder / ".ssh/id_rsa", "private")
    (folder / "data/logs/model/robomaker/linked.log").symlink_to(folder / ".ssh/id_rsa")

    assert dr("support-bundle", "out.tar.gz") == 0

    texts = contents(folder / "out.tar.gz")
    assert sorted(texts) == sorted(
        [
            "README.txt",
            "bucket-keys.txt",
            "doctor.json",
            "files/custom_files/reward_function.py",
            "files/data/logs/crash-20261122-000000.txt",
            "files/data/logs/model/robomaker/sim-0.log",
            "files/data/logs/model/sagemaker/trainer.log",
            "files/data/runs/0/run.json",
            "files/run.env",
            "files/system.env",
            "files/worker-1.env",
            "journal/000001-abc.jsonl",
            "manifest.json",
            "packages.txt",
            "settings.json",
            "status.json",
        ]
    )
    assert "numpy==" in texts["packages.txt"]
    assert "model/journal/000001-abc.jsonl" in texts["bucket-keys.txt"]
    names = [each["name"] for each in json.loads(texts["settings.json"])["settings"]]
    assert "DR_WORLD_NAME" in names
    said = capsys.readouterr()
    assert "out.tar.gz" in said.out
    assert "before you send it" in said.err


def test_an_archive_says_nothing_about_its_writer_and_is_private(folder, dr, capsys):
    dr("support-bundle", "out.tar.gz")

    with tarfile.open(folder / "out.tar.gz") as tar:
        assert {(e.uname, e.gname, e.uid, e.gid) for e in tar} == {("", "", 0, 0)}
    assert stat.S_IMODE((folder / "out.tar.gz").stat().st_mode) == 0o600


def test_custom_files_stay_here_if_that_is_wanted(folder, dr, capsys):
    dr("support-bundle", "out.tar.gz", "--without-files")

    texts = contents(folder / "out.tar.gz")
    assert not any("custom_files" in name for name in texts)
    assert "--without-files" in texts["manifest.json"]


def test_a_folder_without_settings_has_a_bundle_too(dr, tmp_path, home, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    assert dr("support-bundle", "out.tgz") == 0

    texts = contents(tmp_path / "out.tgz")
    assert {"doctor.json", "packages.txt", "manifest.json"} <= set(texts)
    assert "no run.env" in texts["manifest.json"]


def test_wrong_settings_are_no_obstacle(folder, dr, capsys):
    (folder / "run.env").write_text("DR_WORKERS=many\n")

    assert dr("support-bundle", "out.tar.gz") == 0

    texts = contents(folder / "out.tar.gz")
    assert "DR_WORKERS=many" in texts["files/run.env"]
    assert "DR_WORKERS" in json.loads(texts["manifest.json"])["left_out"][0]


def test_an_existing_file_is_kept_unless_forced(folder, dr, capsys):
    (folder / "out.tar.gz").write_text("mine")

    assert dr("support-bundle", "out.tar.gz") == 3
    assert (folder / "out.tar.gz").read_text() == "mine"
    assert dr("support-bundle", "out.tar.gz", "--force") == 0
    assert contents(folder / "out.tar.gz")


def test_a_bundle_that_cannot_be_written_leaves_nothing(folder, dr, capsys):
    (folder / "file").write_text("")

    assert dr("support-bundle", "file/out.tar.gz") == 3

    assert "cannot be written" in capsys.readouterr().err


def test_if_a_secret_got_through_no_bundle_is_written(folder, dr, capsys, monkeypatch):
    monkeypatch.setattr(Redactor, "clean", lambda self, name, text: text)

    assert dr("support-bundle", "out.tar.gz") == 3

    said = capsys.readouterr().err
    assert "would contain a secret" in said
    assert CANARIES["environment"] not in said
    assert not [path for path in folder.iterdir() if "tar" in path.name]


def test_of_a_long_log_whole_lines_from_both_ends_are_taken(folder, dr, capsys):
    log = folder / "data/logs/model/robomaker/sim-0.log"
    text = "".join(f"line {number} of a long log\n" for number in range(60_000))
    log.write_text(f"the first line\n{text}the last line\n")

    dr("support-bundle", "out.tar.gz")

    lines = contents(folder / "out.tar.gz")[
        "files/data/logs/model/robomaker/sim-0.log"
    ].splitlines()
    assert (lines[0], lines[-1]) == ("the first line", "the last line")
    assert sum("were left out here" in line for line in lines) == 1
    assert all(re.fullmatch(r"line \d+ of a long log|the .* line|\(.*\)", line) for line in lines)
    assert (folder / "out.tar.gz").stat().st_size < 2_000_000


def test_a_bundle_has_a_largest_size(folder, dr, capsys, monkeypatch):
    monkeypatch.setattr(support_bundle, "MOST_BYTES", 120_000)
    for number in range(9):
        write(folder / f"data/logs/model/robomaker/sim-{number}.log", "x y\n" * 10_000)

    dr("support-bundle", "out.tar.gz")

    texts = contents(folder / "out.tar.gz")
    assert sum(map(len, texts.values())) < 300_000
    assert "the bundle has" in texts["manifest.json"]
    assert io.StringIO(texts["README.txt"]).readline().startswith("Support bundle")
