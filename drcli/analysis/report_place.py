"""Where the report of a model is kept."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drcli.analysis.analysis import Analysis, AnalysisReport


def report_folder(directory: Path) -> Path:
    return directory / "data" / "analysis"


def report_file(directory: Path, model: str) -> Path:
    """A model in a folder has its report in such a folder."""
    parts = [part for part in model.split("/") if part not in ("", ".", "..")] or ["model"]
    return report_folder(directory).resolve().joinpath(*parts[:-1], f"{parts[-1]}.html")


def write_report(path: Path, analysis: "Analysis") -> "AnalysisReport":
    """Write or replace the `report_file` of a model.

    Raises:
        SettingsError: It cannot be written.
    """
    from drcli.analysis.outputs import check_targets, write_outputs

    path.parent.mkdir(parents=True, exist_ok=True)
    check_targets(path, None, force=True)
    return write_outputs(analysis, path, None)
