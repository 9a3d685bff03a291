"""A method to compare with: calibrated arms that hold the tool's angle where others keep the wrist still.

    trocar run --plugin benchmarks/turning_wrist.py peg-transfer --method turning-wrist --calibration joints
    trocar run peg-transfer --calibration joints

Collisions are rare: what docs/peg_transfer.md says of both is from ``--sessions 12 --trials 3 --seed 92``.
"""

from dataclasses import replace

from trocar.eval import METHODS
from trocar.tasks.peg_transfer.agents import Settings
from trocar.tasks.peg_transfer.task import PegTransfer

METHODS.register("peg-transfer/turning-wrist", replace(PegTransfer.methods["calibrated"], settings=Settings))
