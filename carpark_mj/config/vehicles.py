"""A car by file: a config has its parameters, so that a run needs the file no more."""

from carpark_mj.extensions import Entry

# Name and parameters of a car that is no name of a registered one.
READ = Entry("carpark_mj.vehicle.file:read_vehicle")
_TEXT = Entry("carpark_mj.vehicle.file:read_as_text")


def is_name(vehicle: str) -> bool:
    """Whether it is a vehicle's name, neither a file's path nor a JSON object."""
    return "." not in vehicle and not vehicle.startswith("{")


def with_parameters(vehicle: str) -> str:
    """What a config holds of a vehicle: the parameters of a file, or a name as it is.

    Raises:
        ValueError: no such file, or a fault in it.
    """
    return vehicle if is_name(vehicle) else _TEXT.load()(vehicle)
