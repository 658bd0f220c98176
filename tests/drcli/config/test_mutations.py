"""200 damaged copies of the reference's files: each passes the check or is refused well."""

import random
import re
from collections.abc import Callable
from itertools import product
from pathlib import Path

import pytest

from drcli.cli.app import main
from drcli.config.settings_files import LARGEST_BYTES

REFERENCE = Path(__file__).resolve().parents[2] / "data" / "reference"

CASES = 200

PLAIN = """
abc -1 0 1e999 nan inf 0x10 1,5 ١٢ True? $NOBODY ${ ${} $(reboot) $DR_CAR_NAME$DR_CAR_NAME ' " 'open
`ls` s3://bucket ../../etc/passwd / // . ~ ~nobody/x \\ \\n %s {} # = == null [1] 1;2;3 0.5,1; http://[
eu_west 0.5,inf 0.5, ,, ../x 1_0 ０ ${X:-${Y}} -rf http://x:99999 1e-400 4294967296
"""
VALUES = (*PLAIN.split(), "a b", "9" * 400, "x" * 10_000, "ü\u2028ß", "\x1b[31m", "\t", "\x7f")
"""What somebody, or an accident, may write behind an equal sign."""


class Files:
    """The two files while they are damaged."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.names = ["run.env", "system.env"]
        self.data = {name: (REFERENCE / name).read_bytes() for name in self.names}

    def any_file(self) -> str:
        return self.random.choice(self.names)

    def change_line(self, change: Callable[[str, str], str]) -> None:
        """Give one NAME=value line another text."""
        file = self.any_file()
        lines = self.data[file].decode().splitlines()
        at = self.random.choice([k for k, line in enumerate(lines) if line.startswith("DR_")])
        name, _, value = lines[at].partition("=")
        lines[at] = change(name, value)
        self.data[file] = ("\n".join(lines) + "\n").encode()


def typo(files: Files) -> None:
    def change(name: str, value: str) -> str:
        at = files.random.randrange(3, len(name))
        how = files.random.randrange(4)
        kinds = (
            name[:at] + name[at + 1 :],
            name[:at] + name[at] + name[at:],
            name[:at] + files.random.choice("_-. XQ") + name[at + 1 :],
            name.lower(),
        )
        return f"{kinds[how]}={value}"

    files.change_line(change)


def wrong_value(files: Files) -> None:
    files.change_line(lambda name, value: f"{name}={files.random.choice(VALUES)}")


def no_equal_sign(files: Files) -> None:
    files.change_line(lambda name, value: f"{name} {value}")


def odd_line(files: Files) -> None:
    forms = (
        "export {0}={1}",
        "export {0}",
        "{0}+={1}",
        "{0}='' ''",
        "{0} = {1}",
        "{0}={1}\n{0}={1}x",
        "  {0}={1}",
        "=",
        "{0}={0}",
        "[x]",
    )
    form = files.random.choice(forms)
    files.change_line(lambda name, value: form.format(name, value))


def circle(files: Files) -> None:
    files.change_line(lambda name, value: f"{name}=$A\nA=$B\nB=${{{name}}}$A")


def huge(files: Files) -> None:
    more = files.random.choice(
        [b"#" * LARGEST_BYTES, b"A=1\n" * 3_000, b"B=" + b"x" * 50_000, b"\n" * 50_000]
    )
    files.data[files.any_file()] += more


def empty(files: Files) -> None:
    files.data[files.any_file()] = files.random.choice([b"", b"\n", b"  ", b"\xef\xbb\xbf", b"#"])


def binary(files: Files) -> None:
    file = files.any_file()
    junk = files.random.randbytes(files.random.randrange(1, 40))
    text = files.data[file]
    at = files.random.randrange(len(text))
    files.data[file] = files.random.choice(
        [
            files.random.randbytes(3_000),
            text[:at] + junk + text[at:],
            text[:at] + b"\0" + text[at:],
            text.decode().encode("utf-16"),
            text[:at] + "ü".encode("latin-1") + text[at:],
        ]
    )


def line_ends(files: Files) -> None:
    file = files.any_file()
    end = files.random.choice([b"\r\n", b"\r", b"\n\n", b"\n\r\n"])
    files.data[file] = files.data[file].replace(b"\n", end)


def mark(files: Files) -> None:
    file = files.any_file()
    files.data[file] = b"\xef\xbb\xbf" + files.data[file]


def cut_off(files: Files) -> None:
    file = files.any_file()
    files.data[file] = files.data[file][: files.random.randrange(len(files.data[file]))]


HARMLESS = (line_ends, mark)
TO_LINES = (typo, wrong_value, wrong_value, wrong_value, no_equal_sign, odd_line, circle)
TO_BYTES = (huge, empty, binary, cut_off, *HARMLESS)


@pytest.mark.parametrize("seed", range(CASES))
def test_a_damaged_file_passes_or_is_refused_by_file_and_key(seed, working_folder, capsys):
    files = Files(seed)
    damages = [files.random.choice(TO_LINES)] if seed % 4 else []
    damages += [files.random.choice(TO_BYTES)] if seed % 2 == 0 else []
    for damage in damages:
        damage(files)
    for name, data in files.data.items():
        (working_folder / name).write_bytes(data)

    with pytest.raises(SystemExit) as end:
        main(["config", "check", "--settings"])

    said = capsys.readouterr()
    assert end.value.code in (0, 3), damages
    assert "Traceback" not in said.out + said.err
    assert "bug of ours" not in said.err
    if end.value.code:
        _assert_place_and_key(said.err.splitlines()[0], files.data)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("damage", HARMLESS)
def test_line_ends_and_marks_change_nothing(seed, damage, working_folder, capsys):
    files = Files(seed)
    damage(files)
    for name, data in files.data.items():
        (working_folder / name).write_bytes(data)

    with pytest.raises(SystemExit) as end:
        main(["config", "check", "--settings"])

    assert end.value.code == 0
    assert capsys.readouterr().out.endswith("Settings: 0 errors, 0 warnings.\n")


def folder(path: Path) -> None:
    path.mkdir()


def link_to_itself(path: Path) -> None:
    path.symlink_to(path.name)


def link_to_nothing(path: Path) -> None:
    path.symlink_to("nowhere")


@pytest.mark.parametrize("replace", [folder, link_to_itself, link_to_nothing])
@pytest.mark.parametrize(
    ("file", "command"),
    [
        *product(
            ("run.env", "system.env"),
            (
                "config check --settings",
                "config set DR_CAR_NAME=x",
                "init --experiment x",
                "shell-env",
            ),
        ),
        *product(("worker-2.env",), ("config check --settings", "init --experiment x")),
    ],
)
def test_what_is_no_file_is_refused_by_name(command, file, replace, working_folder, capsys):
    with (working_folder / "run.env").open("a") as run:
        run.write("DR_TRAIN_MULTI_CONFIG=True\nDR_WORKERS=2\n")
    (working_folder / file).unlink(missing_ok=True)
    replace(working_folder / file)

    with pytest.raises(SystemExit) as end:
        main(command.split())

    said = capsys.readouterr().err
    assert end.value.code == 3
    assert re.match(rf"(Error|activate\.sh): {file}: ", said)
    assert "bug of ours" not in said


def _assert_place_and_key(sentence: str, data: dict[str, bytes]) -> None:
    """The sentence starts with file and line, and holds the name that stands in that line."""
    found = re.match(r"Error: (run\.env|system\.env)(?: line (\d+))?: (.+)", sentence)
    assert found is not None, sentence
    file, line, what = found.groups()
    if line is None or re.search("not UTF-8 text|contains a NUL", what):
        return  # no text, so no key either
    lines = re.split(r"\r\n|\n|\r", data[file].decode("utf-8-sig"))
    key = lines[int(line) - 1].strip().removeprefix("export ").partition("=")[0].strip()
    assert ascii(key)[1:60].rstrip("'") in ascii(what), (sentence, key)
