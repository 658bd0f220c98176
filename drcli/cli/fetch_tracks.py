"""Downloads community tracks that a start needs and that are missing."""

from typing import TYPE_CHECKING

from drcli.cli import console, prompts

if TYPE_CHECKING:
    from drcli.config.settings import RaceConfig, Settings


def bring_tracks(settings: "Settings") -> None:
    """Download missing tracks, as DR_TRACKS_FETCH says: always, or after asking.

    Tracks that stay missing are reported later, with all other problems.

    Raises:
        Aborted: The answer is no.
        SettingsError: DR_TRACKS_URL is not an address, or the file there is not a track.
        StorageError: The server has no such file or cannot be reached.
    """
    from drcli.config.track_names import to_fetch

    names = to_fetch(_races(settings))
    if not names or settings.tracks_fetch == "never":
        return
    allowed = settings.tracks_fetch == "always"
    if not allowed and not prompts.may_ask():
        return
    from drcli.tracks.community import fetch_track

    for name in names:
        question = f"{name} is a community track that is not installed. Download it now?"
        remedy = "Set DR_TRACKS_FETCH to always or never to skip this question."
        prompts.agree(question, yes=allowed, remedy=remedy)
        facts = fetch_track(name, settings.tracks_url, settings.tracks_folder)
        console.say(f"Fetched {name}: {facts.length_m:.1f} m, {facts.waypoints} waypoints.")


def _races(settings: "Settings") -> "list[RaceConfig]":
    """Every race of a training: of its stages, and on its second track."""
    from drcli.checks.stage_rules import review_stages

    staged = review_stages(settings, {})
    run = settings.run
    races = [race for stage in staged.stages for race in stage.settings.races]
    second = run.second_race(run.race())
    return [*(races or settings.races), *([second] if second is not None else ())]
