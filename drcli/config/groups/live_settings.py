"""Whether workers show what they do while somebody watches (system.env)."""

from drcli.config.fields import Group, setting


class LiveSettings(Group, title="Live view", file="system.env"):
    """What programs of the same user on this machine can see of a running worker."""

    live_view: bool = setting(
        "DR_LIVE_VIEW",
        True,
        "Show cameras and cars of running trainings and evaluations to the console of this "
        "machine.",
    )
