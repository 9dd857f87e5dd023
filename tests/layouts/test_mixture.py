"""Mixtures of families, and lots with bays among pieces of outlines."""

import dataclasses
import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.programs import layouts as main
from helpers.registering import restore_after
from helpers.scenes import solid
from helpers.sliding import SlidePhysics
from helpers.trees import assert_close

from carpark_mj.cli.layouts import families
from carpark_mj.config import LAYOUTS, EnvConfig, register_layout
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import box_inside
from carpark_mj.layouts import (
    ClutterConfig,
    DeadEndConfig,
    DesignCar,
    GarageRowConfig,
    SquareConfig,
    StreetConfig,
    layout_config,
    make_layout,
    member_shares,
    mixture,
)
from carpark_mj.layouts.base import FAMILIES
from carpark_mj.layouts.checks import describe_faults, find_faults
from carpark_mj.layouts.clutter import MARGINS, STARTS
from carpark_mj.layouts.registry import TEST, TRAIN, lot_key, lot_number
from carpark_mj.policy import runs

MEMBERS = (
    SquareConfig(bays_per_side=5),
    StreetConfig(bays_per_side=(3, 4)),
    DeadEndConfig(),
)
LOTS = 400
MIXTURE = mixture(MEMBERS, (1.0, 2.0, 1.0))


@functools.cache
def layouts():
    keys = jax.random.split(jax.random.key(0), LOTS)
    return jax.device_get(jax.jit(jax.vmap(MIXTURE.generate))(keys))


def member(batch):
    """Which family each lot is of: only streets have two lanes, squares have none."""
    return np.array([0, 2, 1])[batch.lane_mask.sum(axis=-1)]


def test_families_are_drawn_in_proportion_to_their_weights():
    share = np.bincount(member(layouts()), minlength=3) / LOTS
    # Five standard deviations of 400 draws.
    np.testing.assert_allclose(share, [0.25, 0.5, 0.25], atol=0.125)


def test_every_lot_of_a_mixture_is_one_its_family_draws():
    batch, families = layouts(), member(layouts())
    for family in range(3):
        one = jax.tree.map(lambda x, f=family: x[families == f][0], batch)
        assert describe_faults(one) == []
        own = jax.eval_shape(MEMBERS[family].generate, jax.random.key(0))
        assert one.bay_mask[own.bay_mask.shape[0] :].sum() == 0
    assert batch.bay_mask.shape[1] == 20  # the square's
    assert batch.lane_mask.shape[1] == 2  # the street's
    square = jax.tree.map(lambda x: x[families == 0][0], batch)
    np.testing.assert_array_equal(
        square.bay_pose, MEMBERS[0].generate(jax.random.key(0)).bay_pose
    )


def test_members_are_called_by_their_names_with_their_shares():
    tight = [GarageRowConfig(level=level) for level in ("normal", "complex")]
    members = ["square_compact", *tight, SquareConfig(bays_per_side=5)]
    assert member_shares(mixture(members, [1, 1, 2, 4])) == {
        "square_compact": 0.125,
        "garage_row": 0.125,
        "garage_row 2": 0.25,
        "square": 0.5,
    }
    assert member_shares(StreetConfig()) == {"street": 1.0}
    names = ["square_compact", "street", "street"]
    assert layout_config(",".join(names)) == mixture(names)


def test_the_fewest_bays_of_any_member_limit_the_cars():
    config = mixture(["square_compact", StreetConfig(bays_per_side=(3, 9))])
    assert config.min_bays == 6
    ParkingEnv(
        EnvConfig(layout=config, num_agents=2, num_parked_cars=4), SlidePhysics()
    )
    with pytest.raises(ValueError, match=r"num_parked_cars must be at most 4 \(6 bays"):
        ParkingEnv(EnvConfig(layout=config, num_parked_cars=5), SlidePhysics())


DRAWS = 100_000
STREET = StreetConfig(bays_per_side=(3, 4))


@functools.cache
def lot_numbers(split, seed=0):
    keys = jax.random.split(jax.random.key(seed), DRAWS)
    draw = jax.jit(jax.vmap(functools.partial(lot_number, split)))
    return np.asarray(draw(keys)).astype(np.int64)


@pytest.mark.parametrize(("split", "span"), [("train", TRAIN), ("test", TEST)])
def test_a_split_draws_from_all_of_its_range_and_from_nothing_else(split, span):
    assert range(TEST.start) == TRAIN
    assert TEST.stop == 2**32
    drawn = lot_numbers(split)
    assert drawn.min() >= span.start
    assert drawn.max() < span.stop
    # Uniform: the mean of so many is off by 5 of its standard deviations at most.
    share = (drawn - span.start) / len(span)
    assert abs(share.mean() - 0.5) < 5 / np.sqrt(12 * DRAWS)
    assert share.min() < 1e-3
    assert share.max() > 1 - 1e-3


def test_no_two_numbers_share_a_key():
    """Also across splits, for neighbours and for lot_numbers that differ in one bit."""
    ends = np.r_[0:1000, TEST.start - 1000 : TEST.start + 1000, 2**32 - 1000 : 2**32]
    powers = 2 ** np.arange(32)
    every = np.r_[
        lot_numbers("train"), lot_numbers("test"), ends, powers, powers ^ TEST.start
    ]
    every = np.unique(every).astype(np.uint32)
    keys = jax.random.key_data(jax.jit(jax.vmap(lot_key))(jnp.asarray(every)))
    assert len(np.unique(keys, axis=0)) == len(every)
    before = jax.random.key_data(lot_key(5))
    with jax.default_prng_impl("rbg"):  # under any default generator
        np.testing.assert_array_equal(jax.random.key_data(lot_key(5)), before)


def test_an_environment_s_lots_are_those_of_the_split_asked_for(monkeypatch):
    config = EnvConfig(layout=STREET, num_agents=1, num_parked_cars=0)
    env, key = ParkingEnv(config, SlidePhysics()), jax.random.key(3)
    layout_key = jax.random.split(key)[1]
    # What `reset` would start in: what follows is the same for every layout.
    monkeypatch.setattr(env, "_begin", lambda _, __, layout, key: (layout, key))
    reset = jax.jit(env.reset, static_argnums=1)
    default = env.reset(key)[0]
    for split, span in (("train", TRAIN), ("test", TEST)):
        started = reset(key, split)[0]
        number = int(lot_number(split, layout_key))
        assert number in span
        lot = make_layout(STREET, lot_key(number))
        assert_close(started, lot, atol=2e-5)  # float32 at 20 m
        same = np.allclose(default.bay_pose, started.bay_pose, atol=2e-5)
        assert same == (split == "train")


def test_a_member_of_a_mixture_can_be_asked_for():
    env = ParkingEnv(EnvConfig(layout=MIXTURE, num_parked_cars=2), SlidePhysics())
    draw = jax.jit(jax.vmap(lambda key, k: env.draw_layout(key, "test", k)))
    lots = draw(jax.random.split(jax.random.key(0), 9), jnp.arange(9) % 3)
    assert member(lots).tolist() == [0, 1, 2] * 3


def test_members_of_one_program_are_drawn_with_their_own_numbers():
    names = "hope_normal_perpendicular", "square", "hope_extreme_parallel"
    members = [LAYOUTS[name] for name in names]
    draw, key = jax.jit(mixture(names).generate_member), jax.random.key(1)
    for k in (0, 2):
        lot, alone = draw(k, key), jax.jit(members[k].generate)(key)
        for name in ("wall_pose", "wall_size", "bay_pose", "spawn_pose"):
            own = getattr(alone, name)
            found = np.asarray(getattr(lot, name))[: len(own)]
            np.testing.assert_allclose(found, own, atol=1e-4, err_msg=name)
    assert members[0].split()[0] == members[2].split()[0] != members[1].split()[0]


@dataclasses.dataclass(frozen=True)
class YardConfig(SquareConfig):
    """A square under another name, with settings of its own."""

    bays_per_side: int = 5
    family: str = "yard"


@pytest.fixture
def yard(monkeypatch):
    restore_after(monkeypatch, LAYOUTS, FAMILIES)
    return register_layout("yard", YardConfig())


def test_a_registered_layout_is_known_everywhere(yard):
    assert EnvConfig(layout="yard").layout == "yard"
    assert make_layout("yard").num_bays == 20
    assert layout_config("yard,street").members == (yard, StreetConfig())
    assert member_shares(layout_config("yard,street")) == {"yard": 0.5, "street": 0.5}
    config = EnvConfig(layout=YardConfig(bays_per_side=6))
    stored = json.loads(json.dumps(dataclasses.asdict(config)))
    assert runs.from_dict(EnvConfig, stored) == config
    assert families()["yard"] == yard


def test_second_families_of_a_name_are_refused(yard):
    class OtherConfig(YardConfig):
        pass

    with pytest.raises(ValueError, match="there is a family 'yard' already"):
        register_layout("other", OtherConfig())
    assert "other" not in LAYOUTS


# Bays among pieces of outlines


NAMES = [name for name in LAYOUTS if name.startswith("clutter")]
KEYS = 400


@functools.cache
def drawn(name):
    """Lots as numpy arrays with a leading (keys,), and by faults how many have them."""
    config = LAYOUTS[name]

    def make(key):
        layout = config.generate(key)
        faults = find_faults(layout, jnp.array(config.car.size))
        return layout, {text: fault.any() for text, fault in faults.items()}

    keys = jax.random.split(jax.random.key(0), KEYS)
    batch, faults = jax.device_get(jax.jit(jax.vmap(make))(keys))
    return batch, {text: found.sum() for text, found in faults.items() if found.any()}


@pytest.mark.parametrize("name", NAMES)
def test_bays_and_starts_are_free_in_every_lot(name):
    batch, faults = drawn(name)
    assert faults == {}
    assert batch.bay_mask.all()
    assert batch.spawn_mask[:, 0].all()  # the first start is always there
    assert batch.spawn_mask.mean() > 0.5
    assert 0 < batch.wall_mask.mean() < 0.8


@pytest.mark.parametrize("name", ["clutter", "clutter_roomy", "clutter_tight"])
def test_bays_are_larger_than_the_car_by_the_room_beside_it(name):
    config, (batch, _) = LAYOUTS[name], drawn(name)
    more = batch.bay_size[:, 0] - config.car.size
    np.testing.assert_allclose(more[:, 0], more[:, 1], atol=1e-5)
    shares = (np.abs(more[:, :1] - 2 * np.array(MARGINS)) < 1e-4).mean(axis=0)
    assert shares.sum() == pytest.approx(1.0)
    if config.gap[0] > 0.5:  # nothing but discs and boxes may be near
        assert shares[-1] > 0.95
    else:
        assert shares.min() > 0.02


def test_tighter_lots_have_less_room_and_more_walls():
    batches = [drawn(f"clutter{name}")[0] for name in ("_roomy", "", "_tight")]
    walls = [batch.wall_mask.mean() for batch in batches]
    sizes = [batch.bay_size[..., 1].mean() for batch in batches]
    assert walls == sorted(walls)
    assert sizes == sorted(sizes, reverse=True)


def test_ends_and_orientations_are_drawn_in_their_shares():
    batch, _ = drawn("clutter")
    shares = np.bincount(batch.bay_end[:, 0], minlength=3) / KEYS
    # Five standard deviations of 400 draws.
    np.testing.assert_allclose(shares, [0.4, 0.2, 0.4], atol=0.125)
    assert batch.bay_end.dtype == np.int32
    across = np.abs(np.sin(batch.bay_pose[:, 0, 2])) > 0.5
    assert across.mean() == pytest.approx(0.8, abs=0.1)


@pytest.mark.parametrize("name", ["clutter", "clutter_tight"])
def test_most_starts_lead_to_the_bay(name):
    """A disc of the car's width can roll from there to the middle of the bay."""
    batch, _ = drawn(name)
    reached = []
    for k in range(40):
        lot = jax.tree.map(lambda x, k=k: x[k], batch)
        x, y = lot.extent
        room = shapely.box(-x, -y, x, y).difference(solid(lot))
        parts = shapely.get_parts(room.buffer(-DesignCar().width / 2))
        goal = shapely.points(lot.bay_pose[0, :2])
        [part] = [p for p in parts if p.intersects(goal)]
        starts = shapely.points(lot.spawn_pose[lot.spawn_mask, :2])
        assert part.intersects(starts[0])  # nothing stands on the way to this one
        reached += part.intersects(starts).tolist()
    assert np.mean(reached) > 0.9


def test_starts_are_before_the_bay_and_elsewhere():
    batch, _ = drawn("clutter")
    away = batch.spawn_pose[..., :2] - batch.bay_pose[..., :2]
    away = np.linalg.norm(away, axis=-1)[batch.spawn_mask]
    assert np.quantile(away, 0.05) < 4.5
    assert 4.5 < np.median(away) < 8.5
    assert np.quantile(away, 0.99) > 10.0
    assert batch.spawn_mask.shape[1] == STARTS
    bounds = jnp.zeros(3), 2 * batch.extent[:, None]
    assert box_inside(batch.spawn_pose, batch.spawn_size, *bounds).all()


def test_lots_are_drawn_for_cars_between_two_sizes():
    config = dataclasses.replace(LAYOUTS["clutter_sizes"], density=(0.0, 0.0))
    make = jax.jit(jax.vmap(config.generate))
    batch = make(jax.random.split(jax.random.key(1), 200))
    assert not batch.wall_mask.any()
    assert not batch.disc_mask.any()
    np.testing.assert_array_equal(batch.wall_size, 0.0)
    car = np.asarray(batch.bay_size[:, 0]) - 2 * MARGINS[-1]
    small, large = np.array(config.car.size), np.array(config.largest.size)
    share = (car - small) / (large - small)
    np.testing.assert_allclose(share[:, 0], share[:, 1], atol=1e-4)
    assert share.min() < 0.05
    assert share.max() > 0.95
    with pytest.raises(ValueError, match="must be at most 1"):
        ClutterConfig(nose_first=0.7, tail_first=0.4)


def test_the_command_says_in_what_share_of_lots_there_is_a_path(capsys):
    pytest.importorskip("ompl")
    main(["clutter_roomy", "--check", "3", "--paths", "1"])
    found = capsys.readouterr().out
    assert "clutter_roomy: 3 lots, 0 with bays out of reach; 100.0 % (43.9" in found
