#!/usr/bin/env bash
# From nothing to fast laps: installs, trains on the default track until the car laps in 8 seconds,
# evaluates the best checkpoint, shows the result. Takes a few minutes on two cores.
#
# Works in its own folder (default: data/quickstart), so it never touches your runs. Run it again to
# start over.
set -euo pipefail
project=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
work=${1:-$project/data/quickstart}

"$project/scripts/install.sh"
export PATH="$project/.venv/bin:$PATH"

mkdir -p "$work"
cd "$work"
dr-init -q -f --preset virtual
dr-stop-training
dr-start-training -w -f --until-lap-time 8 --max-minutes 8
dr-evaluate
echo "Everything is in $work. To use the commands there:"
printf '  cd %q && source %q\n' "$work" "$project/.venv/bin/activate"
