"""Examines cloud, spot instance, container, limits, locale and time zone."""

import locale
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from zoneinfo import TZPATH

import psutil

from drcli.base.confinement import FREEDOMS, offered
from drcli.base.errors import DrError
from drcli.base.memory import ROOT, group_limits
from drcli.base.system_calls import Limit, soft_limit
from drcli.checks.doctor.findings import Finding, State, shown_bytes
from drcli.checks.machine_rules import LEAST_DISK_BYTES, TRAINER_BYTES, WORKER_BYTES
from drcli.clouds.providers.microsoft import AZURE_ASSET_TAG
from drcli.clouds.registry import CLOUDS
from drcli.config.adoption import winning_functions
from drcli.drive.reward_access import freedoms_told

LEAST_OPEN_FILES = 512
"""A supervisor with ten workers has about a hundred."""

LEAST_PROCESSES = 512
"""Threads count too; each process has some dozens."""

_ROOT = Path("/")
_DMI = ("sys_vendor", "product_name", "bios_vendor", "board_vendor", "chassis_asset_tag")
_HYPERVISORS = {
    "qemu": "QEMU",
    "vmware": "VMware",
    "innotek": "VirtualBox",
    "parallels": "Parallels",
    "xen": "Xen",
    "microsoft corporation": "Hyper-V",
    "openstack": "OpenStack",
}
_HOSTERS = {
    "alibaba": "Alibaba Cloud",
    "digitalocean": "DigitalOcean",
    "hetzner": "Hetzner",
    "oraclecloud": "Oracle Cloud",
    "scaleway": "Scaleway",
    "vultr": "Vultr",
    "linode": "Linode",
}
_CLOUDS = {"Amazon EC2": "aws", "Google Cloud": "gcp", "Azure": "azure"}


@dataclass(frozen=True)
class Place:
    """Where this process runs; texts are empty if unknown."""

    cloud: str
    kind: str
    layers: tuple[str, ...]


def where_it_runs(environ: Mapping[str, str], root: Path = _ROOT) -> Place:
    """From files and variables, without the network."""
    dmi = {name: _text(root / "sys/class/dmi/id" / name) for name in _DMI}
    every = " ".join(dmi.values()).casefold()
    layers = tuple(_layers(environ, root))
    if "amazon ec2" in every or _text(root / "sys/hypervisor/uuid").startswith("ec2"):
        return Place("Amazon EC2", dmi["product_name"], layers)
    if dmi["product_name"] == "Google Compute Engine" or dmi["sys_vendor"] == "Google":
        return Place("Google Cloud", "", layers)
    if dmi["chassis_asset_tag"] == AZURE_ASSET_TAG:
        return Place("Azure", "", layers)
    cloud = next((name for word, name in _HOSTERS.items() if word in every), "")
    kind = next((name for word, name in _HYPERVISORS.items() if word in every), "")
    return Place(cloud, kind, layers)


def examine_place(environ: Mapping[str, str], root: Path = _ROOT) -> Iterator[Finding]:
    place = where_it_runs(environ, root)
    spot = is_spot(place.cloud, environ) if place.cloud in _CLOUDS else None
    name = f"{place.cloud} {place.kind}".strip() or "no cloud recognised"
    parts = [name, *place.layers]
    if spot is not None:
        parts[0] += ", a spot instance" if spot else ", not a spot instance"
    facts = {"cloud": place.cloud, "kind": place.kind, "layers": list(place.layers), "spot": spot}
    yield Finding("place", "ok", "; ".join(parts), facts=facts)


def is_spot(cloud: str, environ: Mapping[str, str]) -> bool | None:
    """Whether the machine may be taken away, if its cloud says it."""
    with suppress(DrError):
        source = CLOUDS[_CLOUDS[cloud]].source(environ, "")
        return None if source is None else source.is_spot()
    return None


def examine_confinement() -> Iterator[Finding]:
    left = set(FREEDOMS) - offered()
    text = freedoms_told(left) or "reads no keys, opens no sockets, sends no signals to others"
    yield Finding("reward", "ok", text, facts={"free": sorted(left)})


def examine_shell(directory: Path, environ: Mapping[str, str]) -> Iterator[Finding]:
    found = [*winning_functions(directory, environ)]
    for each in found:
        facts = {"file": each.file, "line": each.line}
        yield Finding("shell", "warning", str(each), each.remedy, facts)
    if not found:
        yield Finding("shell", "ok", "no functions of DeepRacer-for-Cloud", facts={"file": ""})


def examine_limits(root: Path = _ROOT) -> list[Finding]:
    files = soft_limit("open_files")
    threads = _threads(root)
    facts = {"open_files": files, "processes": threads}
    wrong: list[tuple[str, str]] = []
    if files is not None and files < LEAST_OPEN_FILES:
        text = f"this shell allows only {files:,} open files."
        wrong.append((text, "Run `ulimit -n 4096` before the start."))
    if threads is not None and threads < LEAST_PROCESSES:
        text = f"only {threads:,} processes and threads are allowed here."
        remedy = "Raise `ulimit -u`, or the limit of the container (`--pids-limit`)."
        wrong.append((text, remedy))
    others: tuple[tuple[str, Limit, str], ...] = (
        ("memory of a process", "memory", "-v"),
        ("size of a file", "file_size", "-f"),
    )
    for name, limit, option in others:
        if soft_limit(limit) is not None:
            text = f"the {name} is limited, which may end a training."
            wrong.append((text, f"Run `ulimit {option} unlimited`."))
    count = "any number of" if files is None else f"{files:,}"
    fine = Finding("limits", "ok", f"{count} open files", facts=facts)
    return [Finding("limits", "warning", *each, facts) for each in wrong] or [fine]


def examine_language(environ: Mapping[str, str]) -> list[Finding]:
    wrong: list[tuple[State, str, str]] = []
    name = next((environ[key] for key in ("LC_ALL", "LC_CTYPE", "LANG") if environ.get(key)), "C")
    encoding = locale.getencoding()
    zone = environ.get("TZ", "")
    facts = {"locale": name, "encoding": encoding, "time_zone": time.strftime("%Z")}
    if encoding.casefold().replace("-", "") != "utf8":
        text = f"the character set of {name} is {encoding}, not UTF-8; some characters are lost."
        wrong.append(("warning", text, "Set LANG=C.UTF-8."))
    if zone and not _is_zone(zone):
        text = f"TZ={zone} is not a time zone of this machine; times are shown in UTC."
        wrong.append(("warning", text, "Correct TZ, or install tzdata."))
    if time.time() < 1_735_689_600:  # 2025
        text = f"the clock of this machine says {time.strftime('%Y-%m-%d')}."
        wrong.append(("problem", text, "Set it: `sudo timedatectl set-ntp true`."))
    fine = Finding("locale", "ok", f"{name}; time zone {facts['time_zone']}", facts=facts)
    return [Finding("locale", *each, facts) for each in wrong] or [fine]


def _layers(environ: Mapping[str, str], root: Path) -> Iterator[str]:
    if environ.get("KUBERNETES_SERVICE_HOST"):
        yield "in Kubernetes"
    elif (root / ".dockerenv").exists():
        yield "in a Docker container"
    elif (root / "run/.containerenv").exists():
        yield "in a Podman container"
    elif environ.get("container"):
        yield f"in a container ({environ['container']})"
    if environ.get("SLURM_JOB_ID"):
        yield "in a Slurm job"
    if environ.get("SKYPILOT_TASK_ID"):
        yield "in a SkyPilot job"
    if environ.get("INVOCATION_ID"):
        yield "in a systemd service"
    if "microsoft" in _text(root / "proc/sys/kernel/osrelease").casefold():
        yield "in WSL"


def _threads(root: Path) -> int | None:
    limits = []
    if os.getuid() != 0:  # root may have any number
        soft = soft_limit("processes")
        limits += [] if soft is None else [soft]
    for file in ("sys/fs/cgroup/pids.max", "sys/fs/cgroup/pids/pids.max"):
        text = _text(root / file)
        limits += [int(text)] if text.isdigit() else []
    return min(limits, default=None)


def _is_zone(zone: str) -> bool:
    name = zone.removeprefix(":")
    if any(character.isdigit() or character in ",<" for character in name):
        return True  # such as CET-1CEST
    return any((Path(folder) / name).is_file() for folder in ("/", *TZPATH))


def _text(file: Path) -> str:
    try:
        return file.read_text("utf-8", "replace").strip()
    except OSError:
        return ""


# Examines memory and disks.


LEAST_INODES = 10_000
"""A long training has some thousands of files."""

LEAST_TEMPORARY_BYTES = 200_000_000
SLOW_DISK_MB_S = 10.0
_TEST_BYTES = 32 << 20
_CHUNK_BYTES = 1 << 20
_TEST_S = 0.8

_NETWORK = ("nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "ceph", "lustre", "glusterfs", "gpfs")
_IN_MEMORY = ("tmpfs", "ramfs")


@dataclass(frozen=True)
class Memory:
    """Bytes; `limit` is that of the container."""

    total: int
    free: int
    swap: int
    limit: int | None


def read_memory(root: Path = ROOT) -> Memory:
    """Of the machine, or less in a container."""
    machine = psutil.virtual_memory()
    total, free = machine.total, machine.available
    limit = None
    for allowed, used in group_limits(root):
        limit = allowed if limit is None else min(limit, allowed)
        free = min(free, max(0, allowed - (used or 0)))
    if limit is not None and limit < total:
        return Memory(limit, free, psutil.swap_memory().total, limit)
    return Memory(total, free, psutil.swap_memory().total, None)


def examine_memory(workers: int, root: Path = ROOT) -> Iterator[Finding]:
    memory = read_memory(root)
    needed = workers * WORKER_BYTES + TRAINER_BYTES
    text = f"{shown_bytes(memory.free)} of {shown_bytes(memory.total)} free"
    if memory.limit is not None:
        text += " (the limit of this container or service)"
    facts = {
        "total_bytes": memory.total,
        "free_bytes": memory.free,
        "limit_bytes": memory.limit,
        "swap_bytes": memory.swap,
        "needed_bytes": needed,
    }
    if memory.free >= needed:
        yield Finding("memory", "ok", text, facts=facts)
        return
    text += f"; a training with DR_WORKERS={workers} takes about {shown_bytes(needed)}."
    remedy = "End other programs, lower DR_WORKERS, or give the container more memory."
    hopeless = memory.total < needed
    yield Finding("memory", "problem" if hopeless else "warning", text, remedy, facts)


def examine_disks(directory: Path, data_dir: Path | None, root: Path = ROOT) -> Iterator[Finding]:
    seen: set[int] = set()
    for folder in dict.fromkeys((directory, data_dir or directory)):
        place = _existing(folder)
        if place is not None and place.stat().st_dev not in seen:
            seen.add(place.stat().st_dev)
            yield _disk(place, folder, local_bucket=data_dir is not None, root=root)
    yield from _temporary()


def file_system(place: Path, root: Path = ROOT) -> str:
    """Such as `ext4`."""
    kind, longest = "", -1
    try:
        lines = (root / "proc/self/mountinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        return ""
    resolved = PurePosixPath(os.path.realpath(place))
    for line in lines:
        before, _, after = line.partition(" - ")
        words = before.split()
        if len(words) < 5 or not after:
            continue
        mounted = words[4].encode("latin-1", "replace").decode("unicode_escape")
        if resolved.is_relative_to(mounted) and len(mounted) >= longest:
            kind, longest = after.split()[0], len(mounted)
    return kind


def _disk(place: Path, folder: Path, *, local_bucket: bool, root: Path) -> Finding:
    space = os.statvfs(place)
    free, total = space.f_bavail * space.f_frsize, space.f_blocks * space.f_frsize
    inodes = space.f_favail if space.f_files else None
    kind = file_system(place, root)
    writable = os.access(place, os.W_OK | os.X_OK) and not space.f_flag & os.ST_RDONLY
    speed = _write_speed_mb_s(place) if writable and free > 2 * _TEST_BYTES else None
    facts = {
        "folder": str(folder),
        "file_system": kind,
        "free_bytes": free,
        "total_bytes": total,
        "free_files": inodes,
        "write_mb_s": speed,
        "writable": writable,
    }
    text = f"{shown_bytes(free)} of {shown_bytes(total)} free"
    text += f" ({kind})" if kind else ""
    text += f", writes {speed:,.0f} MB/s" if speed is not None else ""
    text += f": {folder}"

    def found(state: State, reason: str, remedy: str) -> Finding:
        return Finding("disk", state, f"{text}; {reason}.", remedy, facts)

    elsewhere = "Use a folder on a local disk, or keep the bucket elsewhere (DR_CLOUD)."
    if not writable:
        return found("problem", "nothing can be written there", "Use a folder of your own.")
    if free < LEAST_DISK_BYTES:
        needed = shown_bytes(LEAST_DISK_BYTES)
        remedy = "Delete models or logs, or use a larger disk (DR_S3_DATA_DIR)."
        return found("warning", f"a training may need {needed}", remedy)
    if inodes is not None and inodes < LEAST_INODES:
        reason = f"only {inodes:,} more files can be created (inodes)"
        return found("warning", reason, "Delete folders with many small files.")
    if kind in _NETWORK or kind.startswith("fuse."):
        return found("warning", "it is a file system over a network or in a program", elsewhere)
    if kind in _IN_MEMORY and local_bucket:
        return found("warning", "it is in memory, and empty after a restart", elsewhere)
    if kind == "overlay" and local_bucket:
        remedy = "Mount a volume there, or keep the bucket elsewhere (DR_CLOUD)."
        return found("warning", "it is deleted with the container", remedy)
    if speed is not None and speed < SLOW_DISK_MB_S:
        return found("warning", "that is slow", elsewhere)
    return Finding("disk", "ok", text, facts=facts)


def _write_speed_mb_s(folder: Path) -> float | None:
    """By a file that has no name."""
    block = os.urandom(_CHUNK_BYTES)
    written = 0
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            began_s = time.monotonic()
            while written < _TEST_BYTES and time.monotonic() - began_s < _TEST_S:
                file.write(block)
                written += len(block)
            file.flush()
            os.fsync(file.fileno())
            return written / 1e6 / max(1e-6, time.monotonic() - began_s)
    except OSError:
        return None


def _temporary() -> Iterator[Finding]:
    try:
        folder = Path(tempfile.gettempdir())
        free = os.statvfs(folder).f_bavail * os.statvfs(folder).f_frsize
    except OSError as error:
        text = f"there is no folder for temporary files ({error.strerror or error})."
        yield Finding("disk", "problem", text, "Set TMPDIR to a folder that you can write.")
        return
    if free < LEAST_TEMPORARY_BYTES:
        text = f"only {shown_bytes(free)} are free for temporary files in {folder}."
        yield Finding("disk", "warning", text, "Make room there, or set TMPDIR.")


def _existing(folder: Path) -> Path | None:
    return next((each for each in (folder, *folder.parents) if each.is_dir()), None)
