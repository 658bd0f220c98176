"""Takes a model of the racer's bucket for DeepRacer on AWS."""

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.config.checkpoint_words import CheckpointChoice
from drcli.config.settings import Settings
from drcli.exchange.scores import encode_single
from drcli.modelfiles.droa_params import (
    CLOCKWISE,
    COUNTER_CLOCKWISE,
    DROA_TRACKS,
    Direction,
    droa_parameters,
    read_parameters,
    split_world,
)
from drcli.modelfiles.params_yaml import training_parameters
from drcli.models.checkpoint_choice import find_choice, sentence_about
from drcli.models.checkpoint_files import (
    PARAMETERS_FILE,
    read_checkpoint,
    read_model_files,
    refuse_incomplete,
)
from drcli.models.export_droa import package_files, read_droa_export
from drcli.models.export_model import Selection
from drcli.models.transfer_buckets import bucket_to_look_at
from drcli.remote.droa_package import Files
from drcli.remote.droa_rules import INDEX, POINTER
from drcli.store import keys
from drcli.store.repair import Model
from drcli.tracks.track_list import list_tracks


def read_bucket_model(settings: Settings, prefix: str, choice: CheckpointChoice) -> Files:
    """A model's files with a TensorFlow checkpoint, its own or as of `dr-export droa`.

    Raises:
        SettingsError: There is none, or it cannot be imported there.
        StorageError: The bucket cannot be read.
    """
    bucket = bucket_to_look_at(settings.transfer, upload=False)
    refuse_incomplete(settings.model, bucket, prefix)
    chosen = find_choice(Model.of(settings.model, bucket, prefix), choice)
    if not set(keys.TENSORFLOW_PARTS) <= set(chosen.parts):
        exported = read_droa_export(settings, Selection(choice, prefix), world=None)
        for note in exported.notes:
            notices.show(note)
        return package_files(exported)
    notices.show(sentence_about(Model.of(settings.model, bucket, prefix), chosen))
    items = [
        *read_checkpoint(bucket, prefix, chosen),
        *read_model_files(
            settings.model,
            bucket,
            prefix,
            chosen.name,
            (bucket.name, prefix),
            training_parameters(settings),
        ),
    ]
    files = {item.name: item.data for item in items if not item.name.endswith(".safetensors")}
    files[POINTER] = chosen.name.encode()
    files[INDEX] = encode_single(chosen.score)
    files[PARAMETERS_FILE] = _parameters(settings, files[PARAMETERS_FILE], prefix)
    metrics = files.pop("metrics/TrainingMetrics.json", None)
    if metrics:
        files[f"metrics/training/training-{chosen.number}.json"] = metrics
    return files


def _parameters(settings: Settings, data: bytes, prefix: str) -> bytes:
    try:
        return droa_parameters(data, _route(settings, data))
    except ValueError as e:
        raise SettingsError(
            f"{PARAMETERS_FILE} of {prefix} cannot be used: {e}.",
            remedy="Add TRACK_DIRECTION_CLOCKWISE: true or false to it, in a folder that you "
            "import with --from.",
        ) from e


def _route(settings: Settings, data: bytes) -> Direction | None:
    world = str(read_parameters(data).get("WORLD_NAME", ""))
    track, named = split_world(world)
    if named is not None or len(DROA_TRACKS.get(track, ())) == 1:
        return None  # measuring all tracks takes two seconds
    memory = settings.directory / "data" / "cache" / "tracks.json"
    known = {"clockwise": CLOCKWISE, "counterclockwise": COUNTER_CLOCKWISE}
    for facts in list_tracks(settings.tracks_folder, memory).tracks:
        if facts.name == world:
            return known.get(facts.direction)
    return None
