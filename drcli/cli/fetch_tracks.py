"""Downloads missing community tracks that a start needs."""

import time
from typing import TYPE_CHECKING

from drcli.base.errors import NoAnswer, NotYet
from drcli.cli import prompts, terminal
from drcli.run.track_fetch import fetch, missing_tracks

if TYPE_CHECKING:
    from drcli.config.settings import Settings
    from drcli.tracks.track_facts import TrackFacts

_POLL_S = 10.0


def bring_tracks(
    settings: "Settings", *, unattended: bool = False, patience_s: float = 0.0
) -> None:
    """Download missing tracks, as DR_TRACKS_FETCH says.

    `unattended`: where nobody can be asked, ask means always. A network that is not there is
    waited for up to `patience_s`.

    Raises:
        Aborted: The answer is no.
        NotYet: The network did not come.
        SettingsError: DR_TRACKS_URL is not an address, or the file there is not a track.
        StorageError: The server has no such file or cannot be reached.
    """
    names = missing_tracks(settings)
    asks = prompts.may_ask()
    allowed = settings.tracks_fetch == "always" or (unattended and not asks)
    if not names or not (allowed or asks):
        return
    until_s = time.monotonic() + patience_s
    for name in names:
        question = f"{name} is a community track that is not installed. Download it now?"
        remedy = "Set DR_TRACKS_FETCH to always or never to skip this question."
        prompts.agree(question, yes=allowed, remedy=remedy)
        facts = _fetched(settings, name, until_s if patience_s else None)
        terminal.say(f"Fetched {name}: {facts.length_m:.1f} m, {facts.waypoints} waypoints.")


def _fetched(settings: "Settings", name: str, until_s: float | None) -> "TrackFacts":
    told = False
    while True:
        try:
            return fetch(settings, name)
        except NoAnswer as error:
            if until_s is None:
                raise
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                raise NotYet(str(error), remedy=error.remedy) from error
            if not told:
                terminal.say(f"{error} Waiting for it up to {left_s / 60:.0f} minutes.")
                told = True
            time.sleep(min(_POLL_S, left_s))
