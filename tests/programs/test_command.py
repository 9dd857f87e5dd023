"""The command `carpark_mj`: what it lists and refuses, what a person waits for."""

import contextlib
import gc
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from helpers.programs import assert_refused, exit_code, python

from carpark_mj import __main__ as command
from carpark_mj import __version__, compilation
from carpark_mj import programs as programs_module
from carpark_mj.cli.process import OUTPUT_FUSION, enable_output_fusion
from carpark_mj.compilation import ONE_LOT, SHARE_LOOPS, keep_compiled_programs
from carpark_mj.config import LAYOUTS
from carpark_mj.extensions import FORMATS, Entry
from carpark_mj.layouts.base import LAYOUT_WRITERS
from carpark_mj.policy.named import READERS
from carpark_mj.pretrained import pretrained_names
from carpark_mj.programs import COMMANDS, STUDY_PROGRAMS, Command, _command, study
from carpark_mj.registry import ENVIRONMENTS
from carpark_mj.suite.levels import LEVELS
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.vehicle import VEHICLES
from carpark_mj.wrappers import gymnasium_env, pettingzoo


@pytest.fixture
def programs(monkeypatch):
    """The programs of `carpark_mj study`, to be changed; none at first."""
    list(STUDY_PROGRAMS)  # of installed extensions
    monkeypatch.setattr(STUDY_PROGRAMS, "_parts", {})
    return STUDY_PROGRAMS


@pytest.mark.parametrize("name", COMMANDS)
def test_a_listed_program_is_there_and_says_what_it_does(name):
    assert callable(COMMANDS[name].load())
    assert COMMANDS[name].summary


@pytest.fixture
def run(monkeypatch, capsys):
    """Runs `carpark_mj`; returns the exit code and what it prints, and complains of."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["carpark_mj", *arguments])
        with pytest.raises(SystemExit) as end:
            command.main()
        return end.value.code or 0, *capsys.readouterr()

    return run


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_the_help_lists_every_program(arguments, run):
    code, printed, _ = run(*arguments)
    assert not code
    assert all(f"\n  {name} " in printed for name in COMMANDS)


def test_the_version_is_that_of_the_package(run):
    assert run("--version") == (0, f"carpark_mj {__version__}\n", "")


def test_the_completion_knows_every_command(run):
    _, printed, _ = run("--completion")
    offered = re.findall(r'-W "([^"]*)"', printed)[0].split()
    nested = [name for name in COMMANDS if " " in name]
    assert sorted([*offered, *nested]) == sorted(COMMANDS)
    assert all(f'"{name}"' in printed for name in nested)
    tried = (
        f"{printed}\nCOMP_WORDS=(carpark_mj render --cam) COMP_CWORD=2\n"
        '_carpark_mj carpark_mj --cam render; printf "%s\\n" "${COMPREPLY[@]}"'
    )
    bin_folder = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-c", tried],
        env={**os.environ, "PATH": bin_folder},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "--camera\n"


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("layouts", LAYOUTS),
        ("environments", ENVIRONMENTS),
        ("vehicles", VEHICLES),
        ("policies", pretrained_names()),
        ("presets", PRESETS),
    ],
)
def test_all_names_of_a_kind_are_listed(kind, names, capsys):
    assert exit_code("list", [kind]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines} == {*names}
    assert all(len(line.split()) > 1 for line in lines)


def test_an_unknown_program_is_refused_in_one_line(run):
    code, _, told = run("trian")
    assert code == 2
    [line] = told.splitlines()
    assert "'trian'" in line
    assert "train" in line


def test_without_any_study_it_is_said_what_to_install(programs, capsys):
    for words in ([], ["tanner"]):
        assert exit_code("study", words) == 2
        [line] = capsys.readouterr().err.splitlines()
        assert "pip install ./papers" in line


@pytest.fixture
def alone(monkeypatch):
    """Takes away what carpark_formats has registered, if it is installed."""
    for parts in (LEVELS, LAYOUT_WRITERS, READERS):
        own = {name: parts[name] for name in parts if name not in OTHERS}
        monkeypatch.setattr(parts, "_parts", own)
    for name in FORMATS["command"]:
        monkeypatch.delitem(COMMANDS, name, raising=False)
    core = _command("cli.driver:export", "", "driving:ExportConfig")
    monkeypatch.setitem(COMMANDS, "export", core)


OTHERS = {name for names in FORMATS.values() for name in names}
WITHOUT = (
    *(f"{name} a.xml --out b.json" for name in FORMATS["command"]),
    *(f"layouts square --save a.{suffix}" for suffix in FORMATS["format to save"]),
    *(f"suite zero --levels {name}:a --out suite" for name in FORMATS["level"]),
    *(f"evaluate {kind}:a --out b" for kind in FORMATS["kind of policy"]),
    *(flag.replace(" ", " square ") for flag in FORMATS["flag"]),
    *("export square", "export square --out a.onnx"),
)


@pytest.mark.parametrize("line", WITHOUT)
def test_without_the_formats_it_is_said_what_to_install(
    line, alone, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    name, *arguments = line.split()
    assert_refused(capsys, name, arguments, "pip install ./formats")
    assert not [*tmp_path.iterdir()]


def test_a_command_of_an_extension_is_found_if_no_other_has_its_name(monkeypatch):
    def load(packages):
        monkeypatch.setitem(COMMANDS, "count", Command("builtins:len", "counts"))

    monkeypatch.setattr(programs_module, "load_extensions", load)
    assert programs_module.find(["layouts", "edit", "a"]) == ("layouts edit", ["a"])
    assert "count" not in COMMANDS
    assert programs_module.run("count", ["a", "b"], False) == 2


def test_a_program_of_an_extension_is_called_with_its_arguments(
    programs, monkeypatch, capsys
):
    monkeypatch.setattr(sys, "argv", ["carpark_mj study"])
    programs.register("count", Entry("builtins:len", "counts"))
    assert exit_code("study", []) == 0
    assert "count  counts" in capsys.readouterr().out
    assert study(["count", "--list"]) == 1
    assert sys.argv == ["carpark_mj study count", "--list"]
    assert exit_code("study", ["county"]) == 2
    assert "'count'" in capsys.readouterr().err


OPTIONS = "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"

HELP = """
import contextlib, importlib.util, io, json, sys
from carpark_mj.programs import COMMANDS, run

needed = [x for command in COMMANDS.values() for x in command.needs if x != "tyro"]
find = importlib.util.find_spec
importlib.util.find_spec = lambda name: None if name in needed else find(name)
seen, words = {}, {"suite": ["zero", "--cases", "1"], "sweep": ["--base", "cpu"]}
words |= {"scenario": ["a.yaml", "zero"], "report": ["runs/a"]}
missing = []
for name, command in [*COMMANDS.items()]:  # packages add theirs
    if command.needs:
        try:
            run(name, words.get(name, []))
        except ModuleNotFoundError as error:
            missing.append(error.name)
for name, command in [*COMMANDS.items()]:  # packages add theirs
    if not command.settings:
        continue
    text = io.StringIO()
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(text):
        run(name, ["--help"])
    try:
        said = "read later" if command.reads else run(name, ["--no-such-flag", "1"])
    except ValueError as error:
        said = str(error)
    seen[name] = [f"usage: carpark_mj {name}" in text.getvalue(), said]
with contextlib.redirect_stdout(io.StringIO()):
    run("list", ["policies"])
loaded = [x for x in ("jax", "mujoco", "brax", "flax") if x in sys.modules]
print(json.dumps([seen, missing == needed, loaded]))
"""

PAGE = """
import contextlib, json, sys
from carpark_mj.cli.pages import open_page

with contextlib.redirect_stdout(sys.stderr), open_page(8768):
    loaded = [x for x in ("jax", "mujoco", "brax", "flax") if x in sys.modules]
print(json.dumps(loaded))
"""

BUILT = """
import json
import jax
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.registry import environment

programs = []
def count(event, seconds, **_):
    programs.append(event.endswith("backend_compile_duration"))
jax.monitoring.register_event_duration_secs_listener(count)
counts = {"default": EnvConfig()}
counts |= {n: environment(n) for n in ("anywhere", "considerate", "sees", "hope")}
for name, config in counts.items():
    programs.clear()
    ParkingEnv(config)
    counts[name] = sum(programs)
print(json.dumps(counts))
"""

DRIVEN = """
import json
import jax, jax.numpy as jnp
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv

events = []
jax.monitoring.register_event_listener(lambda event, **_: events.append(event))
env = ParkingEnv(EnvConfig(physics="bicycle", num_agents=1, num_parked_cars=1))
state, _ = jax.jit(env.reset)(jax.random.key(0))
state, step = jax.jit(env.step)(state, jnp.zeros((1, 2)))
jax.block_until_ready(step.reward)
names = "cache_hits", "cache_misses"
print(json.dumps([sum(e.endswith(name) for e in events) for name in names]))
"""


def printed(program, **variables):
    """What a program prints in a process of its own, without kept programs."""
    kept = dict.fromkeys(name for name in os.environ if name.startswith("JAX_COMPIL"))
    done = python("-c", program, **kept | variables)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_help_and_refusals_do_not_import_jax():
    seen, refused, loaded = printed(HELP)
    assert refused
    assert not loaded
    assert {"train", "evaluate", "scene", "layouts edit", "sweep"} <= {*seen}
    for name, (helped, said) in seen.items():
        assert helped, name
        assert said, name


def test_a_page_opens_before_jax_is_imported():
    pytest.importorskip("mjviser")
    assert printed(PAGE) == []


def test_environments_are_built_without_compiling_lots(tmp_path):
    counts = printed(BUILT, XDG_CACHE_HOME=str(tmp_path))
    # The two fixed lots, and the key that they do not use.
    assert sum(counts.values()) <= 4, counts
    assert counts["considerate"] == counts["sees"] == counts["hope"] == 0


def test_a_second_process_finds_the_programs_of_the_first(tmp_path):
    hits, misses = printed(DRIVEN, XDG_CACHE_HOME=str(tmp_path))
    assert (hits, misses > 1) == (0, True)
    assert [*(tmp_path / "carpark_mj" / "jax").iterdir()]
    again, _ = printed(DRIVEN, XDG_CACHE_HOME=str(tmp_path))
    assert again >= 2  # reset and step


@pytest.fixture
def undecided(monkeypatch):
    """A process whose user has decided nothing about kept programs."""
    before = {name: jax.config.values[name] for name in OPTIONS}
    for name in OPTIONS:
        monkeypatch.delenv(name.upper(), raising=False)
    jax.config.update(OPTIONS[0], None)
    jax.config.update(OPTIONS[1], 1.0)
    yield
    for name, value in before.items():
        jax.config.update(name, value)


def options():
    return [jax.config.values[name] for name in OPTIONS]


def test_what_the_user_has_decided_stays(undecided, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    jax.config.update(OPTIONS[0], str(tmp_path / "own"))
    keep_compiled_programs()
    assert options() == [str(tmp_path / "own"), 1.0]
    jax.config.update(OPTIONS[0], None)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "")  # none
    keep_compiled_programs()
    assert options() == [None, 1.0]
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv(OPTIONS[1].upper(), "1.0")
    keep_compiled_programs()
    assert options() == [str(tmp_path / "carpark_mj" / "jax"), 1.0]


def test_without_a_folder_to_write_nothing_is_kept(undecided, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    keep_compiled_programs()
    assert options() == [None, 1.0]


@pytest.mark.parametrize("collects", [True, False])
def test_garbage_is_collected_after_tracing_as_before(collects):
    (gc.enable if collects else gc.disable)()
    new = []
    try:
        with contextlib.suppress(ValueError), compilation.without_collection():
            new = [{}]
            assert not gc.isenabled()
            raise ValueError
        assert gc.isenabled() == collects
        old = gc.get_objects(generation=2)
    finally:
        gc.enable()
    assert any(x is new for x in old) == collects
    # Objects that the user has frozen stay so.
    gc.freeze()
    with compilation.without_collection():
        pass
    assert gc.get_freeze_count() > compilation.FROZEN
    gc.unfreeze()


@pytest.mark.parametrize(
    ("gpu", "before", "after"),
    [
        (False, None, SHARE_LOOPS),
        (True, None, SHARE_LOOPS + " --{}=false"),
        (False, "", ""),
        (True, "--xla_other=1", "--xla_other=1 --{}=false"),
        (True, "--{}=true", "--{}=true"),  # the user has decided
        (True, "flags.txt", "flags.txt"),  # XLA reads a file
    ],
)
def test_flags_that_xla_gets_on_import(gpu, before, after, monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    before, after = (
        x and x.format(compilation.FUSION_AUTOTUNER) for x in (before, after)
    )
    if before is not None:
        monkeypatch.setenv("XLA_FLAGS", before)
    plugin = compilation.GPU_PLUGINS[0]
    installed = "json" if gpu else plugin  # a module that is there, or one that is not
    monkeypatch.setattr(compilation, "GPU_PLUGINS", (installed,))
    compilation.choose_xla_flags()
    assert os.environ.get("XLA_FLAGS") == after


def test_xla_knows_the_flags():
    own = f"--{compilation.FUSION_AUTOTUNER}=false"
    flags = f"{ONE_LOT} {own}"  # or XLA ends the process
    count = "import jax; print(jax.device_count())"
    assert printed(count, XLA_FLAGS=flags, JAX_PLATFORMS="cpu") >= 1


@pytest.mark.parametrize("before", [SHARE_LOOPS, "--xla_other=1"])
def test_adapters_of_one_lot_compile_it_quickly(before, monkeypatch):
    def build(*_):  # only then may JAX compute
        raise InterruptedError(os.environ["XLA_FLAGS"])

    after = before.replace(SHARE_LOOPS, ONE_LOT)
    for module, make in (
        (gymnasium_env, gymnasium_env.ParkEnv),
        (pettingzoo, pettingzoo.parallel_env),
    ):
        monkeypatch.setenv("XLA_FLAGS", before)
        monkeypatch.setattr(module, "share", build)
        with pytest.raises(InterruptedError, match=f"^{re.escape(after)}$"):
            make()


def test_output_fusion_joins_our_own_flag(monkeypatch):
    gpu = compilation.SKIP_SLOW_KERNELS
    own = [(f"{flag} {gpu}", True) for flag in (SHARE_LOOPS, ONE_LOT)]
    for before, fused in (*own, ("--xla_a=1", False)):
        monkeypatch.setenv("XLA_FLAGS", before)
        enable_output_fusion()
        flags = os.environ["XLA_FLAGS"].split()
        assert (OUTPUT_FUSION in flags) == fused
        assert before.split()[-1] in flags
