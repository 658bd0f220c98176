#!/usr/bin/env bash
# Installs what the tests need and runs them, several files at a time: one more than there are
# processor cores, because many tests wait for worker processes, and four at most.
#
#   scripts/test.sh                 what every commit must pass: eight journeys and all that is fast
#   scripts/test.sh --all           everything; every night and before a release
#   scripts/test.sh tests/faults    everything in a folder or a file
#
# Other arguments go to pytest, too. docs/testing.md says what is left out of a commit, and why.
# What has failed runs once more in the end, and is named whatever comes of it: among thousands of
# tests with real processes, sockets and browsers, one that fails on a busy machine and then passes is
# a bug to look at, but not one that stops everything.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

scripts/install.sh dev
cores=$(getconf _NPROCESSORS_ONLN)
run() {
    .venv/bin/python -m pytest -n $((cores < 4 ? cores + 1 : 4)) --dist loadfile --no-loadscope-reorder "$@"
}

code=0
run --cache-clear -rfE "$@" || code=$?
if [ "$code" = 1 ]; then
    echo "What has failed runs once more." >&2
    code=0
    run --last-failed --last-failed-no-failures none -rfEp "$@" || code=$?
    # 5: no test had failed, so the run itself did: processes were left behind.
    [ "$code" != 5 ] || code=1
fi
exit "$code"
