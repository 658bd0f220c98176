"""Where the report of a model is kept, so that it is found again: by command and by console."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drcli.analysis.analysis import Analysis, AnalysisReport


def report_folder(directory: Path) -> Path:
    """The folder of all such reports in a working folder."""
    return directory / "data" / "analysis"


def report_file(directory: Path, model: str) -> Path:
    """The report of a model; a model in a folder of models has its report in such a folder, too."""
    parts = [part for part in model.split("/") if part not in ("", ".", "..")] or ["model"]
    return report_folder(directory).resolve().joinpath(*parts[:-1], f"{parts[-1]}.html")


def write_report(path: Path, analysis: "Analysis") -> "AnalysisReport":
    """Write the report of a model to its `report_file`; an older one is replaced.

    Raises:
        SettingsError: It cannot be written.
    """
    from drcli.analysis.outputs import check_targets, write_outputs

    path.parent.mkdir(parents=True, exist_ok=True)
    check_targets(path, None, force=True)
    return write_outputs(analysis, path, None)
