"""Trainings of a sweep on nodes of Ray, with actors on paper."""

import pickle
import socket
from types import SimpleNamespace

import pytest

from drcli.base.errors import BudgetUsedUp, SettingsError, TrainedElsewhere
from drcli.records.run_record import RunRecord
from drcli.sweeps import ray_trials
from drcli.sweeps.ray_trials import (
    MOST_LOST,
    NodeAnswer,
    NodeTrial,
    Place,
    RayNodes,
    RayTrial,
    TrialTask,
    files_for_nodes,
    folder_on_node,
    place_for,
)
from drcli.sweeps.sweep_record import TrialRecord
from drcli.sweeps.trial_run import Limits
from drcli.train.ray_cluster import NodeLost
from memory_bucket import MemoryBucket

TRIAL = TrialRecord("s-01", "s-01", 1)


def record(state):
    return RunRecord(0, "", "", "s-01", "", state, 1, 0.0, 0.0, message="Done.")


class PaperActor:
    """Answers with what a test has laid out; None while there is no node."""

    def __init__(self):
        self.answers, self.stops, self.given_back = [], 0, False

    def look(self):
        answer = self.answers.pop(0) if self.answers else None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def stop(self):
        self.stops += 1

    def give_back(self):
        self.given_back = True


class PaperRay:
    """Ray on paper: `options` of each actor."""

    def __init__(self, *nodes):
        self.asked, self.there = [], nodes

    def nodes(self):
        return [{"Alive": True, "Resources": node} for node in self.there]

    def remote(self, _actor):
        def options(**needed):
            self.asked.append(needed)
            return SimpleNamespace(remote=lambda task: task)

        return SimpleNamespace(options=options)


@pytest.fixture
def actors(monkeypatch):
    found = []

    def placed(_ray, _task):
        found.append(PaperActor())
        return found[-1]

    monkeypatch.setattr(ray_trials, "PlacedActor", placed)
    return found


@pytest.fixture
def trial(tmp_path, actors):
    return RayTrial(PaperRay(), Place(2, 0.5), tmp_path, TRIAL, MemoryBucket())


def test_a_training_runs_from_its_start_to_the_end_that_its_node_tells(trial, actors):
    assert not trial.runs
    trial.start(Limits())
    assert trial.runs

    actors[0].answers = [
        NodeAnswer(record("running"), alive=True),
        NodeAnswer(record("finished")),
    ]
    assert trial.runs
    assert not trial.runs

    assert trial.record().state == "finished"
    assert actors[0].given_back
    assert trial._ray.asked == [{"num_cpus": 2, "num_gpus": 0.5}]


def test_what_hinders_a_start_on_the_node_is_raised_here(trial, actors):
    trial.start(Limits())
    actors[0].answers = [NodeAnswer(error=TrainedElsewhere("far trains it.", remedy="Wait."))]

    assert not trial.runs
    with pytest.raises(TrainedElsewhere):
        trial.record()

    trial.start(Limits())
    assert trial.record() is None


def test_an_interruption_lets_it_save_or_gives_up_waiting_for_a_node(trial, actors):
    trial.start(Limits())
    trial.interrupt()
    assert not trial.runs
    assert actors[0].given_back

    trial.start(Limits())
    actors[1].answers = [NodeAnswer(record("running"), alive=True)]
    assert trial.runs
    trial.interrupt()

    assert (actors[1].stops, actors[1].given_back) == (1, False)
    assert trial.runs  # until it has saved


def test_a_training_whose_node_is_lost_counts_as_interrupted_but_not_forever(trial, actors):
    for _ in range(MOST_LOST):
        trial.start(Limits())
        actors[-1].answers = [NodeAnswer(record("running"), alive=True), NodeLost()]
        assert trial.runs
        assert not trial.runs
        assert trial.record().state == "interrupted"

    trial.start(Limits())
    actors[-1].answers = [NodeLost()]
    assert not trial.runs
    with pytest.raises(SettingsError, match="lost again and again"):
        trial.record()


@pytest.mark.parametrize("error", [BudgetUsedUp, SettingsError, TrainedElsewhere])
def test_an_error_comes_whole_from_another_process(error):
    found = pickle.loads(pickle.dumps(error("It is so.", remedy="Do it.")))

    assert (type(found), str(found), found.remedy) == (error, "It is so.", "Do it.")


def task(folder, **values):
    given = {"directory": folder, "host": socket.gethostname(), "files": {}}
    return TrialTask(
        **{"trial": TRIAL, "limits": Limits(), "environment": {}, "secrets": {}, **given, **values}
    )


def test_a_node_starts_it_once_and_tells_how_it_is(tmp_path, monkeypatch):
    starts = []
    run = SimpleNamespace(
        runs=False, start=starts.append, record=lambda: record("finished"), interrupt=starts.clear
    )
    monkeypatch.setattr(ray_trials, "open_on_node", lambda task: run)
    node = NodeTrial(task(tmp_path))

    assert [node.look().record.state, node.look().alive] == ["finished", False]
    assert len(starts) == 1


def test_a_node_does_not_start_what_an_earlier_sweep_left_running(tmp_path, monkeypatch):
    run = SimpleNamespace(runs=True, record=lambda: None)
    monkeypatch.setattr(ray_trials, "open_on_node", lambda task: run)

    assert NodeTrial(task(tmp_path)).look().error is None


def test_a_node_tells_why_it_cannot_start(tmp_path, monkeypatch):
    broken = SettingsError("The reward function is broken.", remedy="Mend it.")

    def refuse(_task):
        raise broken

    monkeypatch.setattr(ray_trials, "open_on_node", refuse)

    assert NodeTrial(task(tmp_path)).look() == NodeAnswer(error=broken)


def test_another_machine_gets_its_own_copy_of_the_folder(tmp_path):
    folder = tmp_path / "racer"
    for name in ("s-01", "s-02"):
        custom = folder / "experiments" / name / "custom_files"
        custom.mkdir(parents=True)
        (custom / "hyperparameters.json").write_text("{}")
    (folder / "system.env").write_text("DR_CLOUD=aws\n")
    (folder / "data").mkdir()
    far = task(folder, host="far", files=files_for_nodes(folder, "s-01"))

    there = folder_on_node(far, tmp_path / "cache")

    files = {str(path.relative_to(there)) for path in there.rglob("*") if path.is_file()}
    assert files == {"system.env", "experiments/s-01/custom_files/hyperparameters.json"}
    assert folder_on_node(task(folder), tmp_path / "cache") == folder


@pytest.mark.parametrize(("parallel", "room", "asked"), [(None, 3, 6), (2, 2, 2)])
def test_a_sweep_takes_the_room_there_is_and_asks_for_the_rest(
    tmp_path, monkeypatch, parallel, room, asked
):
    wanted = []
    sdk = SimpleNamespace(request_resources=lambda bundles: wanted.extend(bundles))
    monkeypatch.setattr(ray_trials, "autoscaler", sdk)
    ray = PaperRay({"CPU": 4.0}, {"CPU": 3.0})

    nodes = RayNodes(
        ray, tmp_path, MemoryBucket(), threads=0, parallel=parallel, trials=6, say=print
    )

    assert nodes.room() == room
    assert wanted == [{"CPU": 2}] * asked


@pytest.mark.parametrize(
    ("nodes", "threads", "parallel", "found"),
    [
        ([{"CPU": 2}], 0, None, (2, 0.0)),
        ([{"CPU": 2}], 0, 2, (1, 0.0)),
        ([{"CPU": 1}], 0, None, (1, 0.0)),
        ([{"CPU": 1}, {"CPU": 1}, {"CPU": 1}], 0, None, (1, 0.0)),
        ([{}], 0, None, (2, 0.0)),
        ([{}, {"CPU": 64}], 4, None, (4, 0.0)),
        ([{"CPU": 16, "GPU": 1}], 0, None, (2, 0.125)),
        ([{"CPU": 8, "GPU": 4}, {"CPU": 8, "GPU": 4}], 0, 4, (2, 1.0)),
    ],
)
def test_a_training_gets_two_cores_of_a_node_and_its_share_of_the_gpus(
    nodes, threads, parallel, found
):
    place = place_for(nodes, threads, parallel)

    assert (place.cpus, place.gpus) == found
