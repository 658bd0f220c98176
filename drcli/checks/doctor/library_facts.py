"""Prints what torch and mujoco say here: `python -m ... PRECISION BATCH THREADS`.

`dr doctor` runs it as a process: loading them takes seconds and may fail in ways that no
program survives.
"""

import json
import os
import sys
from typing import Any

from drcli.base.installation import import_error, lazy_imports

with lazy_imports():
    import mujoco
    import torch

    from drcli.learn import compute as learn_compute


def library_facts(precision: str, batch_size: int, threads: int) -> dict[str, Any]:
    os.environ.setdefault("MUJOCO_GL", "disable")  # otherwise mujoco looks for OpenGL

    facts: dict[str, Any] = {
        "torch": torch.__version__,
        "mujoco": mujoco.__version__,
        "cuda_version": torch.version.cuda,
        "cuda": False,
        "cuda_error": "",
    }
    if torch.version.cuda is not None:
        try:
            # Unlike `is_available`, this raises an error with the reason. The type is ignored
            # because torch has no type for it.
            torch.cuda.init()  # type: ignore[no-untyped-call]
            facts["cuda"] = torch.cuda.is_available()
            # A GPU that torch has no code for fails here.
            torch.zeros(8, device="cuda").sum().item()
        except Exception as error:
            facts |= {"cuda": False, "cuda_error": str(error).partition("\n")[0]}
            os.environ["CUDA_VISIBLE_DEVICES"] = ""
    compute = learn_compute.choose_compute(precision, batch_size, threads)
    facts |= {"number_format": compute.number_format, "reason": compute.reason}
    return facts


if __name__ == "__main__":
    try:
        answer = library_facts(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
    except ImportError as error:
        broken = import_error(error)
        if broken is None:
            raise
        answer = {"error": str(broken), "remedy": broken.remedy}
    sys.stdout.write(json.dumps(answer))
    sys.stdout.flush()
    os._exit(0)  # the end of torch's threads takes longer than the answer
