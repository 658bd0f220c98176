"""What a worker's pulse says to other programs here."""

from dataclasses import dataclass
from pathlib import Path

from drcli.base.elapsed import duration, elapsed_s
from drcli.exchange.pulse_record import PulseRecord
from drcli.runs.worker_processes import TRAINER

SILENT_S = 10.0


@dataclass(frozen=True)
class WorkerHealth:
    """How a worker is.

    Attributes:
        steps: Finished steps of driving (all cars at once) or of learning since its start.
        progress_age_s: How long ago the last of them was finished; null before the first.
        pulse_age_s: How long ago it wrote its pulse; it does so every two seconds.
        memory_mb: Memory of its process (resident set), in millions of bytes.
        open_files: Number of its open files; 0 if unknown.
    """

    steps: int
    progress_age_s: float | None
    pulse_age_s: float
    memory_mb: float
    open_files: int

    @staticmethod
    def of(folder: Path, name: str, pid: int | None) -> "WorkerHealth | None":
        """The health of a worker process; None if it has no pulse, or one of another boot."""
        pulse = PulseRecord.read(folder, name)
        now_s = elapsed_s()
        if pulse is None or pulse.pid != pid or pulse.written_s > now_s:
            return None
        worked_s = pulse.worked_s
        return WorkerHealth(
            steps=pulse.work,
            progress_age_s=None if worked_s is None else round(max(0.0, now_s - worked_s), 1),
            pulse_age_s=round(now_s - pulse.written_s, 1),
            memory_mb=round(pulse.memory_bytes / 1e6, 1),
            open_files=pulse.open_files,
        )

    def words(self, name: str) -> str:
        """Progress and memory for people."""
        unit = "gradient step" if name == TRAINER else "frame"
        age_s = self.progress_age_s
        parts = [f"no {unit} yet" if age_s is None else f"last {unit} {duration(age_s)} ago"]
        if self.pulse_age_s > SILENT_S:
            parts.append(f"silent for {duration(self.pulse_age_s)}")
        parts.append(f"{self.memory_mb:,.0f} MB")
        return ", ".join(parts)
