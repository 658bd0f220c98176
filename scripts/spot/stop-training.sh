#!/usr/bin/env bash
# Stops a training, checks that its model is in the bucket, and removes the machine.
#
#   stop-training.sh STACK [options of dr-spot stop]
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

usage "STACK" $# 1 9
spot stop "$@"
