"""What docs/commands.md says beside what the commands say of themselves."""

HEAD = """
# Commands

<!-- Written by scripts/docs from the commands themselves: change those. -->

Every command is called as `dr NAME` or `dr-NAME` in a folder that holds `run.env` and
`system.env` (or the folder that `DR_DIR` names). `--help` shows what is written here about a
command, `--json` prints a report as one object on the last line of standard output. Results go to
standard output, everything else to standard error.
"""

EXIT_CODES = {
    0: "done",
    1: "a question was not answered with yes; `dr-logs*`, `dr-find-*` and "
    "`dr-get-robomaker-stats`: it does not run, or has no log yet; or a bug of ours, whose "
    "traceback is in `data/logs/`",
    2: "wrong command line",
    3: "a setting, parameter file or reward function is wrong",
    4: "the bucket cannot be reached, read or written; `dr-tracks fetch` cannot get its file",
    5: "a worker died and could not be brought back",
    6: "training cannot go on (NaN); the last good checkpoint is kept",
    7: "not built yet, or it needs a program that is not installed",
    8: "another training took the model over while this one was held up; that one goes on",
    130: "left or interrupted by Ctrl-C; with `--foreground` the training is stopped and "
    "everything learned is in the bucket",
    143: "stopped by SIGTERM; everything learned is in the bucket, `--resume` continues (without "
    "`--foreground` only the command ends, and the training goes on). An "
    "evaluation that was stopped has no results",
}
"""What the exit code of every command means."""

REFERENCE_HEAD = """
## Commands of DeepRacer-for-Cloud

*same* does what it did there; *better* does it too, and what is said beside it; *later* is a name
that says what is not built yet and what to use now, and exits 7 (0 where it was to end
something); *not needed* has nothing to do here.
"""

KEYS_HEAD = """
## Keys of every report

What `--json` prints. `outer[].inner` is a key of each object in a list. Keys are only ever added; a
value that is not known is null. Where a command refuses something, it prints its words to standard
error, and no report unless it had one before.
"""

_FOLLOWING = """
## Following a training

`dr-start-training` draws a live display on a terminal and a line for each iteration elsewhere.
Ctrl-C leaves the display (exit code 130) and the training goes on, except with `--foreground`,
where Ctrl-C stops it.
"""

_WEIGHTS = """
## Starting from another model's weights

With `DR_LOCAL_S3_PRETRAINED=True`, `dr-start-training` makes the `last` or `best` checkpoint
(`DR_LOCAL_S3_PRETRAINED_CHECKPOINT`) of `DR_LOCAL_S3_PRETRAINED_PREFIX`, in the same bucket, the
new model's checkpoint 0. The other model is not changed. Steps, episodes, best checkpoint and
optimizer start afresh. World, reward function and hyperparameters may differ; so may the values
of the actions, with a warning. Type and number of actions, sensors, network, algorithm,
`stack_size` and `critic` must be the same: anything else is refused before a process starts.

`dr-increment-training` sets this up. It writes `DR_LOCAL_S3_PRETRAINED=True`, the present prefix
as `DR_LOCAL_S3_PRETRAINED_PREFIX`, and the next name as `DR_LOCAL_S3_MODEL_PREFIX` into the
`run.env` that counts, also that of an experiment. `model-9` becomes `model-10`, `team/m-09`
`team/m-10`, and a name without a number gets `-1`. Comments, order, quotes and `$NAME` stay; a
copy stays as `run.env.bak`.

It refuses while this run trains, when the model has no whole checkpoint, when the new prefix is
in use (without `-w`), and when the environment sets one of the three names, because then the edit
would do nothing.
"""

_BEST = """
## Which checkpoint is the best

The one with the best mean over its evaluation episodes: `DR_TRAIN_BEST_MODEL_METRIC` chooses
progress, reward or lap time (an unfinished lap counts 999.999 s). Between equal means the better
lap time decides, and between equal lap times the progress; then the newer one. The newest four
checkpoints and the best one are kept.
"""

_EVALUATING = """
## Evaluating

`dr-evaluate` and `dr-start-evaluation` drive the laps that the `DR_EVAL_` settings describe, wait
for their end and print the result. They never change the model, so it may be training meanwhile,
and several may run at once.

`-q` leaves out everything but the result. Only `dr-start-evaluation -q` does what scripts for the
reference count on: it returns as soon as the laps are being driven in the background. Results
come to `<prefix>/metrics/evaluation/` and `<prefix>/evaluation-<time>/` in the bucket,
`dr-logs-robomaker -e` follows, and `dr-stop-evaluation` ends it. So a cron job may go on as it
is:

```sh
*/3 * * * * cd $HOME/racing && dr-stop-evaluation && dr-start-evaluation -q
```

An evaluation that is stopped leaves within a second, with exit code 143 and nothing in the bucket
but the description of what it was going to drive.
"""

_NOTE = """
## What a model knows about its training

`<prefix>/ip/run.json` holds the seed, the settings that differ from their defaults, versions of
Python and the packages, the git commit of your folder and of this project (and whether tracked
files were changed since), the machine, and whose weights the model began with. Notes of the
starts that `--resume` continued are kept in `earlier`. Reward function, hyperparameters and model
metadata lie beside it.
"""

_SPOT = """
## On a spot instance

`dr-start-training --foreground` ends within seconds of SIGTERM: checkpoint, optimizer state,
metrics, traces and logs are in the bucket. With `DR_CLOUD=aws` or `remote`, another machine that
has only `run.env` and `system.env` continues with `dr-start-training --resume --foreground`.
"""

TOPICS = (_FOLLOWING, _EVALUATING, _WEIGHTS, _BEST, _NOTE, _SPOT)
"""In the order of the page."""
