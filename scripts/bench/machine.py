"""Says on which machine a benchmark ran."""

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from drcli.model.run_metadata import processor_name

UNITS = ("amx_bf16", "avx512_bf16", "avx512f", "avx2", "asimd")
"""Instructions that decide speed, as Linux names them."""


def facts() -> dict[str, Any]:
    """Processor, its family and model, its units, cores that may be used, and memory in GB."""
    known: dict[str, str] = {}
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines():
            name, _, value = line.partition(":")
            known.setdefault(name.strip(), value.strip())
    flags = set((known.get("flags") or known.get("Features") or "").split())
    usable = getattr(os, "sched_getaffinity", None)
    return {
        "processor": processor_name(),
        "family": known.get("cpu family"),
        "model": known.get("model"),
        "units": [unit for unit in UNITS if unit in flags],
        "cores": len(usable(0)) if usable is not None else os.cpu_count(),
        "threads": os.environ.get("OMP_NUM_THREADS"),
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "load_average": [round(load, 2) for load in os.getloadavg()],
    }


def print_json(figures: dict[str, Any], *, indent: int | None = None) -> None:
    """Print figures as one JSON object, with the `machine` that they were measured on."""
    print(json.dumps(figures | {"machine": facts()}, indent=indent), flush=True)
