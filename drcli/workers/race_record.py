"""What an evaluation leaves beside its trace, so that it can be filmed later."""

from collections.abc import Sequence

import numpy as np

from drcli.config.run_config import RunConfig
from drcli.exchange.race_recording import RaceRecording, RecordedObjects
from drcli.exchange.trace import Episode
from drcli.workers.driven_episode import Driven
from drsim.race.solids import Shape

_DIGITS = 4


def recording_of_race(
    config: RunConfig,
    model: str,
    shapes: Sequence[Shape],
    driven: Sequence[Driven],
    episodes: Sequence[Episode],
) -> RaceRecording:
    race = config.race()
    objects = [poses for drive in driven for poses in drive.objects]
    rows = sum(len(drive.rows) for drive in driven)
    recorded = []
    if shapes and len(objects) == rows:
        begin = 0
        for episode in episodes:
            end = begin + len(episode.rows)
            recorded.append(RecordedObjects(episode.number, _poses(objects[begin:end])))
            begin = end
    return RaceRecording(
        world=race.world_name,
        reverse=config.evaluation.eval_reverse_direction,
        race_type=race.race_type,
        model=model,
        checkpoint="",
        racer=race.racer_name,
        color=race.car_color,
        shapes=[shape.name for shape in shapes] if recorded else [],
        episodes=recorded,
        off_track_penalty_s=config.evaluation.eval_off_track_penalty,
        collision_penalty_s=config.evaluation.eval_collision_penalty,
    )


def _poses(objects: Sequence[np.ndarray]) -> list[list[list[float]]]:
    """Only the first row if nothing moved."""
    poses = np.round(np.stack(objects), _DIGITS)
    if (poses == poses[0]).all():
        poses = poses[:1]
    rows: list[list[list[float]]] = poses.tolist()
    return rows
