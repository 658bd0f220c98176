"""Downloads missing community tracks that a start needs."""

from typing import TYPE_CHECKING

from drcli.cli import prompts, terminal
from drcli.run.track_fetch import fetch, missing_tracks

if TYPE_CHECKING:
    from drcli.config.settings import Settings


def bring_tracks(settings: "Settings") -> None:
    """Download missing tracks, as DR_TRACKS_FETCH says.

    Raises:
        Aborted: The answer is no.
        SettingsError: DR_TRACKS_URL is not an address, or the file there is not a track.
        StorageError: The server has no such file or cannot be reached.
    """
    names = missing_tracks(settings)
    allowed = settings.tracks_fetch == "always"
    if not names or (not allowed and not prompts.may_ask()):
        return
    for name in names:
        question = f"{name} is a community track that is not installed. Download it now?"
        remedy = "Set DR_TRACKS_FETCH to always or never to skip this question."
        prompts.agree(question, yes=allowed, remedy=remedy)
        facts = fetch(settings, name)
        terminal.say(f"Fetched {name}: {facts.length_m:.1f} m, {facts.waypoints} waypoints.")
