"""Where the report of a model is kept."""

from pathlib import Path


def report_folder(directory: Path) -> Path:
    return directory / "data" / "analysis"


def report_file(directory: Path, model: str) -> Path:
    """A model in a folder has its report in such a folder."""
    parts = [part for part in model.split("/") if part not in ("", ".", "..")] or ["model"]
    return report_folder(directory).resolve().joinpath(*parts[:-1], f"{parts[-1]}.html")
