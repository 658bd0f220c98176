"""`dr init --experiment`: a folder of its own that can run beside the others."""

import shlex

import pytest

from drcli.config.loading import load_settings


def test_an_experiment_begins_with_what_the_folder_has_and_can_run_beside_it(dr, empty, capsys):
    dr("init", "--world", "bean")
    (empty / "custom_files" / "reward_function.py").write_text("# mine\n")

    code = dr("init", "--experiment", "fast")

    own = load_settings(empty, environ={}, flags={"DR_EXPERIMENT_NAME": "fast"})
    main = load_settings(empty, environ={})
    assert code == 0
    assert own.world_name == "bean"
    assert (main.run_id, own.run_id) == (0, 1)
    assert own.model_prefix == "fast"
    assert own.custom_files_prefix == "custom_files/fast"
    assert (own.custom_files_dir / "reward_function.py").read_text() == "# mine\n"
    assert "source bin/activate.sh -e fast" in capsys.readouterr().err


def test_the_next_experiment_gets_the_next_number(dr, empty):
    dr("init")
    dr("init", "--experiment", "one")

    dr("init", "--experiment", "two", "--prefix", "my-model", "--world", "bean")

    two = load_settings(empty, environ={}, flags={"DR_EXPERIMENT_NAME": "two"})
    assert (two.run_id, two.model_prefix, two.world_name) == (2, "my-model", "bean")


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("a/b", [], "--experiment a/b is not a plain folder name"),
        ("..", [], "--experiment .. is not a plain folder name"),
        ("x", ["--cloud", "aws"], "for all: `dr config set DR_CLOUD=aws`."),
        ("x", ["--prefix", "a b"], "--prefix a b contains ' '"),
    ],
)
def test_an_experiment_that_cannot_be_is_refused(dr, empty, capsys, name, options, words):
    dr("init")

    code = dr("init", "--experiment", name, *options)

    assert code == 2
    assert words in capsys.readouterr().err
    assert not (empty / "experiments").exists()


def test_an_experiment_brings_the_files_of_the_workers(dr, empty):
    dr("init")
    (empty / "worker-2.env").write_text("DR_WORLD_NAME=bean\n")

    dr("init", "--experiment", "fast")

    assert (empty / "experiments/fast/worker-2.env").read_text() == "DR_WORLD_NAME=bean\n"


def test_an_experiment_is_checked_although_another_one_is_chosen(dr, empty):
    dr("init")
    dr("init", "--experiment", "one")
    with (empty / "system.env").open("a") as file:
        file.write("DR_EXPERIMENT_NAME=one\n")

    code = dr("init", "--experiment", "two", "--prefix", "custom_files/two")

    assert code == 2
    assert not (empty / "experiments" / "two").exists()


def test_a_note_of_an_old_value_stays_a_note(dr, empty):
    dr("init")
    text = (empty / "run.env").read_text()
    (empty / "run.env").write_text(f"# DR_WORLD_NAME=willow\n{text}")

    dr("init", "--experiment", "fast", "--world", "bean")

    own = load_settings(empty, environ={}, flags={"DR_EXPERIMENT_NAME": "fast"})
    assert own.world_name == "bean"
    assert own.warnings == ()


@pytest.mark.parametrize("broken", [b"\xff\xfe\x00binary", b"nonsense\n"])
def test_an_experiment_cannot_begin_with_a_broken_run_env(dr, empty, capsys, broken):
    dr("init")
    (empty / "run.env").write_bytes(broken)

    code = dr("init", "--experiment", "fast")

    assert code == 3
    assert "Error: run.env" in capsys.readouterr().err
    assert not (empty / "experiments").exists()


def test_without_a_script_of_ours_an_experiment_is_entered_by_its_name(dr, empty, capsys):
    dr("init")
    (empty / "bin" / "activate.sh").write_text("# of the reference\n")
    capsys.readouterr()

    dr("init", "--experiment", "fast")

    said = capsys.readouterr().err
    assert f"export DR_DIR={shlex.quote(str(empty))} DR_EXPERIMENT_NAME=fast" in said
    assert "source" not in said


def test_an_experiment_needs_a_working_folder(dr, empty, capsys):
    code = dr("init", "--experiment", "fast")

    assert code == 3
    assert "dr init" in capsys.readouterr().err
