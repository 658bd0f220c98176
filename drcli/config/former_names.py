"""Names that templates and scripts of the reference used to have, and that do nothing here.

Folders of earlier years hold them, and so do shells in which an earlier version was activated.
They are not settings, so their values are not read; names that mean a setting of today are its
`old_names`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from drcli.config.groups.system import DERIVED, DOCKER, WINDOW

_VIEWER = "the viewer is not available in this version"
_TOURNAMENT = "races against another model are evaluations (DR_RACE_TYPE=HEAD_TO_MODEL)"
_IMPORT = "models are not imported into the console"
_CUT_OFF = "the name is cut off; write {}"


@dataclass(frozen=True)
class Former:
    """What is known about one of the names.

    Attributes:
        meaning: One line.
        reason: Why it does nothing here, without a full stop.
        harmless: The values, in small letters, with which nobody expects an effect; None where
            that is so for every value.
    """

    meaning: str
    reason: str
    harmless: tuple[str, ...] | None = None

    def missed(self, value: str) -> bool:
        """Whether somebody who wrote that value expects an effect."""
        return self.harmless is not None and value.strip().casefold() not in self.harmless


FORMER: Mapping[str, Former] = {
    "DR_COACH_IMAGE": Former("Version of an image.", DOCKER),
    "DR_ROBOMAKER_IMAGE_TYPE": Former("Kind of an image.", DOCKER),
    "DR_GPU_AVAILABLE": Former("Whether containers get the GPU.", DOCKER),
    "DR_DOCKER_FILE_SEP": Former("Word between files of containers.", DOCKER),
    "DR_DOCKER_MAJOR_VERSION": Former("Version of docker.", DOCKER),
    "DR_COMPOSE_FILE": Former("Files of containers.", DOCKER),
    "DR_COMPOSE_FILES": Former("Files of containers.", DOCKER),
    "DR_TRAIN_COMPOSE_FILE": Former("Files of containers.", DOCKER),
    "DR_EVAL_COMPOSE_FILE": Former("Files of containers.", DOCKER),
    "DR_MINIO_COMPOSE_FILE": Former("Files of containers.", DOCKER),
    "DR_MOUNT_DIR": Former("Folder that a container sees.", DOCKER),
    "DR_ROBOMAKER_PORT": Former("Port of the picture.", DERIVED),
    "DR_LOCAL_ENDPOINT_URL": Former("Address of the bucket.", DERIVED),
    "DR_LOCAL_ACCESS_KEY_ID": Former(
        "Key of the bucket.", "keys come from the profile DR_LOCAL_S3_PROFILE"
    ),
    "DR_LOCAL_SECRET_ACCESS_KEY": Former(
        "Secret of the bucket.", "keys come from the profile DR_LOCAL_S3_PROFILE"
    ),
    "DR_UPLOAD_PROFILE": Former("Option of the AWS command.", DERIVED),
    "DR_UPLOAD_S3_ROLE": Former("Role of the console that imports a model.", _IMPORT),
    "DR_UPLOAD_MODEL_NAME": Former("Name of the model in the console.", _IMPORT),
    "DR_USE_GUI": Former("Show the simulator.", WINDOW),
    "DR_NGINX_CONF": Former("Configuration of the viewer.", _VIEWER),
    "DR_VIEWER_HTML": Former("Page of the viewer.", _VIEWER),
    "DR_LOCAL_S3_METRICS_KEY": Former(
        "Object with the metrics.",
        "metrics have the names that analysis tools look for, in DR_LOCAL_S3_METRICS_PREFIX",
    ),
    "DR_LOCAL_S3_TOURNAMENT_JSON_FILE": Former("Participants of a tournament.", _TOURNAMENT),
    "DR_LOCAL_S3_TOURNAMENT_PARAMS_FILE": Former("Description of a tournament.", _TOURNAMENT),
    "DR_NUMBER_OF_EPISODES": Former(
        "Episodes of a training.",
        "DR_TRAIN_MAX_ITERATIONS and term_cond_max_episodes end a training",
        harmless=("", "0"),
    ),
    "DR_TARGET_REWARD_SCORE": Former(
        "Reward that ends a training.",
        "DR_TRAIN_STOP_REWARD ends a training by its reward",
        harmless=("", "none"),
    ),
    "DR_EVAL_ENABLE_RESETS": Former(
        "Put a car back that left the track.",
        "DR_EVAL_MAX_RESETS says how often a car is put back",
    ),
    "DR_OA_PSEUDO_RANDOMIZE_OBSTACLE_LOCATIONS": Former(
        "Draw from a few arrangements of obstacles.",
        "DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS moves them in each episode, DR_OA_OBJECT_POSITIONS "
        "fixes them",
        harmless=("", "false"),
    ),
    "DR_OA_NUMBER_OF_PSEUDO_RANDOM_PLACEMENTS": Former(
        "How many arrangements.", "obstacles are not drawn from a few arrangements"
    ),
    # These two are in a script of the reference, cut off like this.
    "DR_TRAIN_ALTERNATE_DRIVI": Former(
        "Turn round after every training episode.",
        _CUT_OFF.format("DR_TRAIN_ALTERNATE_DRIVING_DIRECTION"),
        harmless=("", "false"),
    ),
    "DR_TRAIN_ROUND_ROBIN_ADVANC": Former(
        "Distance from one start to the next.",
        _CUT_OFF.format("DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST"),
        harmless=("", "0.05"),
    ),
}
"""By name."""
