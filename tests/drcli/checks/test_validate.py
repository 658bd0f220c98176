"""Reports on whole folders: all findings at once, whatever is missing or broken."""

import json
import os
import time
from pathlib import Path
from threading import Event

import pytest

from drcli.base.errors import SettingsError, StorageError
from drcli.checks.validate import validate
from drcli.config.loading import load_settings
from drcli.model.files.custom_files import InputFile
from drcli.rewards.reward_rules import read_source
from drcli.run.plan import StartOptions, prepare
from own_run import own_run
from reference_model import HYPERPARAMETERS

ROOT = Path(__file__).resolve().parents[3]

REFERENCE = {**HYPERPARAMETERS, "sac_alpha": 0.2}
"""hyperparameters.json as the reference ships it."""


def broken(*_args, **_options):
    """Stands in for a bucket that does not answer."""
    raise StorageError("Nothing answers at http://nas:9000.", remedy="Start that server.")


def test_in_a_folder_as_it_should_be_nothing_is_wrong(folder):
    report = folder.report()

    assert report.ok
    assert (report.errors, report.warnings, report.skipped) == ((), (), ())


def test_the_files_that_the_reference_ships_have_no_errors(folder):
    folder.hyperparameters(**REFERENCE)
    steering = (-30, -15, 0, 15, 30)
    folder.metadata(action_space=[{"steering_angle": a, "speed": 0.6} for a in steering])

    report = folder.report()

    assert (report.errors, report.warnings) == ((), ())


def test_findings_of_all_files_come_at_once(folder):
    folder.settings(DR_WORLD_NAME="nowhere", DR_EVAL_MAX_RESETS="many")
    folder.hyperparameters(lr=2, loss_type=3)
    folder.metadata(sensor=["EYES"], action_space=[])
    folder.reward("def reward_function(params):\n    return params['sped'] + bonus\n")

    report = folder.report()

    assert [item.rule for item in report.errors] == [
        *("V-05", "V-12", "V-21", "V-30", "V-33", "V-41", "V-43"),
    ]
    assert "undefined name 'bonus'" in str(report.warnings)


@pytest.mark.parametrize("missing", ["reward_function.py", "model_metadata.json"])
def test_where_a_file_is_missing_the_others_are_looked_at(folder, missing):
    folder.hyperparameters(lr=2)
    folder.remove(missing)

    report = folder.report()

    assert {item.rule for item in report.errors} == {
        "V-41",
        "V-02" if missing.startswith("reward") else "V-03",
    }


def test_a_model_to_start_from_is_looked_for_even_if_the_new_one_is_wrong(folder):
    folder.settings(DR_LOCAL_S3_PRETRAINED=True, DR_LOCAL_S3_PRETRAINED_PREFIX="old")
    folder.hyperparameters(lr=2)

    report = folder.report()

    assert [item.rule for item in report.errors] == ["V-10", "V-41"]


def test_with_a_broken_bucket_all_other_rules_are_tried(folder, monkeypatch):
    monkeypatch.setattr("drcli.checks.validate.open_bucket", broken)
    folder.hyperparameters(lr=2)
    folder.settings(DR_WORLD_NAME="nowhere")

    report = folder.report()

    assert [item.rule for item in report.errors] == ["V-05", "V-41", "V-50"]
    assert report.errors[-1].message == "Nothing answers at http://nas:9000."
    assert [item.rules for item in report.skipped] == [("V-09", "V-10", "V-13", "V-15", "V-35")]


def test_a_file_that_may_lie_in_a_bucket_that_is_broken_is_not_called_missing(folder, monkeypatch):
    monkeypatch.setattr("drcli.checks.validate.open_bucket", broken)
    folder.remove("hyperparameters.json")

    report = folder.report()

    assert [item.rule for item in report.errors] == ["V-50"]
    assert ("V-04",) in [item.rules for item in report.skipped]


def test_a_bucket_that_fails_in_the_middle_is_reported(folder, monkeypatch):
    monkeypatch.setattr("drcli.checks.before_start.review_prefix", broken)

    report = folder.report()

    assert [item.rule for item in report.errors] == ["V-50"]


def test_without_any_settings_the_three_files_are_looked_at(folder):
    folder.settings(DR_LOCAL_S3_MODEL_PREFIX="$DR_LOCAL_S3_METRICS_PREFIX")
    folder.hyperparameters(lr=2)
    folder.reward("def reward_function(params):\n    return bonus\n")

    report = folder.report()

    found = [*report.errors, *report.warnings]
    assert [(item.rule, item.where) for item in found if item.rule in ("V-41", "V-22")] == [
        ("V-41", "custom_files/hyperparameters.json line 2"),
        ("V-22", "custom_files/reward_function.py line 2"),
    ]


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"def reward_function(params):\n    return 1.0\0\n",
        b"# \xe4\n",
        b"x = " + b"(" * 5000 + b")" * 5000,
        b"\tdef reward_function(params):\n  return 1.0",
        b"def reward_function(params):\n    yield 1.0\n",
        b"reward_function = 3\n",
    ],
)
def test_no_reward_function_is_too_bad_to_report(folder, content):
    (folder.path / "custom_files" / "reward_function.py").write_bytes(content)

    report = folder.report(console=True)

    assert report.errors
    assert all(item.where.startswith("custom_files/reward_function.py") for item in report.errors)


def test_a_training_that_goes_on_keeps_another_from_starting_and_its_model_is_no_error(folder):
    own_run().write(folder.path / "data" / "runs" / "0")
    folder.bucket.put("model-1/reward_function.py", b"")

    report = folder.report()

    assert [item.rule for item in (*report.errors, *report.warnings)] == ["V-13"]
    assert "Run 0 is training s3://bucket/model-1" in report.errors[0].message
    assert validate(folder.path, environ={}, here=False).ok


def test_without_a_run_env_the_rest_is_tried_with_defaults(folder):
    (folder.path / "run.env").unlink()
    folder.reward("def reward_function(params):\n    return params['sped']\n")

    report = folder.report()

    assert [(item.rule, item.where) for item in report.errors] == [
        ("V-12", "run.env"),
        ("V-21", "custom_files/reward_function.py line 2"),
    ]


@pytest.mark.parametrize(
    "content",
    [
        b"\xff\xfe\x00",
        b"DR_WORKERS=1\n=\n'\n",
        b'DR_CAR_NAME="a\nb',
        b"DR_EXPERIMENT_NAME=none\nDR_WORKER=2\n",
    ],
)
def test_no_settings_file_is_too_bad_to_report(folder, content):
    (folder.path / "run.env").write_bytes(content)
    folder.hyperparameters(lr=2)

    report = folder.report()

    assert not report.ok
    assert report.errors[0].where.startswith("run.env")
    assert "V-41" in {item.rule for item in report.errors}


def test_a_wrong_environment_is_named_and_left_out(folder):
    report = validate(folder.path, environ={"DR_WORKERS": "many"})

    assert [(item.rule, item.where) for item in report.errors] == [("V-45", "environment")]


def test_nothing_in_the_folder_or_bucket_changes(folder):
    before = {path: path.read_bytes() for path in folder.path.rglob("*") if path.is_file()}

    folder.report()

    assert {p: p.read_bytes() for p in folder.path.rglob("*") if p.is_file()} == before
    assert folder.bucket.list("") == []


def test_places_inside_the_folder_are_named_from_there(folder):
    folder.remove("reward_function.py")

    [missing] = folder.breaches("V-02")

    assert missing.where == "custom_files"
    assert str(folder.path) not in missing.message + missing.remedy


def test_more_workers_than_episodes_are_told_once(folder):
    folder.settings(DR_WORKERS=6)
    folder.hyperparameters(num_episodes_between_training=5)

    assert [item.severity for item in folder.breaches("V-45")] == ["error"]
    assert folder.breaches("V-42", console=True) == []


def test_starts_that_only_matter_elsewhere_are_told_only_for_elsewhere(folder):
    folder.hyperparameters(num_episodes_between_training=40)

    assert folder.breaches("V-42") == []
    assert len(folder.breaches("V-42", console=True)) == 1


def test_files_that_the_bucket_does_not_give_are_told_with_its_own_remedy(folder, monkeypatch):
    def fail(key):
        raise StorageError("The server is busy.", remedy="Try again.")

    folder.remove("reward_function.py")
    monkeypatch.setattr("drcli.checks.start_rules.probe", lambda *_: [])
    monkeypatch.setattr(folder.bucket, "get", fail)

    told = [(item.rule, item.message, item.remedy) for item in folder.report().errors]

    assert ("V-50", "The server is busy.", "Try again.") in told


def test_a_rule_for_the_console_is_an_error_only_when_it_shall_take_the_model(folder):
    folder.metadata(**{"action_space": [{"steering_angle": 0, "speed": 1}]})

    here, there = folder.breaches("V-32"), folder.breaches("V-32", console=True)

    assert [item.severity for item in here + there] == ["warning", "error"]


def test_remarks_on_style_are_one_line_unless_the_console_shall_take_the_model(folder):
    folder.reward("import math\nimport random\ndef reward_function(params):\n return  1.0\n")

    [line] = folder.breaches("V-22")
    listed = folder.breaches("V-22", console=True)

    assert len(listed) > 2
    assert line.message.startswith(f"{len(listed)} remarks about style, such as: ")
    assert line.remedy.endswith("`dr-validate --console-compatible` lists all.")
    assert {each.severity for each in listed} == {"error"}


def test_values_beyond_the_car_are_one_line_unless_the_console_shall_take_the_model(folder):
    actions = [{"steering_angle": n, "speed": 5, "name": "x"} for n in range(12)]
    folder.metadata(action_space=actions)

    [line], listed = folder.breaches("V-32"), folder.breaches("V-32", console=True)
    [unused] = folder.breaches("V-03")

    assert len(listed) == 12
    assert line.message == (
        "12 values of action_space are beyond what the car can do, such as: "
        "action_space[0].speed=5 is more than the car can do (0.1 to 4)."
    )
    assert unused.message.startswith("12 keys are not used, such as: action_space[0].name is")


def test_the_start_of_a_training_reports_the_same_errors_in_a_line_each(folder, monkeypatch):
    monkeypatch.setattr("drcli.run.plan.open_bucket", lambda *_, **__: folder.bucket)
    folder.settings(DR_WORLD_NAME="nowhere")
    folder.hyperparameters(lr=2, loss_type=3)
    folder.reward("def reward_function(params):\n    return bonus\n")
    expected = folder.report().errors

    with pytest.raises(SettingsError) as refusal:
        prepare(load_settings(folder.path, environ={}), StartOptions())

    said = str(refusal.value).replace(f"{folder.path}{os.sep}", "")
    assert [error.rule for error in expected] == ["V-05", "V-22", "V-41", "V-43"]
    assert said == "\n".join(str(error).replace("\n", " ") for error in expected)
    assert refusal.value.remedy.endswith("\nWrite one of these.")


def test_the_start_warns_of_what_surprises_and_not_of_style(folder, monkeypatch):
    monkeypatch.setattr("drcli.run.plan.open_bucket", lambda *_, **__: folder.bucket)
    folder.reward("def reward_function(params):\n  return 1 if params['progress']==1 else 2\n")

    plan = prepare(load_settings(folder.path, environ={}), StartOptions())

    converted, progress = plan.warnings
    assert "It returned int" in converted
    assert "progress == 1" in progress


def test_an_endless_loop_ends_at_the_deadline_and_is_named(folder, try_here):
    loop = b"def reward_function(params):\n    while True:\n        pass\n"
    started_s = time.monotonic()

    [found] = try_here(
        load_settings(folder.path, environ={}).run,
        folder.path,
        read_source(InputFile("reward_function.py", loop, "mine.py"))[0],
        Event(),
        call_s=0.2,
    )

    assert (found.rule, found.where) == ("V-21", "mine.py line 2")
    assert "did not return within 0.2 s" in found.message
    assert time.monotonic() - started_s < 60


@pytest.mark.parametrize("text", ["LIMIT = limit\n", ""])
def test_an_undefined_name_is_reported_once(folder, text):
    folder.reward(f"{text}def reward_function(params):\n    return limit\n")

    places = {(item.rule, item.where) for item in folder.report().errors}

    assert {rule for rule, _ in places} == {"V-22"}
    assert len(places) == len(folder.report().errors) == 1


@pytest.mark.parametrize(
    ("options", "code"), [([], 3), (["--force"], 0), (["--json"], 3), (["--json", "--force"], 0)]
)
def test_with_errors_the_exit_code_is_3_unless_forced(folder, dr, capsys, options, code):
    folder.hyperparameters(lr=2)

    ended = dr("validate", *options)

    printed = capsys.readouterr().out
    assert ended == code  # V-11
    assert "V-41" in printed
    assert ("--json" in options) == printed.startswith("{")


def test_without_errors_the_exit_code_is_0(folder, dr, capsys):
    ended = dr("validate")

    assert ended == 0  # V-11
    assert capsys.readouterr().out.splitlines() == [
        "The trained model can go to the physical car, and to DeepRacer on AWS or "
        "DeepRacer-for-Cloud.",
        "0 errors, 0 warnings. A training can start.",
    ]


def test_people_read_rule_place_value_and_remedy_of_each_group(folder, dr, capsys):
    folder.hyperparameters(lr=2, batch_size=34)

    dr("validate")

    assert capsys.readouterr().out.splitlines() == [
        "Errors",
        "  V-41  custom_files/hyperparameters.json line 2",
        "    lr=2 is above 1.",
        '    Try: Write 1 or less, as in "lr": 0.0003.',
        "1 error, 0 warnings. A training would not start.",
    ]


def test_programs_read_keys_that_stay(folder, dr, capsys):
    folder.hyperparameters(batch_size=34)

    dr("validate", "--json", "--console-compatible")

    printed = json.loads(capsys.readouterr().out)
    assert list(printed) == [
        *("directory", "console_compatible", "errors", "warnings", "skipped", "notes", "goes_to"),
        *("destination", "ok"),
    ]
    assert (printed["ok"], printed["console_compatible"]) == (True, True)
    assert printed["warnings"] == [
        {
            "rule": "V-40",
            "severity": "warning",
            "where": "custom_files/hyperparameters.json line 2",
            "message": "batch_size=34 is used as it is; 32 is probably meant.",
            "remedy": "Write 32.",
        }
    ]
