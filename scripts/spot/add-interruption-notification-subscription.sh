#!/usr/bin/env bash
# Sends the messages of trainings to a mail address, which must agree first.
#
#   add-interruption-notification-subscription.sh BASE STACK MAIL
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

usage "BASE STACK MAIL" $# 3 9
shift
spot subscribe "$@"
