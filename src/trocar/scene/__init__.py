"""What lies in front of the robot, as data."""

from trocar.scene.block import Block
from trocar.scene.pegboard import Pegboard
from trocar.scene.scene import Scene
from trocar.scene.sutures import SutureScene

__all__ = ["Block", "Pegboard", "Scene", "SutureScene"]
