#!/usr/bin/env bash
# Installs what the tests need and runs them, several files at a time: one more than there are
# processor cores, because many tests wait for worker processes, and four at most.
# A test that fails runs once more, and the summary names it (RERUN): among thousands of tests with
# real processes, sockets and browsers, one that fails on a busy machine and then passes is a bug to
# look at, but not one that stops everything.
# Arguments go to pytest: scripts/test.sh -m "not slow"
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

scripts/install.sh dev
cores=$(getconf _NPROCESSORS_ONLN)
exec .venv/bin/python -m pytest -n $((cores < 4 ? cores + 1 : 4)) --dist loadfile --no-loadscope-reorder \
    --reruns 1 -rfER "$@"
