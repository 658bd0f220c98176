"""Where the report of a model is kept, so that it is found again: by command and by console."""

from pathlib import Path


def report_folder(directory: Path) -> Path:
    """The folder of all such reports in a working folder."""
    return directory / "data" / "analysis"


def report_file(directory: Path, model: str) -> Path:
    """The report of a model; a model in a folder of models has its report in such a folder, too."""
    parts = [part for part in model.split("/") if part not in ("", ".", "..")] or ["model"]
    return report_folder(directory).resolve().joinpath(*parts[:-1], f"{parts[-1]}.html")
