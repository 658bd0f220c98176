# Sourced by the other scripts in this folder: finds dr-spot, and the racer's files.

spot() {
    local here
    here=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
    if command -v dr-spot >/dev/null 2>&1; then
        dr-spot "$@"
    elif [ -x "$here/.venv/bin/dr-spot" ]; then
        "$here/.venv/bin/dr-spot" "$@"
    else
        echo "Error: dr-spot was not found. Install drcli, or run scripts/install.sh." >&2
        return 127
    fi
}

# usage "arguments" GIVEN LEAST MOST: ends the script unless the number of arguments fits.
usage() {
    if [ "$2" -lt "$3" ] || [ "$2" -gt "$4" ]; then
        echo "Usage: $(basename "$0") $1" >&2
        exit 1
    fi
}

# The old scripts read everything from custom-files/; a working folder of drcli has its own run.env.
files() {
    if [ -z "${DR_DIR:-}" ] && [ ! -f run.env ] && [ -f custom-files/run.env ]; then
        printf '%s\n' --files custom-files
    fi
}

# create "KIND" BASE STACK [MINUTES] [OPTIONS...]: KIND is --on-demand, or empty for a spot machine.
create() {
    local kind=$1
    shift
    usage "BASE STACK [MINUTES]" $# 2 40
    local base=$1 stack=$2 minutes=60 more=()
    shift 2
    if [ $# -gt 0 ] && [ "${1#-}" = "$1" ]; then
        minutes=$1
        shift
    fi
    mapfile -t more < <(files)
    spot create "$stack" --base "$base" --ttl "$minutes" ${more[@]+"${more[@]}"} \
        ${kind:+"$kind"} "$@"
}
