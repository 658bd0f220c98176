"""Recognises that a worker failed because memory ran out, which is not a bug."""

import errno

from drcli.base.errors import WorkerDied
from drcli.exchange.job import WorkerExit
from drcli.workers.pulse import own_memory_bytes

REMEDY = (
    "Give the training more memory, end other programs, or lower DR_WORKERS, DR_TRAIN_LANES, "
    "DR_TRAIN_MAX_STEPS_PER_ITERATION or (with sac) sac_replay_steps; then continue with "
    "`dr-start-training --resume`."
)
_GPU_REMEDY = (
    "End other programs on the GPU, lower batch_size, or learn on the processor with "
    "DR_SAGEMAKER_CUDA_DEVICES=-1 in system.env; then continue with `dr-start-training --resume`."
)

_WORDS = ("allocate memory", "bad_alloc")
"""Of torch and C++ libraries."""

_SHOWN_CHARACTERS = 200


def memory_shortage(error: BaseException) -> WorkerExit | None:
    """The failure of a worker if memory ran out; else None.

    That of a GPU is not `memory`: fewer cars and workers would not help.
    """
    text = f"{type(error).__name__}: {' '.join(str(error).split())[:_SHOWN_CHARACTERS]}"
    causes = (error, error.__cause__)
    if any(type(cause).__name__ == "OutOfMemoryError" for cause in causes):  # torch's, of a GPU
        return WorkerExit(f"ran out of GPU memory ({text}).", _GPU_REMEDY, WorkerDied.code)
    if not any(map(_says_so, causes)):
        return None
    used = own_memory_bytes() / 1e6
    what = f"ran out of memory: it uses {used:,.0f} MB and could not get more ({text})."
    return WorkerExit(what, REMEDY, WorkerDied.code, memory=True)


def _says_so(error: BaseException | None) -> bool:
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    if isinstance(error, RuntimeError):
        return any(words in str(error) for words in _WORDS)
    return isinstance(error, MemoryError)
