"""Laboratories: stations, which describe what stands where, and the sessions drawn from them."""

from trocar.lab.check import check_station, require_reach
from trocar.lab.station import CheckerboardRegistration, Registration, SensorFlaws, Station, StationArm, StationCamera
from trocar.lab.station_file import built_in_stations, load_station, read_station, station_text
from trocar.lab.transmission import TRANSMISSIONS, Transmission

__all__ = [
    "TRANSMISSIONS",
    "CheckerboardRegistration",
    "Registration",
    "SensorFlaws",
    "Station",
    "StationArm",
    "StationCamera",
    "Transmission",
    "built_in_stations",
    "check_station",
    "load_station",
    "read_station",
    "require_reach",
    "station_text",
]
