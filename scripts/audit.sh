#!/usr/bin/env bash
# Looks up every locked package in PyPI's advisory data. With --strict, every advisory fails.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

scripts/install.sh dev
exec .venv/bin/python scripts/audit/advisories.py "$@"
