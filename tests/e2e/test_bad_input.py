"""Wrong input meets one clear sentence, an exit code and no process: nothing was started."""

import json
import socket

import pytest

pytestmark = pytest.mark.nightly


@pytest.fixture
def workspace(shared_workspace):
    """The same folder and server for all, as nothing may have started in there."""
    shared_workspace.reset()
    return shared_workspace


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("    return 1 +\n", ["line 2", "not valid Python", "return 1 +"]),
        ("    return params['sped']\n", ["line 2", "KeyError", "params['sped']"]),
        ("    return 'fast'\n", ["returned 'fast'", "not a number"]),
        ("    while True:\n        pass\n", ["did not return within 5 s", "endless loop"]),
    ],
    ids=["syntax error", "exception", "string", "endless loop"],
)
def test_a_wrong_reward_function_is_named_with_file_and_line(workspace, body, words):
    workspace.write_custom_files(reward=body)

    _assert_refused(workspace, 3, ["custom_files/reward_function.py", *words])


def test_a_missing_reward_function_is_missed(workspace):
    (workspace.folder / "custom_files" / "reward_function.py").unlink()

    _assert_refused(workspace, 3, ["custom_files: reward_function.py is missing"])


def test_all_that_is_wrong_is_named_at_once_with_file_line_and_value(workspace):
    workspace.write_run_env(DR_WORLD_NAME="reinvent_bse")
    workspace.hyperparameters = {
        "lr": 1.5,
        "batch_size": "64",
    }
    workspace.write_custom_files()
    path = workspace.folder / "custom_files" / "model_metadata.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "action_space": []}))

    words = [
        *(
            "hyperparameters.json",
            "lr=1.5",
            "above 1",
        ),
        "not a number",
        *("model_metadata.json", "action_space=[] is empty"),
        *("reinvent_bse", "reinvent_base", "run.env line 1"),
    ]
    _assert_refused(workspace, 3, words)


def test_a_misspelt_setting_is_answered_with_the_right_name(workspace):
    workspace.write_run_env(DR_WORLD_NAM="reinvent_base")

    _assert_refused(workspace, 3, ["DR_WORLD_NAM=", "DR_WORLD_NAME", "run.env"])


def test_more_workers_than_episodes_are_refused(workspace):
    workspace.write_run_env(DR_WORKERS=5)

    _assert_refused(workspace, 3, ["DR_WORKERS=5", "num_episodes_between_training=4", "run.env"])


def test_a_taken_port_is_named(new_workspace):
    workspace = new_workspace()
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        workspace.environment["DR_LOCAL_S3_PORT"] = str(other.getsockname()[1])

        _assert_refused(workspace, 4, [str(other.getsockname()[1]), "DR_LOCAL_S3_PORT"])


def test_a_bucket_that_does_not_answer_is_named(workspace):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    workspace.environment |= _remote(f"http://127.0.0.1:{port}")

    _assert_refused(workspace, 4, [f"127.0.0.1:{port}", "DR_REMOTE_MINIO_URL"])


def test_wrong_access_keys_are_named(workspace, new_workspace):
    url = new_workspace().bucket().endpoint.url
    workspace.environment |= _remote(url)

    _assert_refused(workspace, 4, [url, "key"])


def test_a_wrong_option_is_a_wrong_command_line(workspace):
    done = workspace.run("start-training", "--sed", "1")

    assert done.returncode == 2
    assert "--seed" in done.stderr


def _remote(url: str) -> dict[str, str]:
    return {
        "DR_CLOUD": "remote",
        "DR_REMOTE_MINIO_URL": url,
        "AWS_ACCESS_KEY_ID": "wrong-key",
        "AWS_SECRET_ACCESS_KEY": "wrong-secret",
    }


def _assert_refused(workspace, code: int, words: list[str]) -> None:
    done = workspace.run("start-training", "-q")

    said = " ".join(done.stderr.split())
    assert done.returncode == code, done.stderr
    assert said.startswith(("Error:", "Warning:", "Waiting for an answer from "))
    assert "Try:" in said
    assert "Traceback" not in done.stderr + done.stdout
    for word in words:
        assert word in said
    assert workspace.record() == {}
