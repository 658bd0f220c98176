"""What to do about a damaged object, by its key."""

import re

_RESUME = "Continue with `dr-start-training --resume`, which"
_WRITTEN_AGAIN = "Nothing is to be done: the training writes it again when it continues."

_REMEDIES: tuple[tuple[str, str], ...] = (
    (r"races/.+", "Remove that object, or delete the race with `dr-race delete`."),
    (
        r"sweeps/.+\.json",
        "Delete {key} from the bucket and give the sweep another name; its models stay.",
    ),
    (r"training-records/.+", "Delete it with `dr-history forget`, or restore it from a copy."),
    (r"rollouts/.+", "The worker drives the iteration again."),
    (r"runs/.+/evaluations/\d+\.json", "Delete it; the next checkpoint is evaluated again."),
    (r"runs/.+/outcome\.json", "The next start writes it again."),
    (r"runs/.+/join\.json", "The next start writes it."),
    (r"runs/.+/shares\.json", "The trainer writes it again with the next checkpoint."),
    (r"runs/.+/lease\.json", _WRITTEN_AGAIN),
    (r"runs/.+/(status|members)/.+", _WRITTEN_AGAIN),
    (r".+/model/\.coach_checkpoint", f"{_RESUME} lets it name the newest whole checkpoint again."),
    (
        r".+\.ckpt\.json",
        "Choose another checkpoint; `dr-start-training --resume` continues without it.",
    ),
    (
        r".+\.ckpt\.(optimizer\.)?safetensors",
        "Restore it from a copy, or choose another checkpoint; `dr-start-training --resume` "
        "continues without it.",
    ),
    (
        r".+/history\.json(\.part-\d+)?",
        "Stop the training and continue with `dr-start-training --resume`, which reconstructs it.",
    ),
    (
        r".+/rollbacks\.json",
        "Delete it: then the training goes on with the learning rate of its hyperparameters.",
    ),
    (r".+/ip/run\.json", f"{_RESUME} writes it again."),
    (
        r".+/notes/.+",
        "Write it again with `dr-note edit`, or remove it with `dr-note remove`.",
    ),
    (r".+/(evaluation-\d+\.json|recording\.json)", "Evaluate the model again."),
    (
        r".+/(deepracer_checkpoints|milestones|TrainingMetrics(_\d+)?)\.json(\.part-\d+)?",
        f"{_RESUME} reconstructs it.",
    ),
    (r".*", "Restore it from a copy."),
)


def remedy_of(key: str) -> str:
    found = next(remedy for pattern, remedy in _REMEDIES if re.fullmatch(pattern, key))
    return found.format(key=key)
