#!/bin/bash
# A Slurm batch job. At its time limit, and when it is preempted, the training is interrupted, and the
# job is queued again; the next one goes on where this one ended.
#
#   cd my-racer && sbatch slurm.sh    # the folder with run.env, system.env and custom_files/
#
# End it with dr-stop-training or scancel. DRCLI_BIN names the folder with dr-start-training.
#SBATCH --job-name=drcli
#SBATCH --nodes=1
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=8
#SBATCH --mem=16G
#SBATCH --time=12:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=drcli-%j.log
# Two minutes before the time limit, this shell (B) gets the signal.
#SBATCH --signal=B:TERM@120
set -u

INTERRUPTED=75
STOPPED=143 # also if SIGTERM came before the command could do anything about it
NO_CHILD=127 # answer of `wait` if the process was waited for already

cd "${SLURM_SUBMIT_DIR:-.}" || exit 3
PATH=${DRCLI_BIN:-$HOME/drcli/.venv/bin}:$PATH

signals=0
training=
# shellcheck disable=SC2317,SC2329 # the trap calls it
pass_on() {
    signals=$((signals + 1))
    [ -z "$training" ] || kill -TERM "$training" 2>/dev/null
}

# Before the start: a signal in between would end this shell and leave the training behind.
trap pass_on TERM INT
dr-start-training --resume-or-start --foreground &
training=$!
[ "$signals" -eq 0 ] || kill -TERM "$training"

# A signal ends `wait`, not the training: wait until no signal came in between.
code=0
while :; do
    before=$signals
    wait "$training"
    answer=$?
    [ "$answer" -eq "$NO_CHILD" ] || code=$answer
    [ "$before" -eq "$signals" ] && break
done

if [ "$code" -eq "$STOPPED" ] && [ "$signals" -gt 0 ]; then
    code=$INTERRUPTED
fi
if [ "$code" -eq "$INTERRUPTED" ]; then
    # Not after scancel: then the job is no longer running.
    if [ "$(squeue --noheader --jobs "$SLURM_JOB_ID" --format %T)" = RUNNING ]; then
        scontrol requeue "$SLURM_JOB_ID"
    fi
fi
exit "$code"
