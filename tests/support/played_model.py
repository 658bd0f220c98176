"""A small model that has driven, in a bucket, as the episode player finds it."""

from pathlib import Path

from drcli.model import keys
from drcli.records.evaluation_task import RaceRecording
from drsim.track.worlds import load_track
from memory_bucket import MemoryBucket
from recorded_drives import trace_csv, trace_rows
from small_model import put_small_model

TRACK = load_track("reinvent_base")
MODEL = "team/m"
EVALUATION = "evaluation-20260102030405/evaluation-simtrace/0-iteration.csv"
TRAINING = "1/training-simtrace/3-iteration.csv"
GONE = "0/training-simtrace/2-iteration.csv"


def played_model() -> MemoryBucket:
    """A model with checkpoints 3 and 5, an evaluation of 3, and traces of two iterations."""
    bucket = MemoryBucket()
    put_small_model(bucket, MODEL, numbers=(3, 5))
    reward = b"def reward_function(params):\n    return params['speed'] + params[\"progress\"]\n"
    bucket.put(keys.reward_function(MODEL), reward)
    race = b"WORLD_NAME: reinvent_base\nRACE_TYPE: TIME_TRIAL\n"
    bucket.put(keys.parameter_file(MODEL, "training_params.yaml"), race)
    evaluated = trace_csv(
        trace_rows(TRACK, rows=12, speed_mps=1.0, status="off_track"),
        trace_rows(TRACK, episode=1, rows=40, speed_mps=2.0, status="off_track", clock_s=900.0),
        trace_rows(TRACK, episode=2, rows=20, speed_mps=1.5, status="crashed", clock_s=1000.0),
    )
    bucket.put(f"{MODEL}/{EVALUATION}", evaluated)
    recording = RaceRecording(
        "reinvent_base", False, "TIME_TRIAL", MODEL, "3_Step-300.ckpt", "Ada", "Blue"
    )
    bucket.put(keys.recording_of(f"{MODEL}/{EVALUATION}"), recording.encode())
    for name in (TRAINING, GONE):
        bucket.put(f"{MODEL}/{name}", trace_csv(trace_rows(TRACK, rows=30)))
    return bucket


def working_folder(folder: Path) -> Path:
    """A working folder whose local bucket has the model; no server runs."""
    (folder / "run.env").write_text(f"DR_LOCAL_S3_MODEL_PREFIX={MODEL}\n")
    (folder / "system.env").write_text("")
    bucket = played_model()
    for info in bucket.list(""):
        path = folder / "data" / "s3" / "bucket" / info.key
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bucket.get(info.key))
    return folder
