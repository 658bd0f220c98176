"""`python scripts/bench` lists the benchmarks and runs them, also under their former names."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def printed(*arguments: str | Path) -> str:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_each_former_name_is_listed_in_the_help():
    shown = printed(SCRIPTS / "bench", "--help")

    names = {path.stem.removeprefix("bench_") for path in SCRIPTS.glob("bench_*.py")}
    assert names <= {line.split()[0] for line in shown.splitlines() if line.strip()}


def test_a_former_name_has_the_same_options():
    assert printed(SCRIPTS / "bench_startup.py", "--help") == printed(
        SCRIPTS / "bench", "startup", "--help"
    )


def test_an_unknown_benchmark_is_refused_with_the_known_ones():
    done = subprocess.run(
        [sys.executable, SCRIPTS / "bench", "nonsense"], capture_output=True, text=True
    )

    assert done.returncode == 1
    assert "'nonsense' is not a benchmark. Names: analyze, sim, learn," in done.stderr


def test_figures_come_with_the_machine_that_they_were_measured_on(capsys):
    importlib.import_module("machine").print_json({"steps_per_s": 3})

    told = json.loads(capsys.readouterr().out)
    assert told["steps_per_s"] == 3
    assert told["machine"]["processor"]
    assert told["machine"]["cores"] >= 1
    assert told["machine"]["memory_gb"] > 0
