"""Every command of ``trocar``, with one line each for the help, so that listing them imports nothing heavy."""

from __future__ import annotations

from trocar.cli.group import Known

CALIBRATE = {
    "collect": Known(
        "Calibrate arms from images of spheres that they wear: joints, bases, cable models.",
        "trocar.cli.collect:collect",
        "trocar calibrate collect peg-transfer --arm psm1 --out out/cal",
    ),
    "cache": Known(
        "List the fitted cable models that runs share, or remove them.",
        "trocar.cli.installed:cache",
        "trocar calibrate cache --empty",
    ),
    "apply": Known(
        "Write the commands that move an arm's joints along a path, for your own controller; rad, and m for q3.",
        "trocar.cli.calibrate:apply",
        "trocar calibrate apply psm1_play.npz path.csv --out commands.csv",
    ),
    "excite": Known(
        "Write commands that reveal most about an arm's cables in the least time: wide swings.",
        "trocar.cli.calibrate:excite",
        "trocar calibrate excite peg-transfer --arm psm1 --out minute.csv",
    ),
    "prior": Known(
        "Learn from recordings what instruments have in common, for fits on short ones.",
        "trocar.cli.calibrate:prior",
        "trocar calibrate prior psm1.npz psm2.npz --out mine.npz",
    ),
    "fit": Known(
        "Fit a cable model to a recording; with a prior, a minute of it is enough.",
        "trocar.cli.calibrate:fit",
        "trocar calibrate fit psm1.npz --rows 75 --prior fleet --out psm1_play.npz",
    ),
    "evaluate": Known(
        "Measure the errors of a model on a recording, from row K on.",
        "trocar.cli.calibrate:evaluate",
        "trocar calibrate evaluate psm1_play.npz psm1.npz --from-row 867 --plot loops.png",
    ),
}

PLAN = {
    "transfer": Known(
        "Plan transfers through four waypoints each: grasp, lifted, over the target, lowered.",
        "trocar.cli.plan:transfer",
        "trocar plan transfer waypoints.npy --planner spline",
    )
}

CRTK = {
    "serve": Known(
        "Be a robot that speaks CRTK over ROS 2 or 1: a simulated cell in real time, its cables' errors included.",
        "trocar.cli.crtk:serve",
        "trocar crtk serve peg-transfer --seed 1",
    ),
    "doctor": Known(
        "Listen to a robot that speaks CRTK, and tell what is wrong with it; nothing is commanded.",
        "trocar.cli.crtk:doctor",
        "trocar crtk doctor peg-transfer",
    ),
}

RECORDING = {
    "show": Known(
        "Print what a bag holds: topics, kinds and numbers of messages, mean rates, and the arms and cameras in it.",
        "trocar.cli.recording:show",
        "trocar recording show psm1.bag",
    ),
    "import": Known(
        "Write an arm's joints in a bag as a recording for cable models, and the cameras' images as files.",
        "trocar.cli.recording:import_bag",
        "trocar recording import psm1.mcap --namespace /PSM1 --measured /tracker/measured_js --out psm1.npz",
    ),
}

REGISTER = {
    "points": Known(
        "Fit the camera's pose in the robot's base to paired points by least squares.",
        "trocar.cli.register:points",
        "trocar register points robot.npy camera.npy --json",
    ),
    "cell": Known(
        "Register a simulated cell with a checkerboard: lenses, camera and bases; print errors against the truth.",
        "trocar.cli.register:cell",
        "trocar register cell raven-pair --seed 3 --out out/cell",
    ),
}

STATION = {
    "list": Known(
        "List the stations that come with the package.", "trocar.cli.station:list_stations", "trocar station list"
    ),
    "show": Known(
        "Show what a station consists of.",
        "trocar.cli.station:show",
        "trocar station show raven-pair   (trocar station show raven-pair --toml > mine.toml)",
    ),
    "check": Known(
        "Check keys, values, reach, distances between arms and what cameras see; exit code 1 if something is wrong.",
        "trocar.cli.station:check",
        "trocar station check mine.toml",
    ),
    "export": Known(
        "Write a station as models for other programs: MJCF with named actuators and sensors, URDF of its arms.",
        "trocar.cli.station:export",
        "trocar station export peg-transfer --mjcf pegs.xml --urdf out/urdf",
    ),
}

IMPORT = {
    "lerobot": Known(
        "Replay the commands of an episode in the cell, on cables that err, and keep the trial as any other.",
        "trocar.cli.learn:import_lerobot",
        "trocar import lerobot out/episodes --task peg-transfer --episode 0",
    )
}

COMMANDS = {
    "run": Known(
        "Run trials of a task in the simulated cell, score them, and keep files and pictures.", "trocar.cli.run:RUN"
    ),
    "console": Known(
        "Open a page for a person: begin trials, confirm each motion, stop, take arms over, do the task by hand.",
        "trocar.cli.console:CONSOLE",
    ),
    "methods": Known(
        "Print what each method of a task is made of, what it costs before the first trial, and its settings.",
        "trocar.cli.installed:methods",
        "trocar methods peg-transfer",
    ),
    "report": Known(
        "Write summary, pictures, replay and an HTML page from saved trials; nothing is recomputed.",
        "trocar.cli.report:report",
        "trocar report out/ten",
    ),
    "view": Known(
        "Show a saved trial in 3D in the browser: where arms and objects were, what the scripts did, what cameras saw.",
        "trocar.cli.report:view",
        "trocar view out/ten --trial 3",
    ),
    "open": Known(
        "Show all runs below some folders in the browser: a table, the failures of each, two side by side, replays.",
        "trocar.cli.open:open_runs",
        "trocar open out",
    ),
    "export": Known(
        "Write saved trials as flat tables (goals, spans, events, ...), as MCAP for Foxglove, or for LeRobot.",
        "trocar.cli.report:export",
        "trocar export out/ten --out out/tables --format parquet",
    ),
    "import": Known("Replay what others recorded in the cell.", members=IMPORT),
    "calibrate": Known(
        "Collect recordings of commanded and measured joints, fit cable models to them, and evaluate these.",
        members=CALIBRATE,
    ),
    "recording": Known("Read bags of ROS 1 and ROS 2 without ROS: joints and images.", members=RECORDING),
    "plan": Known("Plan motions and print their quality.", members=PLAN),
    "register": Known(
        "Find poses: a robot's in a camera, a block's in a capture, a whole cell's from a checkerboard.",
        members=REGISTER,
    ),
    "station": Known("What a laboratory is: arms, instruments, cameras, what is fixed on the table.", members=STATION),
    "crtk": Known("Speak CRTK, as da Vinci Research Kits do, with other people's programs.", members=CRTK),
    "study": Known("Reproduce a paper's table beside the paper's own figures.", "trocar.cli.run:STUDY"),
    "sweep": Known(
        "Run methods against flaws of several sizes, in the sessions of several seeds: one table and one picture.",
        "trocar.cli.run:sweep",
        "trocar sweep examples/sweep.toml --out out/sweep",
    ),
    "analyse": Known(
        "Estimate velocity, acceleration and jerk of joints and tool tip from measured positions (Huber losses).",
        "trocar.cli.analyse:analyse",
        "trocar analyse joints.csv --rate 100 --out out/motion",
    ),
    "doctor": Known(
        "List what is installed, which optional parts are missing, and what to type next.",
        "trocar.cli.installed:doctor",
        "trocar doctor",
    ),
}
