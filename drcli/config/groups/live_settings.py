"""Whether workers show what they do."""

from drcli.config.fields import Group, setting


class LiveSettings(Group, title="Live view", file="system.env"):
    live_view: bool = setting(
        "DR_LIVE_VIEW",
        True,
        "Show cameras and cars of running trainings and evaluations to the console of this "
        "machine.",
    )
