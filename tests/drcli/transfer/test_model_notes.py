"""Notes of a model: written, changed, shown in lists, and copied with the model (001-26)."""

import json

import pytest

from drcli.base.errors import SettingsError, StorageError
from drcli.model import keys
from drcli.model.model_list import list_models
from drcli.model.model_store import ModelStore
from drcli.model.notes import describe
from drcli.transfer.model_notes import delete_note, list_notes, notes_of, rewrite_note, write_note


@pytest.fixture
def mine(mover, monkeypatch):
    """The settings of a racer whose notes go to the bucket of the mover."""
    monkeypatch.setattr("drcli.transfer.model_notes.open_bucket", lambda *_, **__: mover.here)
    return mover.settings()


def texts(found) -> list[tuple[int, str]]:
    return [(note.number, note.text) for note in found.notes]


def test_notes_are_added_changed_and_removed(mine):
    write_note(mine, None, "one")
    write_note(mine, None, " two\nlines ")
    assert texts(rewrite_note(mine, None, 0, "what it is")) == [
        (0, "what it is"),
        (1, "one"),
        (2, "two\nlines"),
    ]

    rewrite_note(mine, None, 1, "better")
    found = delete_note(mine, None, 2)

    assert texts(found) == [(0, "what it is"), (1, "better")]
    assert found.notes[1].checkpoint == 5
    assert found.notes[1].edited_at is not None


def test_the_list_of_models_shows_the_description_else_the_newest_note(mover, mine):
    write_note(mine, None, "older")
    write_note(mine, None, "newer")
    assert list_models(mover.here).models[0].note == "newer"

    describe(ModelStore(mover.here, "team/model"), "a fast one")

    assert list_models(mover.here).models[0].note == "a fast one"


def test_an_upload_and_a_download_carry_notes_along(mover, mine, monkeypatch):
    write_note(mine, None, "carried")
    mover.upload()
    mover.use_as_source()

    mover.download("s3://uploads/team/model-1", "copy")

    assert texts(list_notes(mine, "copy")) == [(1, "carried")]


@pytest.mark.parametrize(
    "change",
    [
        lambda mine: write_note(mine, None, "two"),
        lambda mine: rewrite_note(mine, None, 0, "what it is"),
        lambda mine: rewrite_note(mine, None, 1, "better"),
        lambda mine: delete_note(mine, None, 1),
    ],
    ids=["add", "describe", "edit", "remove"],
)
def test_nothing_is_read_once_a_note_is_changed(mover, mine, monkeypatch, change):
    """A server that fails to read the other notes must not make a change look like a failure."""
    write_note(mine, None, "one")
    get, put, delete = mover.here.get, mover.here.put, mover.here.delete
    changed = []

    def broken(key, **options):
        if changed and "/notes/" in key:
            raise StorageError("Cannot read it: 500.", remedy="Try again.")
        return get(key, **options)

    def noted(do):
        def call(keys, *arguments, **options):
            do(keys, *arguments, **options)
            changed.append(keys)

        return call

    monkeypatch.setattr(mover.here, "get", broken)
    monkeypatch.setattr(mover.here, "put", noted(put))
    monkeypatch.setattr(mover.here, "delete", noted(delete))

    shown = change(mine)

    assert len(changed) == 1
    monkeypatch.setattr(mover.here, "get", get)
    assert shown.notes == notes_of(ModelStore(mover.here, "team/model")).notes


@pytest.mark.parametrize("damage", [b"", b"{", b'{"at": 3}', b'{"at": 1, "text": " "}', b"\xff"])
def test_a_damaged_note_is_said_and_can_be_replaced(mover, mine, damage):
    write_note(mine, None, "one")
    (key,) = [info.key for info in mover.here.list(keys.notes_folder("team/model"))]
    mover.here.put(key, damage)

    found = list_notes(mine, None)
    assert texts(found) == [(1, "(damaged)")]
    assert key in found.damaged[0]
    assert list_models(mover.here).models[0].note == ""

    assert texts(rewrite_note(mine, None, 1, "again")) == [(1, "again")]


@pytest.mark.parametrize("text", ["", "  \n", "x" * 2001, "\udcff"])
def test_what_cannot_be_a_note_is_refused(mine, text):
    with pytest.raises(SettingsError):
        write_note(mine, None, text)

    assert list_notes(mine, None).notes == []


def test_a_note_needs_a_model_and_a_number_that_is_there(mine):
    with pytest.raises(SettingsError, match="There is no model at s3://bucket/nothing"):
        write_note(mine, "nothing", "words")
    with pytest.raises(SettingsError, match="no note 3; there are: none"):
        rewrite_note(mine, None, 3, "words")


def test_a_newer_description_is_not_overwritten_when_a_training_is_resumed(mover):
    describe(ModelStore(mover.here, "team/model"), "edited")

    describe(ModelStore(mover.here, "team/model"), "of run.env", is_new=False)

    data = mover.here.get(keys.note("team/model", "000-description"))
    assert json.loads(data)["text"] == "edited"
