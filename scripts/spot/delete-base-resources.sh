#!/usr/bin/env bash
# Deletes the bucket and the topic of create-base-resources.sh, with all models in the bucket.
#
#   delete-base-resources.sh STACK [options of dr-spot delete]
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

usage "STACK" $# 1 9
spot delete "$@"
