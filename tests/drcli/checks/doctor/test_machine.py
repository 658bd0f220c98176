"""What the doctor says about machines that the tests make up from the files of Linux."""

import json
import os
import shutil
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from drcli.checks.doctor import libraries, surroundings
from drcli.checks.doctor import surroundings as room
from drcli.checks.doctor.libraries import (
    Libraries,
    examine_extras,
    examine_gpus,
    examine_kernels,
    examine_packages,
    examine_processor,
)
from drcli.checks.doctor.surroundings import (
    examine_disks,
    examine_language,
    examine_limits,
    examine_memory,
    examine_place,
    file_system,
    read_memory,
    where_it_runs,
)

LOADED = Libraries({"cuda_version": "12.8", "cuda": True, "number_format": "fp32"})


@pytest.fixture
def machine(tmp_path):
    """The files of a machine below a folder."""

    def make(**files: str) -> Path:
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path

    return make


def dmi(**values: str) -> dict[str, str]:
    return {f"sys/class/dmi/id/{name}": f"{value}\n" for name, value in values.items()}


@pytest.mark.parametrize(
    ("files", "cloud"),
    [
        (dmi(sys_vendor="Amazon EC2", product_name="m7i.large"), "Amazon EC2"),
        ({"sys/hypervisor/uuid": "ec2e1916-9099-7caf-fd21-012345abcdef\n"}, "Amazon EC2"),
        (dmi(sys_vendor="Google", product_name="Google Compute Engine"), "Google Cloud"),
        (
            dmi(
                sys_vendor="Microsoft Corporation",
                chassis_asset_tag="7783-7084-3265-9085-8269-3286-77",
            ),
            "Azure",
        ),
        (dmi(sys_vendor="Microsoft Corporation", chassis_asset_tag="1"), ""),
        (dmi(sys_vendor="Hetzner", product_name="vServer"), "Hetzner"),
        (dmi(sys_vendor="LENOVO", product_name="20XW"), ""),
        ({}, ""),
    ],
)
def test_a_cloud_is_recognised_by_the_machines_own_files(machine, files, cloud):
    assert where_it_runs({}, machine(**files)).cloud == cloud


def test_containers_and_batch_systems_are_named(machine):
    place = where_it_runs({"SLURM_JOB_ID": "7"}, machine(**{".dockerenv": ""}))

    assert place.layers == ("in a Docker container", "in a Slurm job")


class Metadata(BaseHTTPRequestHandler):
    """EC2's service for instance metadata, which wants a token."""

    def do_PUT(self):
        self.answer(b"a-token")

    def do_GET(self):
        known = self.headers.get("X-aws-ec2-metadata-token") == "a-token"
        self.answer(b"spot" if known else b"unauthorized")

    def answer(self, body):
        self.server.asked.append(self.path)
        self.send_response(200)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def metadata():
    server = HTTPServer(("127.0.0.1", 0), Metadata)
    server.asked = []
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def test_on_amazon_the_machine_is_asked_whether_it_is_a_spot_instance(machine, metadata):
    root = machine(**dmi(sys_vendor="Amazon EC2", product_name="m7i.large"))
    address = f"http://127.0.0.1:{metadata.server_port}"

    [found] = examine_place({"AWS_EC2_METADATA_SERVICE_ENDPOINT": address}, root)

    assert found.text == "Amazon EC2 m7i.large, a spot instance"
    assert found.facts["spot"] is True


def test_elsewhere_no_network_is_asked(machine, metadata):
    address = f"http://127.0.0.1:{metadata.server_port}"

    [found] = examine_place({"AWS_EC2_METADATA_SERVICE_ENDPOINT": address}, machine())

    assert found.facts["spot"] is None
    assert metadata.asked == []


def test_a_containers_memory_limit_counts_without_its_cached_files(machine):
    root = machine(
        **{
            "proc/self/cgroup": "0::/\n",
            "sys/fs/cgroup/memory.max": "3000000000\n",
            "sys/fs/cgroup/memory.current": "2500000000\n",
            "sys/fs/cgroup/memory.stat": "anon 1\ninactive_file 1500000000\n",
        }
    )

    memory = read_memory(root)

    assert (memory.total, memory.limit) == (3_000_000_000, 3_000_000_000)
    assert memory.free == 2_000_000_000


def test_too_little_memory_is_a_problem_only_if_it_could_never_be_enough(machine):
    root = machine(**{"proc/self/cgroup": "0::/\n", "sys/fs/cgroup/memory.max": "2000000000\n"})

    [enough], [short] = examine_memory(1, root), examine_memory(4, root)

    assert (enough.state, short.state) == ("ok", "problem")
    assert "DR_WORKERS=4" in short.text


MOUNTS = (
    "22 1 8:1 / / rw shared:1 - {root} /dev/sda1 rw\n"
    "30 22 0:40 / /mnt/share rw shared:2 - nfs4 server:/x rw\n"
    "31 22 0:41 / /mnt/a\\040b rw - fuse.s3fs s3fs rw\n"
)


def test_the_longest_mount_point_decides_the_file_system(machine):
    root = machine(**{"proc/self/mountinfo": MOUNTS.format(root="ext4")})

    places = ("/home/x", "/mnt/share/data", "/mnt/shared", "/mnt/a b/c")
    kinds = [file_system(Path(place), root) for place in places]

    assert kinds == ["ext4", "nfs4", "ext4", "fuse.s3fs"]


@pytest.mark.parametrize(
    ("kind", "local", "words"),
    [
        ("ext4", True, None),
        ("nfs4", False, "over a network"),
        ("fuse.sshfs", True, "over a network"),
        ("overlay", True, "deleted with the container"),
        ("overlay", False, None),
        ("tmpfs", True, "in memory"),
    ],
)
def test_file_systems_that_surprise_are_named(machine, kind, local, words, monkeypatch):
    root = machine(**{"proc/self/mountinfo": MOUNTS.format(root=kind), "data/x": ""})
    monkeypatch.setattr(room, "LEAST_DISK_BYTES", 0)
    monkeypatch.setattr(room, "SLOW_DISK_MB_S", 0)
    monkeypatch.setattr(room, "_TEST_BYTES", 1 << 20)

    found = next(iter(examine_disks(root, root / "data" if local else None, root)))

    assert found.state == ("ok" if words is None else "warning")
    assert words is None or words in found.text
    assert [path.name for path in (root / "data").iterdir()] == ["x"]


def test_a_folder_that_cannot_be_written_is_a_problem(machine, monkeypatch):
    root = machine()
    monkeypatch.setattr(os, "access", lambda *_: False)

    found = next(iter(examine_disks(root, None)))

    assert found.state == "problem"
    assert "nothing can be written" in found.text


def test_small_limits_are_warnings(machine, monkeypatch):
    root = machine(**{"sys/fs/cgroup/pids.max": "100\n"})
    monkeypatch.setattr(surroundings, "soft_limit", lambda kind: 256)

    said = " ".join(found.text for found in examine_limits(root))

    for words in ("256 open files", "processes and threads", "memory of a process"):
        assert words in said


def test_character_set_and_time_zone_are_examined(monkeypatch):
    assert [found.state for found in examine_language({"LANG": "C.UTF-8"})] == ["ok"]
    monkeypatch.setattr(surroundings.locale, "getencoding", lambda: "ISO-8859-1")

    wrong = list(examine_language({"LC_ALL": "de_DE", "TZ": "Mars/Olympus"}))

    assert [found.state for found in wrong] == ["warning", "warning"]
    assert "ISO-8859-1" in wrong[0].text
    assert "Mars/Olympus" in wrong[1].text


@pytest.fixture
def smi(tmp_path, monkeypatch):
    """A program called nvidia-smi that answers so."""
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)

    def make(says: str, code: int = 0) -> None:
        program = tmp_path / "bin" / "nvidia-smi"
        program.parent.mkdir()
        program.write_text(f"#!/bin/sh\ncat <<'E'\n{says}\nE\nexit {code}\n")
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")

    return make


CARD = "0, GPU-1, NVIDIA H100 80GB HBM3, 570.86.15, 81559, 80000"


@pytest.mark.parametrize(
    ("says", "code", "said", "torch", "state", "words"),
    [
        (CARD, 0, LOADED, "2.13.0+cu128", "ok", "torch uses it (CUDA 12.8)"),
        (CARD, 0, Libraries({"cuda_version": None}), "2.13.0+cpu", "warning", "the CPU build"),
        (
            CARD,
            0,
            Libraries({"cuda_version": "13.0", "cuda": False, "cuda_error": "driver too old"}),
            "2.13.0",
            "problem",
            "cannot use it: driver too old",
        ),
        (CARD, 0, Libraries(error="torch cannot be loaded"), "2.13.0", "warning", "unknown"),
        (CARD.replace("80000", "300"), 0, LOADED, "2.13.0", "warning", "315 MB of its memory"),
        ("0, GPU-1, NVIDIA GB10, 580.1, [N/A], [N/A]", 0, LOADED, "2.13.0", "ok", "NVIDIA GB10"),
        ("Failed to initialize NVML: mismatch", 18, LOADED, "2.13.0", "problem", "mismatch"),
        ("", 0, LOADED, "2.13.0", "ok", "none"),
    ],
)
def test_a_gpu_is_described_with_what_keeps_torch_from_using_it(
    smi, tmp_path, says, code, said, torch, state, words
):
    smi(says, code)

    [found] = examine_gpus(said, torch, "", tmp_path)

    assert (found.state, words in found.text) == (state, True), found.text
    assert found.remedy or found.state == "ok" or "unknown" in found.text


def test_a_gpu_without_a_driver_is_found_on_the_bus(machine, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    device = "sys/bus/pci/devices/0000:17:00.0"
    root = machine(**{f"{device}/vendor": "0x10de\n", f"{device}/class": "0x030200\n"})

    [found] = examine_gpus(LOADED, "2.13.0", "", root)

    assert "driver is not installed" in found.text


def test_a_gpu_that_is_switched_off_is_not_examined(smi):
    smi("broken", 1)

    [found] = examine_gpus(LOADED, "2.13.0", "-1")

    assert found.state == "ok"
    assert "DR_SAGEMAKER_CUDA_DEVICES" in found.text


def test_a_processor_without_wide_units_is_a_warning(machine, monkeypatch):
    monkeypatch.setattr(libraries, "cores", lambda root: 2)
    root = machine(**{"proc/cpuinfo": "flags\t\t: fpu sse2 avx\n"})

    states = [found.state for found in examine_processor(root)]

    assert states == ["ok", *(["warning"] if "x86" in os.uname().machine else [])]


def test_the_trainers_format_is_named_and_a_library_that_fails_is_a_problem():
    [fine] = libraries.examine_trainer(LOADED)
    [broken] = libraries.examine_trainer(Libraries(error="torch ended with SIGILL.", remedy="Do."))
    [late] = libraries.examine_trainer(Libraries(error="not loaded", late=True))

    assert (fine.state, fine.text) == ("ok", "computes in fp32 on the GPU")
    assert [broken.state, late.state] == ["problem", "warning"]


def fake_python(tmp_path, script):
    program = tmp_path / "python"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    return str(program)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("kill -ILL $$", "ended with SIGILL"),
        ("echo 'ImportError: libgomp.so.1' >&2; exit 1", "libgomp.so.1"),
        ("exec sleep 60", "were not loaded"),
    ],
)
def test_libraries_that_cannot_be_loaded_are_an_error_and_no_crash(
    tmp_path, monkeypatch, script, words
):
    monkeypatch.setattr(sys, "executable", fake_python(tmp_path, script))
    monkeypatch.setattr(libraries, "PATIENCE_S", 0.5)

    said = libraries.ask_libraries(libraries.LearnerSettings())

    assert words in said.error
    assert said.remedy


def test_the_libraries_are_asked_without_secrets(tmp_path, monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "canary")
    script = f"env > {tmp_path}/env; echo '{json.dumps({'cuda': False})}'"
    monkeypatch.setattr(sys, "executable", fake_python(tmp_path, script))

    said = libraries.ask_libraries(libraries.LearnerSettings(gpus="-1"))

    environment = (tmp_path / "env").read_text()
    assert said.facts == {"cuda": False}
    assert "canary" not in environment
    assert "CUDA_VISIBLE_DEVICES=-1" in environment


def test_this_installation_is_complete():
    assert [found.state for found in examine_packages()] == ["ok"]
    [extras] = examine_extras()
    assert "onnx" in (*extras.facts["present"], *extras.facts["missing"])
    assert "dev" not in extras.facts["present"]


def test_where_compiled_functions_cannot_be_kept_that_is_a_warning(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert [found.state for found in examine_kernels()] == ["warning"]

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    assert [found.state for found in examine_kernels()] == ["ok"]
    assert not (tmp_path / "kernels").exists()
