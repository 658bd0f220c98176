"""Notes the next stage or phase in the journal."""

from drcli.exchange.job import Job
from drcli.exchange.stage_note import StageNote
from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.journal import Journal
from drcli.runs.outcome import Ending, Outcome


class StageWatch(Duty):
    name = "stages"

    def __init__(self, job: Job) -> None:
        self._job = job
        self._journal: Journal | None = None
        self._seen = ""

    def start(self, run: RunningTraining) -> None:
        self._journal = run.journal

    def check(self) -> Outcome | None:
        self._look()
        return None

    def finish(self, ending: Ending) -> None:
        self._look()

    def _look(self) -> None:
        if self._journal is None:
            return
        note = StageNote.read(self._job.folder, self._job.session)
        if note is None or note.checkpoint == self._seen:
            return
        self._seen = note.checkpoint
        self._journal.note("stage", note.text, stage=note.stage, checkpoint=note.checkpoint)
