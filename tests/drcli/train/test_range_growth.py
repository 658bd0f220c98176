"""The ranges of training episodes grow while laps stay clean."""

from typing import Any

import pytest

from drcli.base.json_record import Fingerprint, RecordError
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointRecord, Counters
from drcli.records.iteration import IterationRecord
from drcli.records.stage import RangesMark, StageNote
from drcli.train import range_growth
from drcli.train.range_growth import next_ranges
from drsim.car.conditions import Conditions
from drsim.episode.simulation import Simulation
from iterations import iteration_record
from training_in_memory import PREFIX, TrainingInMemory


def driven(
    iteration: int = 4,
    *,
    training: int = 0,
    clean: int | None = 0,
    held_out: int | None = None,
    **changes: Any,
) -> IterationRecord:
    """An iteration with so many clean laps of 10; None: not driven."""
    if clean is not None:
        changes |= {"evaluation_progress": [50.0] * 10, "evaluation_lap_s": [9.0] * clean}
    if held_out is not None:
        changes |= {"second_progress": [50.0] * 10, "second_lap_s": [9.0] * held_out}
        changes["second_world"] = "oval"
    return iteration_record(iteration, episodes=10, full_laps=training, **changes)


def share_after(share: float, *records: IterationRecord) -> float:
    """Of ranges that have held since checkpoint 4."""
    found = next_ranges(RangesMark(share, 4), records)
    return share if found is None else found[0].share


@pytest.mark.parametrize(
    ("before", "clean", "after"),
    [
        (0.25, 8, 0.5),
        (0.25, 7, 0.25),
        (0.75, 10, 1.0),
        (1.0, 10, 1.0),
        (0.75, 5, 0.75),
        (0.75, 4, 0.5),
        (0.25, 0, 0.25),
    ],
)
def test_they_grow_hold_and_shrink_with_the_clean_laps_of_an_evaluation(before, clean, after):
    assert share_after(before, driven(clean=clean)) == after


def test_laps_on_tracks_never_trained_count_instead_of_those_on_the_own_one():
    assert share_after(0.5, driven(clean=10, held_out=7)) == 0.5
    assert share_after(0.5, driven(clean=0, held_out=8)) == 0.75
    assert share_after(0.5, driven(clean=10, held_out=4)) == 0.25


def test_clean_laps_of_training_count_too_because_evaluations_have_the_full_ranges():
    assert share_after(0.5, driven(training=8, clean=3)) == 0.75
    assert share_after(0.5, driven(training=6, clean=3)) == 0.5


def test_nothing_changes_before_an_evaluation_with_the_present_ranges_has_arrived():
    assert share_after(0.25) == 0.25
    assert share_after(0.25, driven(training=10, clean=None)) == 0.25
    assert share_after(0.25, driven(3, clean=10)) == 0.25
    ahead = driven(4, clean=10, checkpoint="3_Step-300.ckpt")
    assert share_after(0.25, ahead) == 0.25, "its episodes were driven ahead, with other ranges"


def test_a_later_iteration_may_bring_the_evaluation_of_an_earlier_one():
    found = next_ranges(RangesMark(0.25, 4), [driven(4, clean=8), driven(5, clean=None)])

    assert found is not None
    assert found[0] == RangesMark(0.5, 6)


def test_a_teacher_is_judged_by_its_training_laps():
    assert share_after(0.25, driven(training=8, clean=None, phase="teacher")) == 0.5
    assert share_after(0.25, driven(training=7, clean=None, phase="teacher")) == 0.25


def test_the_sentence_names_laps_and_shares():
    grown = next_ranges(RangesMark(0.25, 4), [driven(held_out=9)])
    shrunk = next_ranges(RangesMark(1.0, 4), [driven(training=4, clean=3)])

    assert grown is not None
    assert shrunk is not None
    assert grown[1] == (
        "9 of 10 laps on oval were clean: the ranges of DR_SIM_ settings grow from 25% to 50%."
    )
    assert shrunk[1].startswith("4 of 10 training laps were clean: the ranges of DR_SIM_ settings")
    assert shrunk[1].endswith("shrink from 100% to 75%.")


@pytest.fixture
def drawn(monkeypatch):
    """What resets of simulations were given."""
    seen: list[list[Conditions] | None] = []
    reset = Simulation.reset

    def watched(self: Simulation, *args: Any, **options: Any) -> Any:
        seen.append(options["conditions"])
        return reset(self, *args, **options)

    monkeypatch.setattr(Simulation, "reset", watched)
    return seen


def test_the_ranges_of_a_training_grow_and_a_restart_goes_on_with_them(
    working_folder, monkeypatch, drawn
):
    training = TrainingInMemory(
        working_folder,
        monkeypatch,
        DR_SIM_GROW=True,
        DR_SIM_BRIGHTNESS=0.4,
        DR_TRAIN_EVAL_SHARE=1,
        DR_TRAIN_MAX_ITERATIONS=4,
    )
    monkeypatch.setattr(range_growth, "CLEAN", 0.0)
    notes = []
    monkeypatch.setattr(StageNote, "write", lambda note, folder: notes.append(note.text))
    checkpoints = CheckpointStore(ModelStore(training.bucket, PREFIX))

    training.train()

    grown = checkpoints.counters_of_newest().ranges
    assert grown is not None
    assert grown.share > 0.25
    assert drawn[0] is not None
    training_episodes = [abs(each.brightness - 1.0) for each in drawn[0][:2]]
    assert max(training_episodes) <= 0.1
    assert any("grow from 25% to 50%" in text for text in notes), "the journal gets it"
    monkeypatch.setattr(range_growth, "CLEAN", 2.0)  # from now on, they hold
    monkeypatch.setattr(range_growth, "LOST", 0.0)
    lines = (training.folder / "run.env").read_text()
    training.write("run.env", lines.replace("ITERATIONS=4", "ITERATIONS=5"))

    training.train(resume=True)

    assert checkpoints.counters_of_newest().ranges == grown


@pytest.mark.parametrize("share", [0.0, 1.5])
def test_a_share_that_cannot_be_is_a_damaged_record(share):
    nothing = Fingerprint.of(b"")
    counters = Counters(ranges=RangesMark(share, 4))

    with pytest.raises(RecordError, match="share"):
        CheckpointRecord.decode(
            CheckpointRecord("4_Step-9.ckpt", nothing, counters=counters).encode()
        )
