#!/usr/bin/env bash
# Trains on an ordinary machine, which nobody takes away, at the full price.
#
#   create-standard-instance.sh BASE STACK [MINUTES] [options of dr-spot create]
#
# DEEPRACER_INSTANCE_TYPE names the type of the machine, BUCKET another bucket than that of BASE.
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

create --on-demand "$@"
