"""Real arms: what an arm has to offer, the loop that drives it in a process of its own, and a laboratory of them."""

from trocar.hardware.arm import ArmFault, Fault, HardwareArm, HardwareReading, LoopSettings
from trocar.hardware.laboratory import HardwareLaboratory

__all__ = ["ArmFault", "Fault", "HardwareArm", "HardwareLaboratory", "HardwareReading", "LoopSettings"]
