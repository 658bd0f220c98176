"""The player's process: `python -m drcli.view.playback.player_process FOLDER`.

Requests are lines of JSON on its input, until that ends; an answer is eight bytes of length
(big endian) and a packed answer.
"""

import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.base.system_calls import limit_data
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket, open_running_bucket
from drcli.config.loading import load_settings
from drcli.view.playback.episode_player import EpisodePlayer
from drcli.view.playback.player_handle import pack
from drcli.view.video.video_job import Defaults

LENGTH_BYTES = 8

MOST_BYTES = 4 << 30
"""Data limit: torch takes about 1 GB, mostly untouched."""

_NICE = 5
"""A training goes first."""

_PATIENCE_S = 5.0

_logger = get_logger(__name__)


def main() -> None:
    directory = Path(sys.argv[1])
    # What a library prints must not be taken for an answer.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    limit_data(MOST_BYTES)
    with suppress(OSError):
        os.nice(_NICE)

    def connect() -> tuple[Bucket, Defaults]:
        settings = load_settings(directory)
        bucket = open_running_bucket(settings.storage)
        if bucket is None:
            bucket = open_bucket(settings.storage, patience_s=_PATIENCE_S)
        return bucket, Defaults.of(settings.model, settings.run.race())

    serve(EpisodePlayer(connect), sys.stdin.buffer, answers)


def serve(player: EpisodePlayer, requests: BinaryIO, answers: BinaryIO) -> None:
    for line in requests:
        data = answer_of(player, json.loads(line))
        with suppress(BrokenPipeError):
            answers.write(len(data).to_bytes(LENGTH_BYTES, "big") + data)
            answers.flush()


def answer_of(player: EpisodePlayer, request: dict[str, Any]) -> bytes:
    try:
        return player.answer(request)
    except DrError as error:
        return pack({"error": {"message": str(error), "remedy": error.remedy, "code": error.code}})
    except MemoryError:
        message = "The episode takes more memory than the player may have."
        remedy = "Choose a shorter episode, or a smaller trace."
        return pack({"error": {"message": message, "remedy": remedy, "code": 3}})
    except Exception as error:
        _logger.exception("Unexpected error")
        message = f"The player cannot show this because of a fault in the program ({error!r:.200})."
        remedy = "Choose another episode. The details are in data/logs/viewer.log."
        return pack({"error": {"message": message, "remedy": remedy, "code": 1}})


if __name__ == "__main__":
    main()
