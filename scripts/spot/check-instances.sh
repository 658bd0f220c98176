#!/usr/bin/env bash
# Lists the trainings and their machines.
#
#   check-instances.sh [options of dr-spot list]
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

spot list "$@"
