"""Makes the archive for the physical car, and compares its graph with the weights."""

from typing import TYPE_CHECKING

from drcli.config.run_config import RaceConfig
from drcli.config.settings import Settings

if TYPE_CHECKING:
    from drcli.formats.graph_comparison import GraphComparison
    from drcli.models.export_car import CarExport
    from drcli.models.export_model import ExportSource


def made_car_archive(settings: Settings, source: "ExportSource", file_name: str) -> "CarExport":
    """The archive of a checkpoint, checked; nothing is written.

    Raises:
        SettingsError: The car cannot drive the model, or its graph computes something else.
    """
    from drcli.models.export_car import export_car

    return export_car(settings, source, file_name, _compare)


def _compare(race: RaceConfig, source: "ExportSource", graph: bytes) -> "GraphComparison":
    from drcli.models.export_car import FRAMES
    from drcli.workers.compare_on_drive import compare_on_drive

    return compare_on_drive(
        race, source.design, source.weights, source.chosen.name, graph, frames=FRAMES
    )
