#!/usr/bin/env bash
# Opens port 22 of a training's machines for one address.
#
#   add-access.sh BASE STACK IP
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

usage "BASE STACK IP" $# 3 9
shift
spot add-access "$@"
