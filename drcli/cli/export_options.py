"""Options that the exports of a checkpoint share."""

from typing import TYPE_CHECKING, Annotated

from drcli.cli.options import best_option, checkpoint_choice, checkpoint_option, prefix_option

if TYPE_CHECKING:
    from drcli.models.export_model import Selection

ExportBest = Annotated[bool, best_option("Export")]
ExportNumber = Annotated[str | None, checkpoint_option("Export")]
ExportPrefix = Annotated[str | None, prefix_option("Export this model instead.")]


def selection(best: bool, number: str | None, prefix: str | None) -> "Selection":
    """The checkpoint that the options choose.

    Raises:
        BadParameter: -b and -c are both given, or -c names none.
    """
    from drcli.models.export_model import Selection

    return Selection(checkpoint_choice(best, number, "best"), prefix)
