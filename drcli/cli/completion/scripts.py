"""What a shell has to run once so that its Tab key asks `drcli-complete`."""

from typing import Literal, get_args

from drcli.cli.table import program_names

Shell = Literal["bash", "zsh", "fish"]
SHELLS: tuple[Shell, ...] = get_args(Shell)

_BASH = """\
# Lets the Tab key finish the dr commands in bash. Written by `dr completion`.
_dr_complete() {
    local word
    COMPREPLY=()
    while IFS=$'\\t' read -r word _; do
        COMPREPLY+=("$word")
    done < <(drcli-complete bash "${COMP_WORDS[@]:0:COMP_CWORD+1}" 2>/dev/null)
    if [[ ${#COMPREPLY[@]} == 1 && ${COMPREPLY[0]} == *= ]]; then
        compopt -o nospace
    fi
}
complete -o bashdefault -o default -F _dr_complete {programs}
"""

_ZSH = """\
# Lets the Tab key finish the dr commands in zsh. Written by `dr completion`.
_dr_complete() {
    local line
    local -a words_found names_found
    for line in "${(@f)$(drcli-complete zsh "${(@Q)words[1,CURRENT]}" 2>/dev/null)}"; do
        [[ -n $line ]] || continue
        line=${${line//:/\\\\:}/$'\\t'/:}
        if [[ $line == *= ]]; then names_found+=("$line"); else words_found+=("$line"); fi
    done
    (( $#words_found + $#names_found )) || { _files; return; }
    (( $#words_found )) && _describe dr words_found
    (( $#names_found )) && _describe dr names_found -S ''
}
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit -i; }
compdef _dr_complete {programs}
"""

_FISH = """\
# Lets the Tab key finish the dr commands in fish. Written by `dr completion`.
function __dr_complete
    set -l found (drcli-complete fish (commandline -opc) (commandline -ct) 2>/dev/null)
    if test (count $found) -gt 0
        printf '%s\\n' $found
    else
        __fish_complete_path (commandline -ct)
    end
end
for program in {programs}
    complete -c $program -f -a '(__dr_complete)'
end
"""

_TEMPLATES: dict[Shell, str] = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}


def script(shell: Shell) -> str:
    """The lines for a shell, for all programs at once."""
    return _TEMPLATES[shell].replace("{programs}", " ".join(program_names()))
