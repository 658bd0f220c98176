# Sets up this shell for a working folder: its settings as variables, and the dr-* programs.
#
#   source scripts/activate.sh [-e EXPERIMENT] [FILE]
#
# For bash and zsh, interactive or in a script; `dr init` writes a bin/activate.sh that calls it.
# The folder is the one of that bin/, else the current one, else $DR_DIR, else this checkout.
# EXPERIMENT takes run.env and custom_files from experiments/EXPERIMENT, FILE replaces run.env.
#
# Prints nothing, and may be sourced again. On an error it prints one line on stderr, returns 1 and
# sets nothing. The commands do not need it: they read the files themselves.

_DR_SCRIPT=${BASH_SOURCE:-$0}

case ${BASH_VERSION:+bash:${SHELLOPTS:-}:}${ZSH_VERSION:+zsh} in
'' | bash*:posix:*)
    echo "activate.sh: only bash and zsh can use it, not sh. Try: bash" >&2
    return 1 2>/dev/null || exit 1
    ;;
esac

# What this process was started as; $0 of zsh is the file that is being read.
_DR_STARTED=${ZSH_ARGZERO:-${BASH_VERSION:+$0}}
if [ "$_DR_STARTED" -ef "$_DR_SCRIPT" ] || [ "$_DR_STARTED" -ef "${_DR_HOME:-}/bin/activate.sh" ]; then
    printf 'activate.sh: it must be sourced, not executed. Try: source %q\n' "$_DR_STARTED" >&2
    return 1 2>/dev/null || exit 1
fi
unset _DR_STARTED

# Prints what is wrong and what to do about it.
_dr_fail() {
    printf 'activate.sh: %s. Try: %s\n' "$1" "$2" >&2
    return 1
}

# The absolute path of a folder. With CDPATH set, cd would print it too.
_dr_absolute() {
    (CDPATH='' cd -- "$1" && pwd)
}

# The first folder, of those given after it, that holds the file $1.
_dr_folder_with() {
    local file=$1 folder
    shift
    for folder in "$@"; do
        if [ -n "$folder" ] && [ -f "$folder/$file" ]; then
            _dr_absolute "$folder"
            return
        fi
    done
    return 1
}

# Exports the settings of the folder $1, with $2 for its run.env and $3 for its experiment; empty
# keeps the one that is set.
_dr_export() {
    local lines
    lines=$(DR_DIR=$1 DR_CONFIG=$2 _DR_EXPERIMENT=$3 dr shell-env) || return 1
    eval "$lines"
}

# Removes what DeepRacer-for-Cloud left in this shell: its functions would win over the programs, and
# its copies of settings over the files.
_dr_leave_reference() {
    local name
    [ -n "${DR_TRAIN_COMPOSE_FILE:-}" ] || typeset -f dr-find-sagemaker >/dev/null || return 0
    for name in $(typeset -f | sed -n 's/^\(dr-[a-z-]*\) ().*/\1/p; s/^\(droa-[a-z-]*\) ().*/\1/p'); do
        case $name in
        dr-update | dr-update-env | dr-reload) ;; # ours
        *) unset -f "$name" ;;
        esac
    done
    unalias dr-local-aws 2>/dev/null || true
    for name in $(sed -n 's/^\(DR_[A-Za-z0-9_]*\)=.*/\1/p' "${DR_DIR:-.}/system.env" \
        "${DR_CONFIG:-run.env}" 2>/dev/null); do
        unset "$name"
    done
    unset DR_CONFIG DR_TRAIN_COMPOSE_FILE DR_EVAL_COMPOSE_FILE DR_MINIO_COMPOSE_FILE \
        DR_DOCKER_FILE_SEP DR_DOCKER_MAJOR_VERSION DR_LOCAL_PROFILE_ENDPOINT_URL \
        DR_LOCAL_S3_ENDPOINT_URL DR_MINIO_URL DR_LOCAL_ACCESS_KEY_ID DR_LOCAL_SECRET_ACCESS_KEY \
        DR_LOCAL_S3_AUTH_MODE DR_UPLOAD_PROFILE DR_ROBOMAKER_TRAIN_PORT DR_ROBOMAKER_EVAL_PORT \
        DR_ROBOMAKER_GUI_PORT DR_RUN_ID AWS_DEFAULT_REGION
}

# Whether an argument that is neither an option nor a file is a mistake. A script that sources this
# without arguments passes on its own ($2 has one in each line); a person passes on nothing.
_dr_is_mistake() {
    case $- in
    *i*) return 0 ;;
    esac
    case $1 in
    -*) ! _dr_was_started_with "$2" ;;
    *) return 1 ;;
    esac
}

# Whether these are the last arguments of the running script; yes where /proc does not tell.
_dr_was_started_with() {
    [ -r "/proc/$$/cmdline" ] || return 0
    case $(tr '\0' '\n' <"/proc/$$/cmdline") in
    *"
$1") return 0 ;;
    *) return 1 ;;
    esac
}

_dr_activate() {
    local home=${_DR_HOME:-} programs=${_DR_PROGRAMS:-} beside experiment='' file='' given
    unset _DR_HOME _DR_PROGRAMS
    given=$(printf '%s\n' "$@")
    while [ $# -gt 0 ]; do
        case $1 in
        -e)
            if [ -z "${2:-}" ]; then
                _dr_fail "-e needs the name of an experiment" "source bin/activate.sh -e NAME"
                return 1
            fi
            experiment=$2
            shift
            ;;
        '#'*)
            break # zsh passes a pasted comment as arguments
            ;;
        *)
            if [ -f "$1" ]; then
                file=$(_dr_absolute "$(dirname -- "$1")")/${1##*/}
            elif [ "${1%.env}" != "$1" ]; then
                _dr_fail "there is no file $1" "name an existing file, or none for run.env"
                return 1
            elif _dr_is_mistake "$1" "$given"; then
                _dr_fail "$1 is not an option or a file" "source bin/activate.sh [-e NAME] [FILE]"
                return 1
            fi
            ;;
        esac
        shift
    done
    case $_DR_SCRIPT in
    */*) beside=$(_dr_absolute "${_DR_SCRIPT%/*}") ;;
    *) beside=$(pwd) ;;
    esac
    _DR_SCRIPT=$beside/${_DR_SCRIPT##*/}

    # Beside a checkout, or above an installed package.
    if programs=$(_dr_folder_with dr "$programs" "$beside/../.venv/bin" \
        "$beside/../../../../../bin"); then
        case ":$PATH:" in
        *":$programs:"*) ;;
        *) PATH=$programs:$PATH ;;
        esac
    elif ! command -v dr >/dev/null; then
        _dr_fail "the program dr was not found" "install it again, or add its folder to PATH"
        return 1
    fi
    if ! home=$(_dr_folder_with run.env "$home" "$PWD" "${DR_DIR:-}" "$beside/.."); then
        _dr_fail "there is no run.env in $PWD" "go to your working folder, or create one: dr init"
        return 1
    fi
    _dr_leave_reference
    _dr_export "$home" "$file" "$experiment" || return 1
    export PATH

    case $- in
    *i*)
        if [ -z "${_DR_COMPLETES:-}" ]; then
            _DR_COMPLETES=yes
            eval "$(dr completion show "${ZSH_VERSION:+zsh}${BASH_VERSION:+bash}")"
        fi
        ;;
    esac
}

# These three change this shell, which a program cannot.
dr-update() {
    _dr_export "$DR_DIR" "$DR_CONFIG" ""
}

dr-update-env() {
    dr-update
}

dr-reload() {
    _DR_HOME=$DR_DIR
    . "$_DR_SCRIPT" "$DR_CONFIG"
}

_dr_activate "$@"
