"""The racer's own files travel to the bucket and back."""

import os

import pytest

from drcli.base.errors import SettingsError
from drcli.transfer.copy_custom_files import download_custom_files, upload_custom_files


@pytest.fixture
def said():
    return []


@pytest.fixture
def custom(mover):
    folder = mover.folder / "custom_files"
    folder.mkdir()
    (folder / "reward_function.py").write_text("mine")
    (folder / "run.env").write_text("A=1")
    (folder / "über alles").mkdir()
    (folder / "über alles" / "a b.txt").write_text("c")
    (folder / "reward_function.py.bak").write_text("old")
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "x.pyc").write_text("")
    return folder


FILES = ["reward_function.py", "run.env", "über alles/a b.txt"]


def test_all_files_are_uploaded_with_those_of_settings_but_not_leftovers(mover, custom, said):
    report = upload_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert said == ["Uploading files to s3://bucket/custom_files"]
    assert report.copied == FILES
    assert mover.here.get("custom_files/über alles/a b.txt") == b"c"


def test_only_what_changed_is_copied_and_nothing_is_deleted(mover, custom, said):
    upload_custom_files(mover.settings().custom_files, mover.settings().storage, said.append)
    (custom / "run.env").write_text("A=2")
    (custom / "reward_function.py").unlink()

    report = upload_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert (report.copied, report.unchanged) == (["run.env"], ["über alles/a b.txt"])
    assert mover.here.exists("custom_files/reward_function.py")


def test_they_come_back_and_a_different_file_is_kept(mover, custom, said):
    upload_custom_files(mover.settings().custom_files, mover.settings().storage, said.append)
    (custom / "run.env").write_text("A=2")
    (custom / "mine.txt").write_text("m")
    (custom / "über alles" / "a b.txt").unlink()

    report = download_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert said[-1] == "Downloading files from s3://bucket/custom_files"
    assert report.copied == ["run.env", "über alles/a b.txt"]
    assert report.unchanged == ["reward_function.py"]
    assert (custom / "run.env").read_text() == "A=1"
    assert (custom / "run.env.bak").read_text() == "A=2"
    assert (custom / "mine.txt").exists()


def test_the_folder_of_an_experiment_is_its_own(mover, said):
    experiment = mover.folder / "experiments" / "first"
    (experiment / "custom_files").mkdir(parents=True)
    (experiment / "custom_files" / "reward_function.py").write_text("mine")
    (experiment / "run.env").write_text("DR_LOCAL_S3_CUSTOM_FILES_PREFIX=files/first\n")
    (mover.folder / "system.env").write_text("DR_EXPERIMENT_NAME=first\n")

    report = upload_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert report.place == "s3://bucket/files/first"
    assert mover.here.get("files/first/reward_function.py") == b"mine"


def test_a_folder_that_cannot_be_looked_into_is_named(mover, custom, said, monkeypatch):
    looked_into = os.scandir

    def scandir(folder):
        if str(folder).endswith("alles"):
            raise PermissionError(13, "Permission denied", str(folder))
        return looked_into(folder)

    monkeypatch.setattr("os.scandir", scandir)

    with pytest.raises(SettingsError, match=r"alles: cannot be read \(Permission denied\)"):
        upload_custom_files(mover.settings().custom_files, mover.settings().storage, said.append)


def test_a_folder_of_leftovers_need_not_be_readable(mover, custom, said, monkeypatch):
    looked_into = os.scandir

    def scandir(folder):
        assert "__pycache__" not in str(folder)
        return looked_into(folder)

    monkeypatch.setattr("os.scandir", scandir)

    report = upload_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert report.copied == FILES


def test_links_that_lead_nowhere_and_pipes_are_no_files(mover, custom, said):
    (custom / "gone").symlink_to("nowhere")
    (custom / "round").symlink_to("round")
    os.mkfifo(custom / "pipe")

    report = upload_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert report.copied == FILES


def test_a_file_whose_name_is_not_utf_8_is_refused_in_printable_words(mover, custom, said):
    name = os.fsdecode(b"caf\xe9.txt")
    try:
        (custom / name).touch()
    except OSError:
        pytest.skip("file names are text here")

    report = upload_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert report.refused == ["caf\\xe9.txt"]
    assert report.copied == FILES


def test_without_a_folder_there_is_nothing_to_upload(mover, said):
    with pytest.raises(SettingsError, match="custom_files: this folder does not exist"):
        upload_custom_files(mover.settings().custom_files, mover.settings().storage, said.append)


@pytest.mark.parametrize("name", ["../run.env", "/etc/x", "a/../../b", "a\\..\\b"])
def test_a_name_that_leads_out_of_the_folder_is_left_alone(mover, said, name):
    mover.here.put(f"custom_files/{name}", b"evil")
    before = (mover.folder / "run.env").read_bytes()

    report = download_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert report.refused == [name]
    assert (mover.folder / "run.env").read_bytes() == before
    assert not (mover.folder / "custom_files").exists()


def test_the_folders_that_consoles_mark_are_no_files(mover, said):
    for name in ("", "sub/", "sub/a.txt"):
        mover.here.put(f"custom_files/{name}", b"")

    report = download_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert (report.copied, report.refused) == (["sub/a.txt"], [])


def test_a_bucket_without_such_files_changes_nothing(mover, custom, said):
    report = download_custom_files(
        mover.settings().custom_files, mover.settings().storage, said.append
    )

    assert (report.copied, report.unchanged) == ([], [])
