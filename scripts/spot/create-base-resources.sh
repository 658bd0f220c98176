#!/usr/bin/env bash
# Makes the bucket and the topic that trainings share.
#
#   create-base-resources.sh STACK [IP] [options of dr-spot create-base]
#
# No port is opened for the address: shells need none (dr-spot ssh). add-access.sh opens port 22 of
# one training for it.
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

usage "STACK [IP]" $# 1 9
stack=$1
shift
if [ $# -gt 0 ] && [ "${1#-}" = "$1" ]; then
    echo "No port is opened for $1; add-access.sh $stack TRAINING $1 opens port 22 of a training." >&2
    shift
fi
spot create-base "$stack" "$@"
