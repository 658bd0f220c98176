"""The race that `dr-start-tournament` means without a name."""

from drcli.base.errors import SettingsError
from drcli.races.organise import list_races
from drcli.store.bucket import Bucket


def only_tournament(bucket: Bucket) -> str:
    """Raises SettingsError for no or several unfinished races in pairs."""
    found = [
        entry.race
        for entry in list_races(bucket).races
        if entry.race_type == "HEAD_TO_MODEL" and entry.state != "finished"
    ]
    if len(found) == 1:
        return found[0]
    if found:
        raise SettingsError(
            f"s3://{bucket.name} has several races in pairs: {', '.join(found)}.",
            remedy=f"Name one of them, as in `dr-start-tournament {found[0]}`.",
        )
    raise SettingsError(
        f"s3://{bucket.name} has no race in pairs that is not finished.",
        remedy="Make one with `dr-race create NAME --type HEAD_TO_MODEL`, and submit models with "
        "`dr-race submit`.",
    )
