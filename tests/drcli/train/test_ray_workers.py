"""Workers that Ray places, with a cluster on paper."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from drcli.base.errors import NotAvailable, SettingsError, WorkerDied
from drcli.config.loading import load_settings
from drcli.run.launchers.ray_workers import MOST_DEATHS, MOST_NAMED, RayWorkers, join_arguments
from drcli.run.plan import planned_job
from drcli.train import ray_cluster
from drcli.train.ray_cluster import NodeLost, connected
from drcli.train.ray_host import WorkerHost
from drcli.workers import ray_extra


class PaperPlace:
    """A worker that answers what a test says."""

    def __init__(self):
        self.answers, self.stopped, self.given_back = [], False, False

    def look(self):
        if self.stopped:
            return ("node", [], 0)
        answer = self.answers.pop(0) if self.answers else None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def stop(self):
        self.stopped = True

    def give_back(self):
        self.given_back = True


class PaperCluster:
    """Gives places in order."""

    def __init__(self):
        self.places = []

    def place(self):
        self.places.append(PaperPlace())
        return self.places[-1]


@pytest.fixture
def cluster():
    return PaperCluster()


def test_workers_wait_for_nodes_and_then_drive_there(cluster):
    workers = RayWorkers(cluster, 3)
    assert workers.look() == "workers: 3 wait for a node with free cores"

    cluster.places[0].answers = [("first", [], None)]
    cluster.places[1].answers = [("second", [], None)]
    cluster.places[2].answers = [("first", [], None)]

    assert workers.look() == "workers: 2 on first, 1 on second"


def test_many_nodes_are_counted_and_not_named(cluster):
    workers = RayWorkers(cluster, 2 * (MOST_NAMED + 1))
    for number, place in enumerate(cluster.places):
        place.answers = [(f"node-{number // 2}", [], None)]

    assert workers.look() == f"workers: {2 * (MOST_NAMED + 1)} on {MOST_NAMED + 1} nodes"


def test_a_worker_whose_node_is_gone_gets_another_place(cluster):
    workers = RayWorkers(cluster, 1)
    cluster.places[0].answers = [("first", ["I drive."], None), NodeLost("NodeDiedError")]
    workers.look()

    assert workers.look() == "workers: 1 wait for a node with free cores"
    assert cluster.places[0].given_back
    assert len(cluster.places) == 2


def test_a_worker_that_the_training_has_let_go_stays_away(cluster):
    workers = RayWorkers(cluster, 1)
    cluster.places[0].answers = [("first", [], None), ("first", [], 0)]
    workers.look()

    assert workers.look() == "workers: none"
    assert len(cluster.places) == 1


def test_a_node_with_another_version_ends_the_training_with_its_words(cluster):
    workers = RayWorkers(cluster, 1)
    cluster.places[0].answers = [("first", ["Error: drcli is 0.2 here.", "Try: Update."], 3)]

    with pytest.raises(SettingsError, match=r"first cannot join: Error: drcli is 0\.2 here"):
        workers.look()


def test_a_worker_that_always_dies_ends_the_training(cluster):
    workers = RayWorkers(cluster, 1)

    for _ in range(MOST_DEATHS - 1):
        cluster.places[-1].answers = [("first", [], 5)]
        workers.look()
    cluster.places[-1].answers = [("first", [], 5)]

    with pytest.raises(WorkerDied, match="ended 3 times in a row, on first with exit code 5"):
        workers.look()


def test_all_leave_and_give_their_places_back(cluster):
    workers = RayWorkers(cluster, 2)
    cluster.places[0].answers = [("first", [], None)]
    workers.look()

    workers.leave()

    assert all(place.stopped and place.given_back for place in cluster.places)


def test_the_worker_of_a_node_is_a_process_whose_words_are_kept(tmp_path: Path):
    host = WorkerHost(["--join", "nothing"], str(tmp_path), {}, 1)
    host._process.wait(30)
    host._reader.join(30)

    _, lines, code = host.look()

    assert code == 2
    assert "does not name a model" in " ".join(lines)
    assert host.look()[1] == []
    host.stop()


def test_the_workers_join_through_the_bucket_of_the_training(working_folder, monkeypatch):
    monkeypatch.setattr(ray_extra, "require_ray", lambda: None)
    (working_folder / "system.env").write_text(
        "DR_CLOUD=remote\nDR_REMOTE_MINIO_URL=http://far:9000\nDR_LOCAL_S3_BUCKET=bucket\n"
        "DR_LAUNCHER=ray\nDR_LOCAL_S3_PROFILE=racer\n"
    )

    job = planned_job(load_settings(working_folder), seed=1, began_at=0.0)

    assert (job.ray_workers, job.config.train.workers) == (2, 0)
    words = " ".join(join_arguments(job))
    assert words.startswith("--join s3://bucket/model --wait --no-take-over")
    assert "--endpoint-url http://far:9000 --region us-east-1 --profile racer" in words


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)

    with pytest.raises(NotAvailable, match="not installed") as caught:
        ray_extra.require_ray()

    assert "drcli[ray]" in caught.value.remedy


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.0.0.1:99999", "[::1]:1"])
def test_an_address_where_nobody_listens_is_named_soon(address, working_folder, monkeypatch):
    monkeypatch.setattr("drcli.train.ray_cluster.require_ray", lambda: None)
    monkeypatch.setitem(sys.modules, "ray", object())
    (working_folder / "system.env").write_text(f"DR_LAUNCHER=ray\nDR_RAY_ADDRESS={address}\n")
    job = planned_job(load_settings(working_folder), seed=1, began_at=0.0)

    with pytest.raises(SettingsError, match="does not answer") as caught, connected(job):
        pass

    assert address in str(caught.value)


@pytest.mark.parametrize(
    ("given", "variable", "address"),
    [("", "", "local"), ("", "10.0.0.5:6379", "10.0.0.5:6379"), ("auto", "10.0.0.5:6379", "auto")],
)
def test_without_an_address_ray_starts_here_whatever_else_runs(
    monkeypatch, given, variable, address
):
    seen = {}
    ray = SimpleNamespace(init=lambda **values: seen.update(values), nodes=lambda: [])
    monkeypatch.setattr(ray_cluster, "require_ray", lambda: None)
    monkeypatch.setattr(ray_cluster, "_refuse_silent_address", lambda address: None)
    monkeypatch.setitem(sys.modules, "ray", ray)
    monkeypatch.setenv("RAY_ADDRESS", variable)

    assert ray_cluster.connect(given, "local") is ray
    assert seen["address"] == address


@pytest.mark.parametrize(
    ("path", "environment"),
    [("/a/python", None), ("/a b/python", {"py_executable": "'/a b/python'"})],
)
def test_an_interpreter_with_a_blank_in_its_path_is_quoted_for_the_shell_of_ray(
    monkeypatch, path, environment
):
    seen = {}
    ray = SimpleNamespace(init=lambda **values: seen.update(values), nodes=lambda: [])
    monkeypatch.setattr(ray_cluster, "require_ray", lambda: None)
    monkeypatch.setitem(sys.modules, "ray", ray)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setattr(sys, "executable", path)

    ray_cluster.connect("", "local")

    assert seen["runtime_env"] == environment
