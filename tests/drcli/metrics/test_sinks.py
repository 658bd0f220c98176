"""What each tool receives: lines, files, answers and requests."""

import json
import resource
import signal
import socket
import threading
import time
import urllib.request
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from drcli.metrics.figure_events import Ended, EpisodePoint, EpochPoint, Point, TrainingFacts
from drcli.metrics.prometheus_text import (
    FigureFile,
    FigureServer,
    InfluxLines,
    NewestFigures,
    line_of,
)
from drcli.metrics.servers import MlflowRun, ServerError

FACTS = TrainingFacts("team/model-1", 3, 500, {"hyperparameters": '{"lr": 0.001}'})
LEARNED = Point(1000, 20.5, {"losses/entropy": 1.25, "charts/episodic_return": 7.0})
SCORED = Point(900, 21.0, {"evaluation/progress": 88.0}, is_evaluation=True)
EPISODE = EpisodePoint(1.5, "training", "Off track", 2, 17, 63, 4120)


def test_the_lines_are_those_of_the_grafana_board():
    trial = EpisodePoint(2.0, "evaluation", "Lap complete", 0, 0, 100, 14000, resets=1)

    assert line_of(EPISODE, "team/model-1") == (
        r"dr_training_episodes,model=team/model-1,phase=training,status=Off\ track,worker=2 "
        "elapsed_time=4120i,progress=63i,reward=17i 1500000000"
    )
    assert line_of(trial, "team/model-1") == (
        r"dr_eval_episodes,model=team/model-1,status=Lap\ complete,worker=0 "
        "elapsed_time=14000i,progress=100i,reset_count=1i 2000000000"
    )
    assert line_of(EpochPoint(3.0, 0.5), "a,b=c d") == (
        r"dr_sagemaker_epochs,model=a\,b\=c\ d entropy=0.5 3000000000"
    )


def test_lines_arrive_as_datagrams_of_their_own():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(10.0)
        sink = InfluxLines("127.0.0.1", listener.getsockname()[1], "m")

        sink.send(EPISODE)
        sink.send(EpochPoint(3.0, 0.5))
        sink.close()

        assert listener.recv(2000).startswith(b"dr_training_episodes,")
        assert listener.recv(2000).startswith(b"dr_sagemaker_epochs,")


def test_nobody_has_to_listen_to_lines():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
    sink = InfluxLines("127.0.0.1", port, "m")

    for _ in range(3):
        sink.send(EPISODE)
    sink.close()


def test_a_host_without_an_address_is_an_error():
    with pytest.raises(OSError, match=r"."):
        InfluxLines("no-such-host.invalid", 8092, "m").send(EPISODE)


def lines(text):
    return dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))


LABELS = '{model="team/model-1",run_id="3"}'


def test_prometheus_reads_the_newest_value_of_each_figure():
    figures = NewestFigures(FACTS)
    figures.add(LEARNED)
    figures.add(SCORED)
    figures.add(Point(1100, 22.0, {"losses/entropy": 1.0}))

    found = lines(figures.text().decode())

    assert found == {
        f"deepracer_losses_entropy{LABELS}": "1.0",
        f"deepracer_evaluation_progress{LABELS}": "88.0",
        f"deepracer_steps{LABELS}": "1100.0",
        f"deepracer_training_running{LABELS}": "1.0",
        f"deepracer_updated_seconds{LABELS}": "22.0",
    }
    figures.add(Ended(30.0, finished=True))
    assert lines(figures.text().decode())[f"deepracer_training_running{LABELS}"] == "0.0"


def test_the_second_world_of_an_evaluation_stays_until_the_next_evaluation():
    figures = NewestFigures(FACTS)
    figures.add(
        Point(
            900, 21.0, {"evaluation_second/laps": 1.0, "evaluation/laps": 2.0}, is_evaluation=True
        )
    )
    figures.add(LEARNED)

    assert lines(figures.text().decode())[f"deepracer_evaluation_second_laps{LABELS}"] == "1.0"
    figures.add(Point(1900, 31.0, {"evaluation/laps": 3.0}, is_evaluation=True))
    assert f"deepracer_evaluation_second_laps{LABELS}" not in lines(figures.text().decode())


def test_the_file_for_node_exporter_is_replaced_at_once(tmp_path):
    sink = FigureFile(tmp_path, FACTS)
    sink.send(LEARNED)
    sink.close()

    [path] = tmp_path.iterdir()
    assert path.name == "deepracer-team_model-1.prom"
    assert lines(path.read_text())[f"deepracer_losses_entropy{LABELS}"] == "1.25"
    assert path.stat().st_mode & 0o004
    with pytest.raises(OSError, match=r"DR_PROMETHEUS_FOLDER=.*nowhere is not a folder"):
        FigureFile(tmp_path / "nowhere", FACTS)


def test_the_file_for_node_exporter_gets_the_end_that_it_missed(tmp_path):
    sink = FigureFile(tmp_path, FACTS)
    assert sink.miss(Ended(30.0, finished=True))

    sink.close()

    [path] = tmp_path.iterdir()
    assert lines(path.read_text())[f"deepracer_training_running{LABELS}"] == "0.0"


def test_the_server_answers_until_it_is_closed():
    sink = FigureServer("127.0.0.1", 0, FACTS)
    try:
        sink.send(LEARNED)
        with urllib.request.urlopen(f"http://127.0.0.1:{sink.port}/metrics", timeout=10) as answer:
            assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
            assert f"deepracer_losses_entropy{LABELS} 1.25\n" in answer.read().decode()
        with pytest.raises(OSError, match="nothing can listen on"):
            FigureServer("127.0.0.1", sink.port, FACTS)
    finally:
        sink.close()


def test_the_server_listens_on_an_address_of_ipv6_too():
    try:
        sink = FigureServer("::1", 0, FACTS)
    except OSError:
        pytest.skip("this machine has no IPv6")
    try:
        with urllib.request.urlopen(f"http://[::1]:{sink.port}/metrics", timeout=10) as answer:
            assert answer.status == 200
    finally:
        sink.close()


class Server(ThreadingHTTPServer):
    """Answers as an MLflow server does, and keeps what it was asked."""

    daemon_threads = True

    def __init__(self):
        self.asked, self.headers, self.earlier, self.broken = [], [], [], False
        self.latest = []
        self.loses_answer = False
        super().__init__(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.serve_forever, args=(0.02,), daemon=True).start()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_address[1]}"

    def sent(self, what):
        return [fields for name, fields in self.asked if name == what]


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        what = self.path.partition("?")[0].removeprefix("/api/2.0/mlflow/")
        length = int(self.headers.get("Content-Length") or 0)
        fields = json.loads(self.rfile.read(length) or b"{}")
        self.server.asked.append((what, fields))
        self.server.headers.append(self.headers.get("Authorization"))
        code, answer = 200, {}
        if self.server.broken:
            code, answer = 500, {"message": "the disk is full"}
        elif what == "experiments/get-by-name":
            code, answer = 404, {"error_code": "RESOURCE_DOES_NOT_EXIST", "message": "no"}
        elif what == "experiments/create":
            answer = {"experiment_id": "7"}
        elif what == "runs/search":
            data = {"metrics": self.server.latest}
            runs = [{"info": {"run_id": name}, "data": data} for name in self.server.earlier]
            answer = {"runs": runs}
        elif what == "runs/create":
            answer = {"run": {"info": {"run_id": "new"}}}
            if self.server.loses_answer:
                self.server.earlier = ["new"]
                self.close_connection = True
                return
        data = json.dumps(answer).encode()
        self.send_response(code)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    do_POST = do_GET  # noqa: N815  names of http.server

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    made = Server()
    yield made
    made.shutdown()
    made.server_close()


def test_mlflow_gets_a_run_with_parameters_numbers_and_an_end(server, monkeypatch):
    monkeypatch.setenv("MLFLOW_TRACKING_TOKEN", "abc")
    fresh = TrainingFacts("team/model-1", 3)
    sink = MlflowRun(server.url + "/", "cars", fresh, {"lr": "0.001"})

    for event in (LEARNED, SCORED, Ended(30.0, finished=False)):
        sink.send(event)
    sink.close()

    [created] = server.sent("runs/create")
    assert created["experiment_id"] == "7"
    assert {"key": "drcli.model", "value": "team/model-1"} in created["tags"]
    params, *batches = server.sent("runs/log-batch")
    assert params["params"] == [{"key": "lr", "value": "0.001"}]
    numbers = [each for batch in batches for each in batch["metrics"]]
    assert {"key": "losses/entropy", "value": 1.25, "timestamp": 20500, "step": 1000} in numbers
    assert {each["key"] for each in numbers} == {*LEARNED.values, *SCORED.values}
    assert server.sent("runs/update")[-1]["status"] == "KILLED"
    assert set(server.headers) == {"Bearer abc"}
    assert server.sent("runs/search") == []


def test_a_continued_training_continues_its_run(server):
    server.earlier = ["old"]
    sink = MlflowRun(server.url, "cars", FACTS, {})

    sink.send(LEARNED)
    sink.close()

    assert server.sent("runs/create") == []
    assert server.sent("runs/log-batch")[-1]["run_id"] == "old"


def test_a_training_that_gave_figures_up_gets_a_run_without_them(server):
    server.earlier = ["old"]
    server.latest = [{"key": "losses/entropy", "value": 9.0, "step": FACTS.first_step + 1}]
    kept = replace(LEARNED, step=FACTS.first_step)
    sink = MlflowRun(server.url, "cars", FACTS, {"lr": "0.001"}, [kept])

    sink.send(SCORED)
    sink.close()

    assert server.sent("runs/update")[0] | {"end_time": 0} == {
        "run_id": "old",
        "status": "KILLED",
        "end_time": 0,
    }
    assert len(server.sent("runs/create")) == 1
    params, *batches = server.sent("runs/log-batch")
    assert (params["run_id"], params["params"]) == ("new", [{"key": "lr", "value": "0.001"}])
    numbers = [each for batch in batches for each in batch["metrics"]]
    assert {each["key"] for each in numbers} == {*LEARNED.values, *SCORED.values}


def test_a_run_whose_making_was_not_answered_is_not_made_twice(server):
    server.loses_answer = True
    sink = MlflowRun(server.url, "cars", TrainingFacts("team/model-1", 0), {"lr": "0.001"})
    with pytest.raises(ServerError, match=r"cannot be reached: it closed the connection\.$"):
        sink.send(LEARNED)
    server.loses_answer = False

    sink.close()

    [created] = server.sent("runs/create")
    tags = {tag["key"]: tag["value"] for tag in created["tags"]}
    assert (
        server.sent("runs/search")[0]["filter"] == f"tags.`drcli.start` = '{tags['drcli.start']}'"
    )
    assert {"run_id": "new", "params": [{"key": "lr", "value": "0.001"}]} in server.sent(
        "runs/log-batch"
    )


def test_numbers_wait_while_mlflow_is_away(server):
    sink = MlflowRun(server.url, "cars", TrainingFacts("m", 0), {})
    server.broken = True
    with pytest.raises(ServerError, match="the disk is full"):
        sink.send(LEARNED)
    assert server.sent("experiments/create") == []  # it may exist
    assert sink.miss(LEARNED)
    assert sink.miss(SCORED)
    server.broken = False

    sink.close()

    numbers = [each for batch in server.sent("runs/log-batch") for each in batch["metrics"]]
    assert sorted(each["key"] for each in numbers) == sorted([*LEARNED.values, *SCORED.values])


def test_another_program_behind_the_address_is_told(server):
    server.RequestHandlerClass = type("Other", (Handler,), {"do_GET": page, "do_POST": page})

    with pytest.raises(ServerError, match="it is no MLflow server"):
        MlflowRun(server.url, "cars", FACTS, {}).send(LEARNED)


def page(handler):
    handler.send_response(200)
    handler.send_header("Content-Length", "6")
    handler.end_headers()
    handler.wfile.write(b"<html>")


def test_event_files_have_cleanrls_names_and_no_steps_that_were_given_up(tmp_path):
    pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from drcli.metrics.event_file import EventFile

    folder = tmp_path / "team" / "model-1"
    begun = time.time()
    first = EventFile(folder, TrainingFacts("m", 0, 0, FACTS.texts), [])
    for step in (400, 800, 1200):
        first.send(Point(step, begun, {"losses/entropy": step / 1000.0}))
    first.close()
    again = EventFile(
        folder, TrainingFacts("m", 0, 800), [Point(1, begun, {"losses/entropy": 9.0})]
    )
    again.send(Point(1100, begun, {"losses/entropy": 5.0}))
    again.close()

    found = EventAccumulator(str(folder)).Reload()

    assert [(e.step, round(e.value, 3)) for e in found.Scalars("losses/entropy")] == [
        (400, 0.4),
        (800, 0.8),
        (1100, 5.0),
    ]
    assert b'{"lr": 0.001}' in found.Tensors("hyperparameters")[0].tensor_proto.string_val[0]


def test_event_files_of_a_folder_without_any_begin_with_the_iterations_before(tmp_path):
    pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from drcli.metrics.event_file import EventFile

    sink = EventFile(tmp_path, FACTS, [Point(400, 1.0, {"losses/entropy": 2.0})])
    sink.close()
    sink.send(LEARNED)  # after an error, it goes on in another file
    sink.close()

    found = EventAccumulator(str(tmp_path)).Reload()
    assert [e.step for e in found.Scalars("losses/entropy")] == [400, 1000]
    assert len(list(tmp_path.iterdir())) == 2


def test_event_files_of_a_new_start_replace_those_of_another_machine(tmp_path):
    pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from drcli.metrics.event_file import EventFile

    lost, here = tmp_path / "lost", tmp_path / "here"
    first = EventFile(lost, TrainingFacts("m", 0), [])
    for step in (400, 800, 1200):
        first.send(Point(step, 1.0, {"losses/entropy": 1.0}))
    first.close()
    earlier = [Point(step, 1.0, {"losses/entropy": 1.0}) for step in (400, 800)]
    EventFile(here, TrainingFacts("m", 0, 800), earlier).close()
    for path in lost.iterdir():
        path.rename(here / path.name)

    found = EventAccumulator(str(here)).Reload()

    assert [event.step for event in found.Scalars("losses/entropy")] == [400, 800]


def test_event_files_are_followed_by_others_before_they_are_large(tmp_path, monkeypatch):
    pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from drcli.metrics import event_file

    monkeypatch.setattr(event_file, "LARGEST_BYTES", 300)
    sink = event_file.EventFile(tmp_path, TrainingFacts("m", 0), [])
    for step in range(20):
        sink.send(Point(step, 1.0, {"losses/entropy": 1.0}))
    sink.close()

    assert len(list(tmp_path.iterdir())) > 2
    assert max(path.stat().st_size for path in tmp_path.iterdir()) < 400
    found = EventAccumulator(str(tmp_path)).Reload()
    assert [event.step for event in found.Scalars("losses/entropy")] == list(range(20))


def test_a_full_disk_leaves_no_heap_of_empty_event_files(tmp_path):
    pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")
    from drcli.metrics.event_file import EventFile

    sink = EventFile(tmp_path, TrainingFacts("m", 0), [])
    for _ in range(3):
        with pytest.raises(OSError, match="too large"), largest_file(8):
            sink.send(Point(1, 1.0, {"losses/entropy": 1.0}))
        with pytest.raises(OSError, match=r"too large.*other"), largest_file(8):
            EventFile(tmp_path / "other", TrainingFacts("m", 0), [])
    assert len(list(tmp_path.glob("events*"))) == 1
    assert list((tmp_path / "other").iterdir()) == []

    sink.send(LEARNED)
    sink.close()

    assert len(list(tmp_path.glob("events*"))) == 2


@contextmanager
def largest_file(size):
    """Let no file of this process grow beyond so many bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
