"""Real arms: the driver protocol, the loop that drives the arms in its own process, and a laboratory of arms."""

from trocar.hardware.arm import ArmFault, Fault, HardwareArm, HardwareReading, LoopSettings
from trocar.hardware.laboratory import HardwareLaboratory

__all__ = ["ArmFault", "Fault", "HardwareArm", "HardwareLaboratory", "HardwareReading", "LoopSettings"]
