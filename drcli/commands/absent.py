"""The failure of a command that was asked for something that does not run, or never ran."""

from drcli.errors import DrError


class Absent(DrError):
    """What was asked for is not there. Its exit code is the reference's, 1."""

    final = True
