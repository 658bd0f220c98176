"""Every command that writes a file for its user: an older one stays unless -f is given."""

from typing import Any

import pytest
import typer.main

from drcli.cli.command_line import application
from drcli.cli.command_table import COMMANDS
from drcli.config.presets import model_file

OLD = b"an older file"

READS = {
    *("--metadata", "--opp-metadata", "--model", "--opp-model", "--check", "--from", "--ca"),
    *("--password-file", "--reward", "--file", "--files", "traces", "first", "second"),
    "recordings",
}
"""Paths that commands only read; `--file` of dr-action-space is written after a question."""

READ_FILES = ("sweep start", "car upload", "car check", "tracks add", "reward check", "reward plot")
"""Commands whose argument FILE is read."""

WRITES = {
    ("sweep start", "--html"): None,  # needs a sweep
    ("sweep init", "file"): "sweep init {}",
    ("race export", "--csv"): "race export cup --csv {}",
    ("race export", "--html"): "race export cup --html {}",
    ("video", "--out"): "video -o {}.gif",
    ("saliency", "--html"): "saliency --html {}",
    ("saliency", "--png"): None,  # a folder
    ("history list", "--csv"): "history list --csv {}",
    ("history show", "--save"): None,  # a folder
    ("analyze", "--html"): "analyze --html {}",
    ("analyze", "--png"): None,  # a folder
    ("car check", "--out"): "car check --car 10.0.0.5 -o {}.jpg",
    ("export car", "--out"): "export car -o {}.tar.gz",
    ("export tf-checkpoint", "--out"): None,  # a folder
    ("export droa", "--out"): "export droa --out {}.tar.gz",
    ("export pb", "--out"): "export pb --out {}.pb",
    ("export onnx", "--out"): "export onnx --out {}.onnx",
    ("export tflite", "--out"): None,  # needs TensorFlow
    ("export openvino", "--out"): "export openvino --out {}.xml",
    ("droa download", "--output"): None,  # needs DeepRacer on AWS
    ("support-bundle", "file"): "support-bundle {}",
    ("action-space show", "--out"): "action-space show -o {}",
    ("action-space generate", "--out"): "action-space generate --angles 5 --speeds 2 -o {}",
    ("action-space from-lap", "--out"): None,  # as the one before
    ("action-space from-histogram", "--out"): None,
    ("tracks show", "--png"): "tracks show reinvent_base --png {}",
    ("reward plot", "--out"): "reward plot -o {}",
    ("reward compare", "--out"): "reward compare reward.py reward.py -o {}",
}
"""A command line for each option that names a file to write; None where another test has one."""


def parts() -> list[tuple[str, Any]]:
    """All commands and subcommands by name."""
    found = []
    for command in (command for command in COMMANDS if not command.same_as):
        loaded: Any = typer.main.get_command(application([command.name]))
        loaded = loaded.commands[command.name]
        for name, part in getattr(loaded, "commands", {"": loaded}).items():
            found.append((f"{command.name} {name}".strip(), part))
    return found


def test_options_of_version_0_1_0_that_answer_yes_are_still_taken():
    found = dict(parts())
    for name in ("support-bundle", "droa download"):
        taken = {option for parameter in found[name].params for option in parameter.opts}
        assert {"-f", "--force", "-y", "--yes"} <= taken


def test_every_path_that_a_command_takes_is_read_or_written_with_force():
    written = set()
    for name, part in parts():
        for parameter in part.params:
            option = parameter.opts[-1] if "--from" not in parameter.opts else "--from"
            described = getattr(parameter, "type_descriptor", None)
            is_path = "Path" in str(getattr(described, "annotation", ""))
            if not is_path and option != "--out":
                continue
            if option in READS or (option == "file" and name in READ_FILES):
                continue
            written.add((name, option))
            assert any("--force" in other.opts for other in part.params), name

    assert written == set(WRITES)


@pytest.mark.parametrize("line", [line for line in WRITES.values() if line is not None])
def test_an_existing_file_stays_and_the_refusal_names_the_option(
    dr, working_folder, monkeypatch, capsys, line
):
    monkeypatch.chdir(working_folder)
    (working_folder / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")
    (working_folder / "system.env").write_text("")
    (working_folder / "reward.py").write_text("def reward_function(params):\n    return 1.0\n")
    (working_folder / "custom_files").mkdir()
    for own in ("model_metadata.json", "reward_function.py"):
        data = model_file(own).read_bytes()
        (working_folder / "custom_files" / own).write_bytes(data)
    words = [word.format("old") for word in line.split()]
    [name] = (word for word in words if word.startswith("old"))
    (working_folder / name).write_bytes(OLD)

    code = dr(*words)

    assert code == 3
    assert "old" in (said := capsys.readouterr().err)
    assert "replace it with -f (--force)" in " ".join(said.split())
    assert (working_folder / name).read_bytes() == OLD
