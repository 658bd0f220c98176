"""Community tracks that a start needs."""

from typing import TYPE_CHECKING

from drcli.base.installation import lazy_imports
from drcli.config.settings import Settings
from drcli.config.track_names import races_with_lists, to_fetch

if TYPE_CHECKING:
    from drcli.tracks.track_facts import TrackFacts

with lazy_imports():
    from drcli.checks import stage_rules
    from drcli.tracks import community


def missing_tracks(settings: Settings) -> list[str]:
    return [] if settings.tracks_fetch == "never" else tracks_to_fetch(settings)


def tracks_to_fetch(settings: Settings) -> list[str]:
    staged = stage_rules.review_stages(settings, {})
    races = [race for stage in staged.stages for race in stage.settings.races]
    return to_fetch(races_with_lists(races or settings.races))


def fetch_allowed(settings: Settings) -> "list[TrackFacts]":
    """If DR_TRACKS_FETCH is always.

    Raises:
        SettingsError: DR_TRACKS_URL is not an address, or the file there is not a track.
        StorageError: The server has no such file or cannot be reached.
    """
    if settings.tracks_fetch != "always":
        return []
    return [fetch(settings, name) for name in missing_tracks(settings)]


def fetch(settings: Settings, name: str) -> "TrackFacts":
    return community.fetch_track(name, settings.tracks_url, settings.tracks_folder)
