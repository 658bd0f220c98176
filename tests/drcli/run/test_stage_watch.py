"""The journal tells when a stage has begun, once."""

from dataclasses import replace

from drcli.records.stage import Stage, StageGoal, StageNote
from drcli.run.watches import StageWatch
from memory_bucket import MemoryBucket
from unwatched import ending, job_of, running


def noted(folder, job, *notes: StageNote) -> list[str]:
    run = running(job, MemoryBucket())
    told: list[str] = []
    run.journal.listen(lambda entry: told.append(f"{entry.kind}: {entry.text}"))
    watch = StageWatch(run)
    job.folder.mkdir(parents=True, exist_ok=True)
    for note in notes:
        note.write(job.folder)
        watch.check()
        watch.check()
    watch.finish(ending())
    return told


def test_each_stage_is_told_once(tmp_path):
    job = job_of(tmp_path)
    stages = tuple(Stage(n, job.config.races, "", "", "{}", StageGoal()) for n in ("a", "b"))
    job = replace(job, stages=stages)
    first = StageNote(job.session, "a", "2_Step-9.ckpt", "Stage 1 is over.")
    second = StageNote(job.session, "b", "4_Step-9.ckpt", "Stage 2 is over.")

    assert noted(tmp_path, job, first, second) == [
        "stage: Stage 1 is over.",
        "stage: Stage 2 is over.",
    ]
    assert noted(tmp_path, job, replace(first, session="an earlier start")) == []


def test_the_phases_of_a_training_with_a_teacher_are_told_alike(tmp_path):
    job = job_of(tmp_path)
    note = StageNote(job.session, "distillation", "9_Step-99.ckpt", "The phase teacher is over.")

    assert noted(tmp_path, job, note) == ["stage: The phase teacher is over."]
