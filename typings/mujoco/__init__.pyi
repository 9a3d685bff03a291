# MuJoCo's functions live in compiled modules that Pyright cannot see; their use is checked by the tests.
from typing import Any

def __getattr__(name: str) -> Any: ...
