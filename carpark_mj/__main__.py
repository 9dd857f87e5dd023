"""The command `carpark_mj`, also `python -m carpark_mj`."""

import sys
from typing import NoReturn

import carpark_mj
from carpark_mj.cli.process import enter
from carpark_mj.extensions import load_extensions, table
from carpark_mj.programs import COMMANDS, find

# Completes names of commands, and flags by what tyro prints for each command.
COMPLETION = """_carpark_mj() {
  local command=${COMP_WORDS[1]}
  if [ "$COMP_CWORD" = 1 ]; then
    COMPREPLY=($(compgen -W "COMMANDS" -- "$2"))
    return
  fi
  case "$command ${COMP_WORDS[2]}" in
    NESTED) command+=" ${COMP_WORDS[2]}" ;;
  esac
  local flags=_tyro_carpark_mj_${command// /_}
  if ! declare -F "$flags" >/dev/null; then
    eval "$(carpark_mj $command --tyro-print-completion bash 2>/dev/null)"
    complete -F _carpark_mj carpark_mj
  fi
  if declare -F "$flags" >/dev/null; then "$flags" "$@"; fi
  if [[ $2 == -* ]]; then # tyro offers lines of the help, too
    COMPREPLY=($(printf '%s\\n' "${COMPREPLY[@]}" | grep -- ^-))
  fi
}
complete -F _carpark_mj carpark_mj"""
LISTING = ("-h", "--help", "--completion")


def main() -> NoReturn:
    """Runs the program that the first argument names, as this process."""
    name, *_ = words = sys.argv[1:] or ["--help"]
    try:
        if name in LISTING:
            load_extensions(packages=True)
        elif name != "--version":
            name, words = find(words)
    except ValueError as error:
        print(f"carpark_mj: {error}", file=sys.stderr)
        if name not in LISTING:
            sys.exit(2)
    if name in ("-h", "--help"):
        place = {name: number for number, name in enumerate(COMMANDS)}
        # Those of two words behind the one that they begin with.
        names = sorted(COMMANDS, key=lambda x: place.get(x.split()[0], len(place)))
        summaries = {name: COMMANDS[name].summary for name in names}
        print(f"usage: carpark_mj COMMAND ...\n\n{table(summaries)}\n")
        print("carpark_mj COMMAND --help lists the settings of each.")
        print("carpark_mj --version prints the version, --completion a bash script.")
    if name == "--version":
        print(f"carpark_mj {carpark_mj.__version__}")
    if name == "--completion":
        nested = "|".join(f'"{name}"' for name in COMMANDS if " " in name)
        top = " ".join(name for name in COMMANDS if " " not in name)
        print(COMPLETION.replace("COMMANDS", top).replace("NESTED", nested))
    if name not in COMMANDS:
        sys.exit(0)
    sys.argv = [f"carpark_mj {name}", *words]  # as the help calls it
    enter(name, "carpark_mj.programs:run", name)


if __name__ == "__main__":
    main()
