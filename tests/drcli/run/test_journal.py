"""What is written into the journal of a run, how often, and how it is read again."""

import json
import threading
import time

import pytest

from drcli.base.clock import wait_until
from drcli.base.errors import StorageError
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.run_record import JournalEntry
from drcli.records.training_record import RunOutcome, TrainingStart
from drcli.run import journal as journal_module
from drcli.run.journal import Journal, read_journal
from drcli.run.plan import start_entries
from memory_bucket import MemoryBucket


class CountingBucket(MemoryBucket):
    """Counts writes, and can be away."""

    def __init__(self) -> None:
        super().__init__()
        self.puts = 0
        self.away = False

    def put(self, key, data, *, watch=None):
        self.puts += 1
        if self.away:
            raise StorageError("The bucket is away.", remedy="")
        super().put(key, data, watch=watch)


@pytest.fixture
def bucket():
    return CountingBucket()


def test_urgent_events_are_written_at_once_and_others_later_together(bucket):
    journal = Journal("model", 1, "a")
    journal.note("start", "It starts.")
    journal.start(lambda: bucket)
    assert wait_until(lambda: bucket.puts == 1, patience_s=10.0)
    for number in range(50):
        journal.note("fault", f"Fault {number}.")

    journal.note("notice", "The machine goes.", seconds_left=120)
    assert wait_until(lambda: bucket.puts == 2, patience_s=10.0)
    journal.finish(5.0)

    assert bucket.puts == 2  # nothing was new at the end
    texts = [event.text for event in read_journal(ModelStore(bucket, "model")).events]
    assert len(texts) == 52
    assert texts[-1] == "The machine goes."


def test_the_end_writes_what_is_left(bucket):
    journal = Journal("model", 1, "a")
    journal.start(lambda: bucket)
    journal.note("fault", "A worker died.", worker="sim-0")

    journal.finish(5.0)

    (event,) = read_journal(ModelStore(bucket, "model")).events
    assert (event.session, event.kind, event.facts) == ("a", "fault", {"worker": "sim-0"})


def test_a_bucket_that_hangs_holds_up_nobody(monkeypatch):
    released = threading.Event()

    class Hanging(MemoryBucket):
        def put(self, key, data, *, watch=None):
            released.wait(30.0)

    journal = Journal("model", 1, "a")
    journal.start(Hanging)
    began_s = time.monotonic()
    journal.note("notice", "It goes.")
    journal.finish(0.1)

    assert time.monotonic() - began_s < 5.0
    released.set()


def test_what_could_not_be_written_is_written_with_the_next_events(bucket, monkeypatch):
    monkeypatch.setattr(journal_module, "WRITE_S", 0.02)
    bucket.away = True
    journal = Journal("model", 1, "a", (JournalEntry(1.0, "start", "It starts."),))
    journal.start(lambda: bucket)
    assert wait_until(lambda: bucket.puts >= 2, patience_s=10.0)
    bucket.away = False
    journal.finish(5.0)

    assert [event.text for event in read_journal(ModelStore(bucket, "model")).events] == [
        "It starts."
    ]


def test_a_year_of_events_stays_small(bucket):
    journal = Journal("model", 1, "a")
    for number in range(5000):
        journal.note("upload", f"Upload {number}.")
    journal.write(bucket)

    events = read_journal(ModelStore(bucket, "model")).events
    assert len(events) == journal_module.MOST_KEPT + 1
    assert events[0].text == "Upload 0."
    assert events[-1].text == "Upload 4999."
    assert events[journal_module.FIRST_KEPT].text == "Events that are not kept: 3000."


def test_secrets_in_addresses_are_hidden(bucket):
    journal = Journal("model", 1, "a")
    journal.note("fault", "No answer from https://me:canary@s3.example.com/x?sig=canary2 (503).")
    journal.write(bucket)

    text = bucket.get(keys.journal("model", 1, "a")).decode()
    assert "canary" not in text
    assert "s3.example.com" in text


def test_facts_that_json_does_not_know_cost_only_themselves(bucket):
    journal = Journal("model", 1, "a")
    journal.note("fault", "Odd.", value=object())
    journal.note("fault", "NaN.", value=float("nan"))
    journal.write(bucket)

    assert [event.facts for event in read_journal(ModelStore(bucket, "model")).events] == [{}, {}]


def test_the_starts_are_in_their_order_whatever_their_clocks_say(bucket):
    for term, session, at in ((2, "b", 5.0), (10, "c", 1.0), (1, "a", 9.0)):
        entry = JournalEntry(at, "start", session)
        bucket.put(keys.journal("model", term, session), entry.encode_line())
    bucket.put(keys.journal("model-1", 1, "other"), JournalEntry(1.0, "start", "x").encode_line())

    assert [event.text for event in read_journal(ModelStore(bucket, "model")).events] == [
        "a",
        "b",
        "c",
    ]


@pytest.mark.parametrize(
    "damage", [b'{"at": 1.0, "kind": "st', b"\x00\xff\xfe", b"[]", b'{"at": "x"}', b"null"]
)
def test_damaged_lines_are_counted_and_left_out(bucket, damage):
    good = JournalEntry(1.0, "start", "Good.\u2028 One line.").encode_line()
    bucket.put(keys.journal("model", 1, "a"), good + damage + b"\n" + good + b"\n")

    report = read_journal(ModelStore(bucket, "model"))

    assert [event.text for event in report.events] == ["Good.\u2028 One line."] * 2
    assert report.damaged == ["bucket/model/journal/000001-a.jsonl: 1 line cannot be read."]


def test_other_objects_in_its_folder_are_none_of_ours(bucket):
    bucket.put("model/journal/readme.txt", b"x")

    assert read_journal(ModelStore(bucket, "model")).damaged == []


def start(**changes):
    values = {
        "seed": 1,
        "settings": {"DR_WORKERS": 1},
        "versions": {"drcli": "1"},
        "machine": {"cores": 2, "processor": "a processor"},
    }
    return TrainingStart(**{**values, **changes})


def test_a_start_notes_what_has_changed_since_the_one_before():
    before = start(settings={"DR_WORKERS": 1, "DR_WORLD_NAME": "oval"})
    now = start(versions={"drcli": "2"}, settings={"DR_WORKERS": 2}, earlier=[before])

    (entry,) = start_entries(now, "3_Step-9.ckpt", None, [])

    assert entry.facts["settings_changed"] == {
        "DR_WORKERS": [1, 2],
        "DR_WORLD_NAME": ["oval", None],
    }
    assert entry.facts["versions_changed"] == {"drcli": ["1", "2"]}
    assert "resumes from 3_Step-9.ckpt" in entry.text
    assert "DR_WORKERS 1 -> 2, DR_WORLD_NAME oval -> (not set)" in entry.text
    json.dumps(entry.to_json())


def test_a_start_after_one_that_vanished_took_over_and_repairs_are_noted():
    vanished = RunOutcome("s", "elsewhere", 1.0, 2.0)

    entries = start_entries(start(), None, vanished, ["It was repaired."])

    assert [entry.kind for entry in entries] == ["start", "recovery", "recovery"]
    assert "The start on elsewhere ended without recording why" in entries[1].text
