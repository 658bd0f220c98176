"""The figures of this machine."""

import os
import subprocess
import threading

import pytest

from drcli.web import run_topics
from drcli.web.run_topics import ProcessorMeter, look


def test_figures_are_those_of_this_machine(tmp_path):
    machine = look(tmp_path, ProcessorMeter())

    assert machine.cores >= 1
    assert 0 < machine.memory_used_bytes < machine.memory_bytes
    assert 0 < machine.disk_used_bytes <= machine.disk_bytes
    assert 0.0 <= machine.processor_percent <= 100.0


@pytest.mark.parametrize(
    ("said", "found"),
    [
        ("NVIDIA H100, 35, 81559, 1024\n", [("NVIDIA H100", 35.0, 81559 << 20, 1024 << 20)]),
        ("Tesla T4, [N/A], 15360, 0\n", [("Tesla T4", None, 15360 << 20, 0.0)]),
        ("a, 1, 2, 3\nb, 4, 5, 6\n", [("a", 1.0, 2 << 20, 3 << 20), ("b", 4.0, 5 << 20, 6 << 20)]),
        ("", []),
        ("No devices were found\n", []),
    ],
)
def test_graphics_processors_are_read_from_their_program(monkeypatch, tmp_path, said, found):
    done = subprocess.CompletedProcess([], 0, said)
    monkeypatch.setattr(run_topics.shutil, "which", lambda _: "/usr/bin/nvidia-smi")
    monkeypatch.setattr(run_topics.subprocess, "run", lambda *_, **__: done)

    gpus = look(tmp_path, ProcessorMeter()).gpus

    assert [(g.name, g.percent, g.memory_bytes, g.memory_used_bytes) for g in gpus] == found


@pytest.mark.parametrize("error", [OSError(), subprocess.TimeoutExpired("nvidia-smi", 5.0)])
def test_a_driver_that_does_not_answer_is_no_error(monkeypatch, tmp_path, error):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(run_topics.shutil, "which", lambda _: "/usr/bin/nvidia-smi")
    monkeypatch.setattr(run_topics.subprocess, "run", fail)

    assert look(tmp_path, ProcessorMeter()).gpus == []


def test_the_processor_is_measured_from_look_to_look_in_whatever_thread(tmp_path):
    processor, percents = ProcessorMeter(), []

    def read():
        percents.append(look(tmp_path, processor).processor_percent)

    for _ in range(2):
        begin_s = os.times().user
        while os.times().user - begin_s < 0.1:
            pass
        thread = threading.Thread(target=read)
        thread.start()
        thread.join()

    assert all(0.0 < percent <= 100.0 for percent in percents)
