"""The simulated laboratory: MuJoCo's physics, arms, cameras and clock."""
