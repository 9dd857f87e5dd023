"""Cars by file: a config stores the parameters, so a run does not need the file."""

from carpark_mj.extensions import Entry

_TEXT = Entry("carpark_mj.vehicle.sheet:read_as_text")


def is_name(vehicle: str) -> bool:
    """Whether it is a vehicle's name, neither a file's path nor a JSON object."""
    return "." not in vehicle and not vehicle.startswith("{")


def with_parameters(vehicle: str) -> str:
    """A vehicle as configs store it: the parameters of a file, or a name unchanged."""
    return vehicle if is_name(vehicle) else _TEXT.load()(vehicle)
