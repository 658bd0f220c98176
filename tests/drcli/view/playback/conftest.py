"""A player of a small model in a bucket in memory."""

import pytest

from drcli.config.run_config import ModelConfig
from drcli.view.playback.episode_player import EpisodePlayer
from drcli.view.video.video_job import Defaults
from played_model import MODEL, played_model


@pytest.fixture
def bucket():
    return played_model()


@pytest.fixture
def player(bucket, tmp_path):
    config = ModelConfig(MODEL, f"{MODEL}/metrics", "progress", 2, "", "")
    defaults = Defaults(config, tmp_path / "tracks", "reinvent_base", "Ada", "Blue")
    return EpisodePlayer(lambda: (bucket, defaults))
