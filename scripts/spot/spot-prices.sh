#!/usr/bin/env bash
# Compares prices of spot machines.
#
#   spot-prices.sh [--sort_order KEY] [--interruption_filter CLASS] [options of dr-spot prices]
set -euo pipefail
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

spot prices "$@"
