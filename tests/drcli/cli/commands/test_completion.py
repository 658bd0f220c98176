"""`dr completion`: what it prints and where it puts that."""

import json
import pwd

import pytest

from drcli.cli.command_table import program_names


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "ZDOTDIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SHELL", "/usr/bin/zsh")
    return tmp_path


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_one_script_serves_all_programs(dr, capsys, shell):
    code = dr("completion", "show", shell)

    shown = capsys.readouterr().out.split()
    assert code == 0
    assert set(program_names()) <= {word.rstrip(";") for word in shown}


def test_the_shell_is_that_of_the_user(dr, home, capsys):
    dr("completion", "show")

    assert "compdef" in capsys.readouterr().out


def test_an_unknown_shell_is_refused_with_the_known_ones(dr, home, monkeypatch, capsys):
    monkeypatch.setenv("SHELL", "/bin/tcsh")

    code = dr("completion", "install")

    assert code == 3
    assert "SHELL=tcsh is not one of bash, zsh, fish" in capsys.readouterr().err


def test_a_user_without_a_home_is_told_so(dr, home, monkeypatch, capsys):
    monkeypatch.delenv("HOME")
    monkeypatch.setattr(pwd, "getpwuid", _no_user)

    code = dr("completion", "install", "bash")

    said = capsys.readouterr().err
    assert code == 3
    assert "The home folder of this user is not known" in said
    assert "dr completion show bash" in said


def _no_user(number):
    raise KeyError(number)


@pytest.mark.parametrize(("shell", "start_file"), [("bash", ".bashrc"), ("zsh", ".zshrc")])
def test_a_start_file_gets_one_line_however_often(dr, home, capsys, shell, start_file):
    (home / start_file).write_text("alias ll='ls -l'")

    dr("completion", "install", shell, "--json")
    first = json.loads(capsys.readouterr().out)
    dr("completion", "install", shell, "--json")
    second = json.loads(capsys.readouterr().out)

    lines = (home / start_file).read_text().splitlines()
    assert (first["added"], second["added"]) == (True, False)
    assert lines[0] == "alias ll='ls -l'"
    assert len(lines) == 2
    assert first["script"] in lines[1]


def test_fish_needs_no_line(dr, home, capsys):
    code = dr("completion", "install", "fish")

    assert code == 0
    assert "complete -c" in (home / ".config" / "fish" / "conf.d" / "drcli.fish").read_text()


def test_a_home_that_cannot_be_written_is_a_sentence(dr, home, capsys):
    (home / ".local").write_text("in the way")

    code = dr("completion", "install", "bash")

    assert code == 3
    assert "dr completion show bash" in capsys.readouterr().err
