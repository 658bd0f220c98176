"""The files of a training in its record, and what they say."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from drcli.base.errors import DrError
from drcli.exchange.training_record import TrainingRecord
from drcli.store import keys
from drcli.store.bucket import Bucket, ObjectMissing
from drcli.store.training_records import read_files

CURRICULUM_FILE = "curriculum.json"


def fingerprint(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def texts_of(bucket: Bucket, record: TrainingRecord) -> dict[str, str | None]:
    kept = dict(read_files(bucket, record.prefix, record.id))
    if record.derived:
        kept = {fingerprint(text): text for text in files_of(bucket, record.prefix).values()}
    return {name: kept.get(sha256) for name, sha256 in record.newest.files.items()}


def files_of(bucket: Bucket, prefix: str) -> dict[str, str]:
    places = {
        keys.REWARD_FUNCTION_FILE: keys.reward_function(prefix),
        keys.HYPERPARAMETERS_FILE: keys.hyperparameters(prefix),
        keys.MODEL_METADATA_FILE: keys.model_metadata(prefix),
        CURRICULUM_FILE: keys.curriculum(prefix),
    }
    found = {}
    for name, key in places.items():
        with suppress(ObjectMissing):
            found[name] = bucket.get(key).decode("utf-8-sig", "replace")
    return found


def described_by(texts: Mapping[str, str]) -> dict[str, Any]:
    """Damaged files determine no fields."""
    # Imported here: they load pydantic, which a list of trainings does without.
    from drcli.modelfiles.hyperparameters import Hyperparameters
    from drcli.modelfiles.model_metadata import ModelMetadata

    found: dict[str, Any] = {}
    with suppress(DrError, KeyError):
        metadata = ModelMetadata.from_bytes(texts[keys.MODEL_METADATA_FILE].encode())
        actions = metadata.action_space
        kind = metadata.action_space_type
        found |= {
            "algorithm": metadata.training_algorithm,
            "action_space": kind if actions.continuous else f"{kind}, {len(actions.values)}",
            "network": metadata.neural_network,
            "sensors": metadata.sensor,
        }
    with suppress(DrError, KeyError, ValueError):
        text = texts[keys.HYPERPARAMETERS_FILE]
        Hyperparameters.from_bytes(text.encode())
        found["hyperparameters"] = json.loads(text)
    with suppress(KeyError, ValueError, TypeError, AttributeError):
        frozen = json.loads(texts[CURRICULUM_FILE])
        found["stages"] = _count_stages(frozen["text"])
    return found


def _count_stages(text: str) -> int:
    import yaml

    with suppress(yaml.YAMLError):
        read = yaml.safe_load(text)
        stages = read.get("stages") if isinstance(read, dict) else read
        return len(stages) if isinstance(stages, list) else 1
    return 1


def of_parameter_file(bucket: Bucket, prefix: str) -> dict[str, Any]:
    """World and race of a model of another program, or our first version."""
    import yaml

    for name in ("training_params.yaml", "training_params_1.yaml"):
        with suppress(ObjectMissing, yaml.YAMLError, UnicodeDecodeError):
            read = yaml.safe_load(bucket.get(keys.parameter_file(prefix, name)).decode())
            if isinstance(read, dict) and isinstance(read.get("WORLD_NAME"), str):
                return {
                    "world": read["WORLD_NAME"],
                    "race_type": str(read.get("RACE_TYPE", "")),
                }
    return {}
