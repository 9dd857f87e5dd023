"""Several hosts train together.

Each runs the same program. All take part in the updates; host 0 alone prints, writes
files and evaluates. Host means process here, as in JAX.
"""

import argparse
import contextlib
import dataclasses
import os
import re
import zlib
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils

AUTO = "auto"
MAX_PORT = 65535

Result = TypeVar("Result")


@dataclasses.dataclass(frozen=True)
class Hosts:
    """How hosts find each other."""

    # HOST:PORT of host 0, or `auto` where JAX knows the cluster (Slurm, Open MPI, TPU
    # pods); empty = one host.
    coordinator: str = ""
    num_hosts: int = 0  # 0 = not given
    host: int = -1  # number of this host, from 0; -1 = not given

    def __post_init__(self) -> None:
        if self.coordinator in ("", AUTO):
            if (self.num_hosts, self.host) != (0, -1):
                raise ValueError(
                    "num_hosts and host need coordinator HOST:PORT, not "
                    f"{self.coordinator!r}"
                )
            return
        port = re.fullmatch(r".+:(\d+)", self.coordinator)
        if port is None or not 0 < int(port[1]) <= MAX_PORT:
            raise ValueError(
                f"coordinator must be HOST:PORT, a port of 1 to {MAX_PORT}, or {AUTO}, "
                f"not {self.coordinator!r}"
            )
        if not 0 <= self.host < self.num_hosts:
            raise ValueError(
                f"host must lie in [0, num_hosts), not be {self.host} of "
                f"{self.num_hosts} hosts"
            )


def take_flags(
    arguments: Sequence[str], **flags: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """The values of some flags, and the words of the others.

    `flags` are options of `argparse.ArgumentParser.add_argument` by name. A value that
    is missing or impossible raises `ValueError`.
    """
    parser = argparse.ArgumentParser(
        add_help=False, allow_abbrev=False, exit_on_error=False
    )
    for name, options in flags.items():
        parser.add_argument(f"--{name.replace('_', '-')}", **options)
    try:
        values, others = parser.parse_known_args(arguments)
    except argparse.ArgumentError as error:
        raise ValueError(str(error)) from None
    return vars(values), others


def read_hosts(arguments: Sequence[str]) -> tuple[Hosts, list[str]]:
    """The flags of the hosts, and the others, whose defaults depend on the devices."""
    flags = {
        field.name: {"type": type(field.default), "default": field.default}
        for field in dataclasses.fields(Hosts)
    }
    values, others = take_flags(arguments, **flags)
    return Hosts(**values), others


@contextlib.contextmanager
def joined(hosts: Hosts) -> Generator[None]:
    """Connects the hosts, before JAX makes any array; only host 0 prints to stdout."""
    where = dataclasses.astuple(hosts) if hosts.coordinator != AUTO else ()
    try:
        if hosts.coordinator:
            jax.distributed.initialize(*where)
    except (ValueError, RuntimeError) as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(
            f"the hosts do not meet at coordinator {hosts.coordinator}: {reason}"
        ) from None
    with contextlib.ExitStack() as stack:
        if hosts.coordinator and not is_first():
            nowhere = stack.enter_context(Path(os.devnull).open("w"))
            stack.enter_context(contextlib.redirect_stdout(nowhere))
        yield


def is_first() -> bool:
    """Whether this is host 0, which prints, writes and evaluates."""
    return jax.process_index() == 0


def largest(*values: float) -> tuple[float, ...]:
    """The largest of each number over all hosts."""
    if jax.process_count() == 1:
        return values
    gathered = multihost_utils.process_allgather(np.array(values, np.float32))
    return tuple(gathered.max(axis=0).tolist())


def on_first(function: Callable[[], Result]) -> Result | None:
    """Calls a function on host 0 alone; None on the others."""
    result = error = None
    if is_first():
        try:
            result = function()
        except Exception as raised:
            error = raised
    (failed,) = largest(error is not None)
    if error is not None:
        raise error
    if failed:
        raise ValueError("host 0 failed: see its message")
    return result


def require_same(text: str) -> None:
    """Refuses different texts on the hosts."""
    # 24 bits are exact in float32.
    checksum = zlib.crc32(text.encode()) % 2**24
    high, low = largest(checksum, -checksum)
    if high != -low:
        raise ValueError("all hosts must be given the same settings")
