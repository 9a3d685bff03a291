"""Move an arm of a built-in station along a planned motion: python examples/move_an_arm.py."""

from trocar.arms import fk, ik
from trocar.cell import Cell
from trocar.geometry import SE3
from trocar.lab.laboratory import build_cell
from trocar.motion import plan_through

ARM = "psm1"
OVER_M, DOWN_M = [0.04, 0.02, 0.06], [0.04, 0.02, 0.03]


async def lower(cell: Cell) -> None:
    """Bring the tip over a place on the table, then straight down, in one motion."""
    model, T_world_base = cell.arms[ARM], cell.T_world_base_registered[ARM]
    start = cell.robot.setpoint(ARM).q
    over, down = (ik(model, T_world_base.inverse() @ SE3.from_parts(translation_m=p)) for p in (OVER_M, DOWN_M))
    plan = plan_through(model, [start, over, down], cell.limits[ARM], up=T_world_base.matrix[2, :3])
    execution = (await cell.robot.move({ARM: plan.trajectory}))[ARM]
    p_world_tip = (T_world_base @ fk(model, cell.robot.read(ARM).q)).translation_m
    print(f"{ARM} after {plan.duration_s:.2f} s: {execution.ended.value}")
    print(f"its encoders put the tip at {(1e3 * p_world_tip).round(1)} mm")


lab = build_cell("peg-transfer", backend="sim", seed=3)
in_time = lab.run(lower, budget_s=10.0)
print("the script came to its end" if in_time else "the script was stopped: its time was up")
