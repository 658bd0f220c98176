"""Who may read what is written: its user alone, a group on purpose, or whom a file is handed to."""

import os
import stat
import subprocess
import sys

import pytest

from drcli.base.files import hand_out, make_folder, others_may_read, private, rewrite, write_json


@pytest.fixture(params=[0o022, 0o027, 0o002, 0o077], ids=oct)
def umask(request):
    """The umask of a racer's shell."""
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_what_a_command_and_its_processes_write_is_for_their_user_alone(tmp_path, umask):
    data = tmp_path / "data"
    with private(data):
        write_json(data / "runs" / "0" / "run.json", {})
        child = "open('child', 'w').close(); import os; os.makedirs('a/b')"
        subprocess.run([sys.executable, "-c", child], cwd=data, check=True)

    written = {path.name: mode(path) for path in (data, *data.rglob("*"))}
    assert {written.pop(name) for name in ("run.json", "child")} == {0o600}
    assert set(written.values()) == {0o700}
    (tmp_path / "after").touch()
    assert mode(tmp_path / "after") == 0o666 & ~umask


@pytest.mark.parametrize("rights", [0o2770, 0o2750])
def test_a_folder_that_belongs_to_a_group_on_purpose_stays_open_to_it(tmp_path, rights):
    data = tmp_path / "data"
    data.mkdir()
    data.chmod(rights)
    with private(data):
        write_json(data / "runs" / "run.json", {})

    assert mode(data / "runs") & 0o777 == rights & 0o777
    assert mode(data / "runs" / "run.json") == rights & 0o666
    data.chmod(rights & 0o777)  # not on purpose: the umask of an earlier version was 002
    with private(data):
        write_json(data / "run.json", {})
    assert mode(data / "run.json") == 0o600


def test_files_for_others_have_the_mode_of_the_racers_umask_in_a_command(tmp_path, umask):
    tmp_path.chmod(0o755)
    with private(tmp_path / "data"):
        make_folder(tmp_path / "exports" / "new")
        for name in ("exports/new/car.tar.gz", "report.html"):
            rewrite(tmp_path / name, b"")
        for name in ("system.env", "worker-2.env", "run.env.bak3"):
            rewrite(tmp_path / name, b"A_PASSWORD=x")

    assert mode(tmp_path / "exports/new") == mode(tmp_path / "exports") == 0o777 & ~umask
    assert mode(tmp_path / "exports/new/car.tar.gz") == 0o666 & ~umask
    assert mode(tmp_path / "report.html") == 0o666 & ~umask
    assert {mode(path) for path in tmp_path.glob("*.env*")} == {0o600}


def test_a_file_in_a_private_folder_is_handed_to_nobody(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir(mode=0o700)
    file = folder / "report.html"
    file.touch(0o600)

    hand_out(file)

    assert mode(file) == 0o600


@pytest.mark.parametrize("rights", [0o640, 0o644, 0o660, 0o666, 0o600])
def test_a_file_keeps_the_mode_that_the_racer_gave(tmp_path, rights):
    path = tmp_path / "system.env"
    path.write_text("A=1\n")
    path.chmod(rights)

    with private(tmp_path / "data"):
        rewrite(path, b"A=2\n")

    assert mode(path) == rights


@pytest.mark.parametrize(
    ("rights", "of_folder", "others"),
    [
        (0o600, 0o755, False),
        (0o644, 0o755, True),
        (0o640, 0o755, True),
        (0o604, 0o755, True),
        (0o640, 0o2750, False),
        (0o644, 0o2750, True),
    ],
)
def test_others_are_those_for_whom_a_file_is_not_meant(tmp_path, rights, of_folder, others):
    file = tmp_path / "folder" / "system.env"
    file.parent.mkdir()
    file.touch()
    file.chmod(rights)
    file.parent.chmod(of_folder)

    assert others_may_read(file) is others
