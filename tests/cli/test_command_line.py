"""Errors of the user's making are one line that names the culprit."""

import errno
import importlib.metadata
import itertools
import os
import re
import tomllib
from pathlib import Path

import pytest
from helpers.programs import assert_refused, python

from carpark_mj.cli import evaluate, layouts, render
from carpark_mj.cli.evaluate import EvaluateConfig
from carpark_mj.cli.process import USER_ERRORS, one_line, run_command
from carpark_mj.cli.render import RenderConfig
from carpark_mj.extensions import EXTRAS
from carpark_mj.files import require_writable, write_atomically
from carpark_mj.suite import evaluation as suite
from carpark_mj.suite.evaluation import SuiteConfig

ROOT = Path(__file__).parents[2]


def test_errors_name_the_file_and_are_one_line(tmp_path):
    wanted = tmp_path / "missing" / "a.csv"
    with pytest.raises(USER_ERRORS) as caught:
        write_atomically(wanted, lambda temporary: temporary.write_text("x"))
    assert one_line(caught.value) == f"cannot use {wanted}: No such file or directory"
    path = tmp_path / "a.csv"

    def fill(temporary):
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match=r"a\.csv") as caught:
        write_atomically(path, fill)
    assert one_line(caught.value) == f"cannot use {path}: No space left on device"
    assert not [*tmp_path.iterdir()]


SCRIPTS = [*ROOT.glob("eval/*.py"), *ROOT.glob("train/*.py")]
PROGRAMS = [script for script in SCRIPTS if "enter(" in script.read_text()]

# Commands run without the packages of the extras; each prints its line and its code.
WITHOUT = """
import os, runpy, sys

class Missing:
    def find_spec(self, name, *_):
        if name.partition(".")[0] in ("tyro", "matplotlib", "tensorboardX"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())
for command in sys.argv[1:]:
    sys.argv, sys.path[0] = [command, "--help"], os.path.dirname(command)
    try:
        runpy.run_path(command, run_name="__main__")
    except SystemExit as end:
        print(end.code, file=sys.stderr)
"""


def test_without_its_packages_every_command_says_what_to_install():
    names = [path.stem for path in PROGRAMS]
    done = python("-c", WITHOUT, *PROGRAMS)
    assert done.returncode == 0
    said = re.sub("'(matplotlib|tensorboardX)'", "'tyro'", done.stderr)
    missing = f"No module named 'tyro': pip install -e \"{ROOT}[train,eval]\"\n2\n"
    assert said == "".join(f"{name}: {missing}" for name in names)


@pytest.mark.parametrize("path", ["train/export.py", "eval/render.py"])
def test_a_script_runs_its_checkout_and_no_installed_copy(path, tmp_path):
    (tmp_path / "carpark_mj.py").write_text("raise ImportError('the copy')")
    done = python(ROOT / path, "--no-such-flag", cwd=tmp_path, PYTHONPATH=str(tmp_path))
    assert done.returncode == 2, done.stderr


# A `sitecustomize.py`: Ctrl-C where a process imports JAX, or what reads its flags.
INTERRUPT = """
import signal, sys

class Interrupt:
    def find_spec(self, name, *_):
        if name in ("jax", "tyro"):
            signal.raise_signal(signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)  # shells may ignore it
sys.meta_path.insert(0, Interrupt())
"""


def test_ctrl_c_while_a_command_imports_is_one_line(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(INTERRUPT)
    path = os.pathsep.join([str(tmp_path), str(ROOT)])
    for name, *command in (
        ("evaluate", ROOT / "eval" / "evaluate.py"),
        ("scene", "-m", "carpark_mj", "scene"),
    ):
        done = python(*command, PYTHONPATH=path)
        ended = done.returncode, done.stdout, done.stderr
        assert ended == (130, "", f"{name}: interrupted\n")


@pytest.mark.parametrize("package", EXTRAS)
def test_a_missing_package_is_in_the_extra_to_install(package, capsys):
    def command():
        raise ModuleNotFoundError("missing", name=package)

    assert run_command("any", command) == 2
    told = capsys.readouterr().err
    [extras] = re.findall(r"pip install -e \".+\[(.+)\]\"", told)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [project["optional-dependencies"][extra] for extra in extras.split(",")]
    installed = " ".join(itertools.chain(*wanted))
    known = importlib.metadata.packages_distributions().get(package, [package])
    assert any(name.lower().replace("_", "-") in installed for name in known)


def test_other_missing_modules_are_mistakes_of_ours():
    def command():
        raise ModuleNotFoundError("No module named 'carpark'", name="carpark")

    with pytest.raises(ModuleNotFoundError):
        run_command("any", command)


def test_a_new_folder_is_made_with_its_first_file(tmp_path, monkeypatch):
    new, file = tmp_path / "new", tmp_path / "file"
    require_writable(new / "deep" / "a.png", new_folders=True)
    assert not new.exists()
    with pytest.raises(OSError, match=re.escape(str(new))):
        require_writable(new / "a.png")
    file.write_text("old")
    (tmp_path / "folder.png").mkdir()
    longest = tmp_path / f"{'x' * 251}.png"
    for out in (tmp_path / "folder.png", longest, Path("/proc/g.png")):
        with pytest.raises(OSError, match=re.escape(str(out))) as caught:
            require_writable(out)
        assert one_line(caught.value).startswith(f"cannot use {out}: ")
    (tmp_path / "folder.png").rmdir()
    with pytest.raises(NotADirectoryError):
        require_writable(file / "deep" / "a.png", new_folders=True)
    require_writable(file)
    require_writable(tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert file.read_text() == "old"

    def refuse(*_, **__):
        raise ValueError("refused in the middle of the work")

    monkeypatch.setattr(render, "choose_gl", lambda: "")
    monkeypatch.setattr(render, "record", refuse)
    monkeypatch.setattr(suite, "_drive_all", refuse)
    monkeypatch.setattr(evaluate, "evaluate", refuse)
    with pytest.raises(OSError, match=r"/proc/g\.png"):  # before the work
        render.main(RenderConfig("zero", out="/proc/g.png", frame=0.0))
    works = (
        lambda: render.main(RenderConfig("zero", out=str(new / "a.mp4"))),
        lambda: suite.main(SuiteConfig(("zero",), cases=1, out=str(new))),
        lambda: evaluate.main(EvaluateConfig("zero", out=str(new))),
    )
    for work in works:
        with pytest.raises(ValueError, match="refused in the middle"):
            work()
        assert not new.exists()


@pytest.mark.parametrize("flag", ["--plot", "--save"])
def test_a_file_is_refused_before_lots_are_drawn(flag, tmp_path, monkeypatch, capsys):
    for work in ("draw", "plot_layouts"):
        monkeypatch.setattr(layouts, work, lambda *_: pytest.fail("the work has begun"))
    path = tmp_path / "no" / f"a.{'png' if flag == '--plot' else 'json'}"
    words = ["square", flag, str(path)]
    assert_refused(capsys, "layouts", words, f"cannot use {path}: ")
    if flag == "--save":
        words = ["square", flag, str(tmp_path / "a.bmp")]
        assert_refused(capsys, "layouts", words, "unknown format to save 'bmp'")


def test_a_link_in_place_of_a_temporary_file_is_not_followed(tmp_path, monkeypatch):
    path, theirs = tmp_path / "a.csv", tmp_path / "theirs"
    theirs.write_text("old")
    # Even if the name were known.
    monkeypatch.setattr("secrets.token_hex", lambda _: "known")
    for name in (f".a.{os.getpid()}.csv", ".a.known.csv"):
        (tmp_path / name).symlink_to(theirs)
    with pytest.raises(FileExistsError) as caught:
        write_atomically(path, lambda temporary: temporary.write_text("new"))
    assert one_line(caught.value).startswith(f"cannot use {path}")
    assert theirs.read_text() == "old"
    monkeypatch.undo()
    write_atomically(path, lambda temporary: temporary.write_text("new"))
    assert (path.read_text(), theirs.read_text()) == ("new", "old")
    before = os.umask(0)
    os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o666 & ~before
