"""Texts of docs/commands.md that do not come from the commands."""

HEAD = """
# Commands

<!-- Written by scripts/docs from the commands themselves: change those. -->

Call every command as `dr NAME` or `dr-NAME`, in the folder with your `run.env` and `system.env`
(or set `DR_DIR` to that folder). `--help` shows the text below, `--json` prints a report as one
object on the last line of standard output. Results go to standard output, everything else to
standard error.
"""

REFERENCE_HEAD = """
## Commands of DeepRacer-for-Cloud

*same*: works as it does there. *better*: works as it does there, with the differences given.
*not needed*: there is nothing to do here.
"""

KEYS_HEAD = """
## Keys of every report

What `--json` prints. `outer[].inner` is a key of each object in a list. New versions only add
keys. An unknown value is null. A command that fails prints its message to standard error, and a
report only if it has one.
"""

_FOLLOWING = """
## Following a training

`dr-start-training` shows a live display on a terminal; otherwise it prints a line for each
iteration. Ctrl-C leaves the display (exit code 130) and the training continues. With
`--foreground`, Ctrl-C stops the training.
"""

_WEIGHTS = """
## Starting from another model's weights

With `DR_LOCAL_S3_PRETRAINED=True`, `dr-start-training` starts from the weights of another model
in the same bucket: a checkpoint of `DR_LOCAL_S3_PRETRAINED_PREFIX` becomes checkpoint 0 of the new
model. `DR_LOCAL_S3_PRETRAINED_CHECKPOINT` chooses it by a number or a word such as `best` or
`first-lap` ([checkpoints.md](checkpoints.md)); `--pretrained` and `--checkpoint` do the same for
one start. The other model is not
changed. Steps, episodes, best checkpoint and optimizer start from zero. World, reward function
and hyperparameters may differ, and also the values of the actions (with a warning). Type and
number of actions, sensors, network, algorithm, `stack_size` and `critic` must be the same; the
start checks this first.

`dr-increment-training` sets this up. It writes `DR_LOCAL_S3_PRETRAINED=True`, the current prefix
as `DR_LOCAL_S3_PRETRAINED_PREFIX`, and the next name as `DR_LOCAL_S3_MODEL_PREFIX` to the
`run.env` in use (that of an experiment, if one is chosen). `model-9` becomes `model-10`,
`team/m-09` becomes `team/m-10`, and a name without a number gets `-1`. Comments, order, quotes
and `$NAME` are kept, and a copy is kept as `run.env.bak`.

The command fails if this run is training, if the model has no complete checkpoint, if the new
prefix is in use (without `-w`), and if the environment sets one of the three names, because the
change would have no effect.
"""

_BEST = """
## Which checkpoint is the best

The one with the best mean over its evaluation episodes. `DR_TRAIN_BEST_MODEL_METRIC` chooses
progress, reward or lap time (an unfinished lap counts as 999.999 s). If means are equal, the
better lap time decides, then the progress, then the newer checkpoint. The best checkpoint, the
newest four and the milestones are kept: [checkpoints.md](checkpoints.md).
"""

_EVALUATING = """
## Evaluating

`dr-evaluate` and `dr-start-evaluation` drive the laps that the `DR_EVAL_` settings describe, wait
until they end, and print the result. They never change the model, so it may be training at the same
time. Several evaluations may run at once.

`-q` prints only the result. `dr-start-evaluation -q` returns at once, as scripts for the
reference expect, and the laps are driven in the background. Results are written to
`<prefix>/metrics/evaluation/` and `<prefix>/evaluation-<time>/` in the bucket; `dr-logs-robomaker
-e` follows the evaluation and `dr-stop-evaluation` stops it. A cron job of the reference works
unchanged:

```sh
*/3 * * * * cd $HOME/racing && dr-stop-evaluation && dr-start-evaluation -q
```

A stopped evaluation ends within a second with exit code 143. It leaves nothing in the bucket except
its description. `--loop` is meant to be stopped: it prints its table and exits with 0.

[evaluation.md](evaluation.md) explains starts, averages, `--robust`, `--models` and `--loop`.
"""

_NOTE = """
## The record of a training

`<prefix>/ip/run.json` contains the seed, the settings that differ from their defaults, the cars,
versions of Python and the packages, the git commit of your folder and of this project (and whether
tracked files have changed since), the machine, and the model whose weights it started from. When a
training is resumed, the records of earlier starts are kept in `earlier`. Reward function,
hyperparameters and model metadata are in the same folder.
"""

_SPOT = """
## On a spot instance

`dr-start-training --foreground` ends within seconds of SIGTERM, with checkpoint, optimizer state,
metrics, traces and logs in the bucket. With `DR_CLOUD=aws` or `remote`, another machine with the
same `run.env` and `system.env` continues with `dr-start-training --resume --foreground`.
"""

TOPICS = (_FOLLOWING, _EVALUATING, _WEIGHTS, _BEST, _NOTE, _SPOT)
"""In the order of the page."""
