"""Reads a checkpoint in the bucket; one of the reference is converted in memory."""

import re

from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.base.json_record import Fingerprint
from drcli.convert.policy_file import PolicyFile
from drcli.model import keys
from drcli.model.checkpoints import Checkpoint, CheckpointStore
from drcli.model.files.network_shape import Design
from drcli.model.model_prefix import is_tensorflow
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import checkpoint_name

with lazy_imports():
    from drcli.convert import imported_policy

_DATA = re.compile(r"\.data-\d{5}-of-\d{5}")


def load_checkpoint(model: ModelStore, name: str) -> Checkpoint:
    """Read and check a checkpoint.

    Raises:
        ObjectMissing: A file is missing.
        ObjectDamaged: A file is not what was written.
        SettingsError: It is damaged, or cannot be trained here.
        ProblemsError: A parameter file is wrong.
    """
    listed = [info.key for info in model.bucket.list(keys.model_folder(model.prefix))]
    if not is_tensorflow(listed, model.prefix, name):
        return CheckpointStore(model).load(name)

    design = Design.of_model(model)
    if design.metadata.training_algorithm == "sac":
        raise SettingsError(
            f"{name} of {model.url} is a SAC model of the reference simulator, "
            "whose policy has other layers than ours: only its frozen graph can be used.",
            remedy=f"Drive it with `DR_LOCAL_S3_MODEL_PREFIX={model.prefix} dr-evaluate`.",
        )
    start = keys.checkpoint_part(model.prefix, name, "")
    data = sorted(
        key for key in listed if key.startswith(start) and _DATA.fullmatch(key, len(start))
    )
    index = model.bucket.get(keys.checkpoint_part(model.prefix, name, ".index"))
    origin = f"{model.bucket.name}/{start}"
    policy = imported_policy.read_bundle_policy(
        index, [model.bucket.get(key) for key in data], origin
    )
    described = design.files[keys.MODEL_METADATA_FILE]
    fitted = imported_policy.fit_metadata(described, design.metadata_origin, policy, origin)
    parameters, _ = imported_policy.fit_parameters(
        design.parameters, design.parameters_origin, policy, origin
    )
    first = imported_policy.first_checkpoint(policy, fitted.metadata, parameters)
    record = imported_policy.first_record(name, first, fitted, parameters)
    return Checkpoint(record, first.tensors)


def driving_graph(model: ModelStore, name: str) -> PolicyFile | None:
    """The graph that drives for a TensorFlow checkpoint of SAC, else None.

    Raises:
        ObjectMissing: That has no graph.
    """
    listed = [info.key for info in model.bucket.list(keys.model_folder(model.prefix))]
    if not is_tensorflow(listed, model.prefix, name):
        return None
    design = Design.of_model(model)
    if design.metadata.training_algorithm != "sac":
        return None
    key = keys.checkpoint_graph(model.prefix, checkpoint_name(name).number)
    data = model.bucket.get(key)
    return PolicyFile(
        "pb",
        data,
        b"",
        f"{model.bucket.name}/{key}",
        design.metadata,
        design.metadata_origin,
        Fingerprint.of(data).sha256,
    )
