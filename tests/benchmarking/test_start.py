"""The measurement of starts: what counts as an equation, how rounds become a row."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.benchmarking.start import Start, count_equations, rows

ONE = Start(
    environment="default",
    lots=1,
    process="first",
    device="cpu",
    import_s=1.0,
    construct_s=0.5,
    reset_s=4.0,
    step_s=6.0,
    total_s=11.5,
    reset_equations=2000,
    step_equations=6000,
)


def test_loops_and_calls_count_what_they_hold():
    def loop(x):
        return jax.lax.fori_loop(0, 9, lambda _, y: jnp.sin(y) + 1.0, x)

    flat = jax.make_jaxpr(lambda x: jnp.sin(x) + 1.0)(0.0)
    assert count_equations(flat.jaxpr) == 2
    called = jax.make_jaxpr(jax.jit(lambda x: jnp.sin(x) + 1.0))(0.0)
    assert count_equations(called.jaxpr) == 2
    looped = count_equations(jax.make_jaxpr(loop)(0.0).jaxpr)
    assert 3 <= looped < 9


def test_rows_are_medians_of_both_processes():
    times = 9.0, 10.0, 30.0
    found = [dataclasses.replace(ONE, total_s=x) for x in times]
    found += [dataclasses.replace(x, process="second", total_s=2.0) for x in found]
    [row] = rows(found)
    assert row["environment"] == "default"
    assert row["first: total [s]"] == "10.0"
    assert row["second: total [s]"] == "2.0"
    assert row["step equations"] == "6,000"
