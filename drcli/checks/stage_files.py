"""Reads the curriculum, and the files that its stages name."""

from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote

from drcli.base.problems import Place, Problem, ProblemsError, shown
from drcli.config.setting_problems import setting_problem
from drcli.config.settings import Settings
from drcli.exchange.frozen_curriculum import FrozenCurriculum
from drcli.modelfiles.curriculum_file import RULE
from drcli.modelfiles.custom_files import InputFile

SETTING = "DR_CURRICULUM_FILE"

LARGEST_FILE = 1024 * 1024
"""A larger file was named by mistake."""


def curriculum_path(settings: Settings) -> Path:
    """Beside run.env or in the experiment's folder."""
    return settings.custom_files_dir.parent / Path(settings.curriculum_file).expanduser()


@dataclass
class StageFiles:
    """The curriculum and its files: of this machine, else of the model."""

    settings: Settings
    frozen: FrozenCurriculum | None
    read: dict[str, str] = field(default_factory=dict)

    def curriculum(self) -> tuple[str, bytes]:
        """Name and content; raises ProblemsError."""
        settings, name = self.settings, self.settings.curriculum_file
        path = curriculum_path(settings)
        data = _content(path, settings.place(SETTING))
        if data is not None:
            return str(path), data
        if self.frozen is not None:
            return self.frozen.name, self.frozen.text.encode()
        what = f"{SETTING}={shown(name)}: there is no such file in {path.parent}."
        remedy = "`dr-init --curriculum` writes an example, or leave the setting empty."
        raise ProblemsError([setting_problem(SETTING, settings.place(SETTING), what, remedy)])

    def named(self, name: str, place: Place) -> InputFile | None:
        """None if it does not exist; raises ProblemsError."""
        path = curriculum_path(self.settings).parent / Path(name).expanduser()
        for each in (path, self.settings.custom_files_dir / name):
            data = _content(each, place)
            if data is not None:
                self.read[name] = data.decode(errors="replace")
                return InputFile(each.name, data, str(each))
        if self.frozen is not None and name in self.frozen.files:
            self.read[name] = self.frozen.files[name]
            return InputFile(Path(name).name, self.read[name].encode(), name)
        return None


def _content(path: Path, place: Place) -> bytes | None:
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            return file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        what = f"{path} cannot be read ({reason})."
        remedy = f"Make it readable for yourself, as with `chmod u+r {quote(str(path))}`."
        raise ProblemsError([Problem(RULE, "error", *place, what, remedy)]) from error
