"""The command `carpark_mj`, also `python -m carpark_mj`."""

import sys
from typing import NoReturn

import carpark_mj
from carpark_mj.cli.process import enter
from carpark_mj.extensions import table, unknown_name
from carpark_mj.programs import COMMANDS

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


def main() -> NoReturn:
    """Runs the program that the first argument names, as this process."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help"):
        summaries = {name: command.summary for name, command in COMMANDS.items()}
        print(f"usage: carpark_mj COMMAND ...\n\n{table(summaries)}\n")
        print("carpark_mj COMMAND --help lists the settings of each.")
        print("carpark_mj --version prints the version, --completion a bash script.")
    if name == "--version":
        print(f"carpark_mj {carpark_mj.__version__}")
    if name == "--completion":
        nested = "|".join(f'"{name}"' for name in COMMANDS if " " in name)
        top = " ".join(name for name in COMMANDS if " " not in name)
        print(COMPLETION.replace("COMMANDS", top).replace("NESTED", nested))
    if name in ("-h", "--help", "--version", "--completion"):
        sys.exit(0)
    if name not in COMMANDS:
        print(f"carpark_mj: {unknown_name('command', name, COMMANDS)}", file=sys.stderr)
        sys.exit(2)
    words = sys.argv[2:]
    if words and f"{name} {words[0]}" in COMMANDS:
        name, words = f"{name} {words[0]}", words[1:]
    sys.argv = [f"carpark_mj {name}", *words]  # as the help calls it
    enter(name, "carpark_mj.programs:run", name)


if __name__ == "__main__":
    main()
