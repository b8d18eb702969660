"""Tab completion: `siamloc completion bash`, and the candidates for the shell, which come from Hydra."""

from __future__ import annotations

from siamloc.cli.help import COMMANDS, job_of
from siamloc.errors import ConfigError, hint

_BASH = """\
_siamloc() {
    local line="${COMP_LINE:0:$COMP_POINT}" IFS=$'\\n'
    local word="${line##* }"
    COMPREPLY=($(siamloc completion query "$line" 2>/dev/null))
    # Where "=" ends a word for the shell, it replaces only what follows it.
    if [[ $COMP_WORDBREAKS == *=* ]]; then
        local before="${word%"${word##*=}"}"
        COMPREPLY=("${COMPREPLY[@]#"$before"}")
    fi
}
complete -o nospace -o default -F _siamloc siamloc
"""
SCRIPTS = {
    "bash": _BASH,
    "zsh": f"autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n{_BASH}",
    "fish": "complete -c siamloc -f -a '(siamloc completion query (commandline -cp | string collect))'\n",
}
HELP = """\
siamloc completion: complete commands, groups and keys with the tab key

  bash   eval "$(siamloc completion bash)"       in ~/.bashrc
  zsh    eval "$(siamloc completion zsh)"        in ~/.zshrc
  fish   siamloc completion fish | source        in ~/.config/fish/config.fish"""

_INTERNAL = ("hydra", "settings", "building")


def completion(words: list[str]) -> str:
    """Return the completion script for a shell; for `query LINE`, the possible last words, one per line.

    Raises:
        ConfigError: an unknown shell.
    """
    if len(words) == 2 and words[0] == "query":
        return "\n".join(candidates(words[1]))
    if not words or words[0] in ("-h", "--help"):
        return HELP
    if words[0] not in SCRIPTS:
        raise ConfigError(f"no completion for {words[0]!r}: {hint(words[0], SCRIPTS)}")
    return SCRIPTS[words[0]]


def candidates(line: str) -> list[str]:
    """Return the candidates for the last word of a command line, such as "siamloc train mod".

    >>> candidates("siamloc ev")
    ['evaluate ']
    >>> candidates("siamloc train model/head=fc1")
    ['model/head=fc1000_1000_10', 'model/head=fc1000_1000_10_softmax']
    """
    words = [*line.split()[1:], *([""] if line.endswith(" ") else [])]
    for count in (1, 2):
        if len(words) > count and " ".join(words[:count]) in COMMANDS:
            return _of_command(" ".join(words[:count]), words[count:])
    before, word = words[:-1], words[-1] if words else ""
    known = [name.split() for name in (*COMMANDS, "completion")]
    follow = {parts[len(before)] for parts in known if len(parts) > len(before) and parts[: len(before)] == before}
    return sorted(f"{name} " for name in follow if name.startswith(word))


def _of_command(command: str, words: list[str]) -> list[str]:
    """Return the candidates for the last word after a command; for most commands they come from Hydra."""
    kind = job_of(command)
    if not kind.BY_HYDRA:
        given = {word.partition("=")[0] for word in words[:-1]}
        return [f"{key}=" for key in kind.key_names() if key.startswith(words[-1]) and key not in given]
    from siamloc.cli.compose import completed

    found = completed(kind, " ".join(words))
    return [one for one in found if not one.startswith(_INTERNAL) or one.startswith("building=")]
