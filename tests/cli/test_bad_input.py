"""Every command with every kind of bad input: one sentence on stderr, exit code 2, nothing half-written."""

import json
import re
import zipfile

import numpy as np
import pytest

from trocar.calibration.models import MODELS, save_model
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import JOINT_NAMES, load_recording
from trocar.eval.trial import trial_file
from trocar.lab import station_text
from trocar.tasks.peg_transfer.shapes import Block

WAYPOINTS = [
    [0.2, -0.3, 0.15, 0.1, 0.3, 0.2],
    [0.2, -0.3, 0.11, 0.1, 0.3, 0.2],
    [-0.1, 0.1, 0.11, 0.2, -0.1, 0.1],
    [-0.1, 0.1, 0.14, 0.2, -0.1, 0.1],
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder of good and bad files; every command runs in it, and none may write there."""
    tmp_path = tmp_path_factory.mktemp("files")
    rng = np.random.default_rng(0)
    q = np.clip(np.cumsum(rng.normal(0, 0.05, (60, 6)), axis=0), -1, 1)
    q_phy = PSM1_GREY.measure(PSM1_GREY.run(q), rng)
    points = rng.uniform(-0.1, 0.1, (20, 3))
    face = Block().top_face_m() + [0, 0, 0.5]
    good = {
        "recording.npz": {"q_cmd": q, "q_phy": q_phy},
        "short.npz": {"q_cmd": q[:5], "q_phy": q_phy[:5]},
        "unequal.npz": {"q_cmd": q, "q_phy": q_phy[:-1]},
        "five.npz": {"q_cmd": q[:, :5], "q_phy": q_phy[:, :5]},
        "nan.npz": {"q_cmd": np.where(q == q[3, 3], np.nan, q), "q_phy": q_phy},
        "allbad.npz": {"q_cmd": q, "q_phy": q_phy, "valid": np.zeros(60, bool)},
        "capture.npz": {"points_m": face},
        "other.npz": {"something": face},
        "flat.npz": {"points_m": face[:, :2]},
        "nanpoints.npz": {"points_m": np.full((500, 3), np.nan)},
        "nopoints.npz": {"points_m": np.zeros((0, 3))},
        "one.npz": {"waypoints": np.array(WAYPOINTS)},
        "words.npz": {"q_cmd": np.array(["a"]), "q_phy": np.array(["b"]), "points_m": np.array(["c"])},
    }
    for name, arrays in good.items():
        np.savez(tmp_path / name, **arrays)
    waypoints = np.array(WAYPOINTS)
    arrays = {
        "points": points,
        "fewer": points[:-1],
        "flat": points[:, :2],
        "line": np.linspace([0, 0, 0], [1, 1, 1], 20),
        "nan": np.where(points == points[2, 1], np.nan, points),
        "one": points[:1],
        "words": np.array(["a", "b"]),
        "waypoints": waypoints,
        "three": waypoints[:3],
        "same": waypoints[[0, 1, 1, 3]],
        "nanway": np.where(waypoints == 0.3, np.nan, waypoints),
        "far": waypoints + [0, 0, 1, 0, 0, 0],
        "empty_array": np.zeros((0, 4, 6)),
    }
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
    rows = "\n".join(f"{0.1 * k:.1f}," + ",".join(map(str, q[k])) for k in range(20))
    (tmp_path / "path.csv").write_text(f"t_s,{','.join(JOINT_NAMES)}\n{rows}\n")
    (tmp_path / "holes.csv").write_text(f"t_s,{','.join(JOINT_NAMES)}\n{rows}\n2.0,,,,,,\n")
    (tmp_path / "theirs.csv").write_text("mine,alone\n")
    (tmp_path / "theirs.xml").write_text("<mine/>")
    (tmp_path / "file").write_text("")
    with zipfile.ZipFile(tmp_path / "many.npz", "w") as many:
        many.writestr("q_cmd.npy", b"")
    _claim_long_list(tmp_path / "many.npz")
    np.save(tmp_path / "objects.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    for suffix in ("npz", "npy"):
        (tmp_path / f"empty.{suffix}").write_bytes(b"")
        (tmp_path / f"text.{suffix}").write_text("no numbers here")
    (tmp_path / "cut.npz").write_bytes((tmp_path / "recording.npz").read_bytes()[:700])
    (tmp_path / "cut.npy").write_bytes((tmp_path / "points.npy").read_bytes()[:200])
    arrays = {"q_cmd": q, "q_phy": q_phy, "points_m": face, "waypoints": q, "log": q}
    np.savez_compressed(tmp_path / "damaged.npz", **arrays)
    damaged = bytearray((tmp_path / "damaged.npz").read_bytes())
    damaged[100:800] = bytes(700)
    (tmp_path / "damaged.npz").write_bytes(damaged)
    (tmp_path / "folder").mkdir()
    (tmp_path / "halfdata").mkdir()
    np.save(tmp_path / "halfdata" / "q_cmd.npy", q)
    trials = {name: trial_file(tmp_path / name, 0, 0) for name in ("badtrial", "cuttrial", "damagedtrial", "otherrun")}
    for path in trials.values():
        path.parent.mkdir(parents=True)
    trials["badtrial"].write_bytes(b"")
    trials["cuttrial"].write_bytes((tmp_path / "recording.npz").read_bytes()[:500])
    trials["damagedtrial"].write_bytes(damaged)
    np.savez(trials["otherrun"], q=q)
    (tmp_path / "otherrun" / "run.json").write_text(json.dumps({"task": "peg-transfer", "seed": 99}))
    (tmp_path / "badrecord").mkdir()
    (tmp_path / "badrecord" / "run.json").write_text("{")
    text = station_text("peg-transfer")
    changed = {
        "nan": ("133.2", "nan"),
        "key": ('name = "peg-transfer"', 'nome = "peg-transfer"'),
        "inch": ("xyz_mm = [133.2, 0.0, 166.0]", "xyz_inch = [5, 0, 7]"),
        "future": ('model = "psm-classic"', 'model = "psm-future"'),
    }
    for name, (old, new) in changed.items():
        assert old in text
        (tmp_path / f"{name}.toml").write_text(text.replace(old, new, 1))
    (tmp_path / "cut.toml").write_text(text[:200])
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    rows = load_recording(tmp_path / "recording.npz")
    save_model(MODELS["offset"].fit(rows, np.random.default_rng(0)), tmp_path / "model.npz")
    (tmp_path / "cutmodel.npz").write_bytes((tmp_path / "model.npz").read_bytes()[:900])
    return tmp_path


def _claim_long_list(path):
    """Let a zip's last record claim a list of 16 MB, which a file of 200 000 members really has."""
    data = bytearray(path.read_bytes())
    place = data.rfind(b"PK\5\6")
    data[place + 12 : place + 16] = (16 << 20).to_bytes(4, "little")
    path.write_bytes(data)


@pytest.fixture(autouse=True)
def in_the_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)


RUN, FIT, EVALUATE, STUDY = "run peg-transfer", "calibrate fit", "calibrate evaluate", "study peg-transfer"
EXCITE, COLLECT, REGISTER = "calibrate excite", "calibrate collect", "register cell"
APPLY, EXPORT = "calibrate apply model.npz", "station export peg-transfer"
DEMONSTRATIONS = "study demonstrations peg-transfer --method uncalibrated"
BAD_ARRAYS = ("missing", "empty", "text", "cut", "words")
STATIONS = {
    "missing": "does not exist",
    "nan": "is nan",
    "key": "unknown key 'nome'; did you mean 'name'",
    "inch": "unknown key 'xyz_inch'",
    "future": "arms.psm1.model: arm 'psm-future' is unknown; choose",
    "cut": "cut.toml",
    "bytes": "bytes.toml",
}
LONG_LIST = "is a zip whose list of members alone is 16 MB long"


def each(command, options):
    """One line for each of these options, which stand apart by a semicolon."""
    return [f"{command} {option}" for option in options.split("; ")]


BAD = [
    "statoin list -> command 'statoin' is unknown; did you mean 'station'? choose one of run",
    "calibrate evalute -> command 'evalute' is unknown; did you mean 'evaluate'?",
    "run peg-transfers -> peg-transfer",
    "run debridement --arms 3",
    "run debridement --calibration images -> --calibration images has no effect with --method best",
    *each(RUN, "--variant sideways -> unilateral; --method magic -> calibrated, uncalibrated"),
    *each(RUN, "--method uncalibrated --model lstm -> --model lstm has no effect with --method uncalibrated"),
    f"{RUN} --method adaptive --new-session -> --method adaptive makes none; drop --new-session",
    *each(RUN, "--model gru -> play; --trials 0 -> --trials; --trials -3 -> --trials; --seed -1 -> --seed"),
    *each(RUN, "--method uncalibrated --refit-offsets -> --refit-offsets"),
    f"{RUN} --out file -> 'file' is a file; choose a folder with --out",
    *each(RUN, "--out recording.npz/inside; --out otherrun; --out badrecord; --sessions 0 -> --sessions"),
    *each(RUN, "--planner magic -> spline; --perception magic -> depth; --transfers 0 -> give 1 to 12"),
    *each(RUN, "--transfers 13 -> give 1 to 12; --budget 0 -> --budget; --budget nan -> --budget"),
    *each(RUN, "--difficulty easy -> easy; --flaw wind=3 -> wind; --flaw jaw=3mm -> jaw"),
    *each(RUN, "--flaw kinematics=2 -> kinematics"),
    f"{RUN} --flaw print=-0.1mm -> flaw 'print=-0.1mm' has a negative size; give 0 or more",
    f"{RUN} --flaw depth=2mm -> give how many times what was recorded, as in 'depth=2x'",
    "run centre.py -> task 'centre.py' is unknown; give the task by its name, and its file by --plugin centre.py",
    f"{RUN} --flaw depth=2x --station nowhere -> station 'nowhere' is unknown",  # the flaw was read
    *each(RUN, "--station kitchen -> raven-pair; --station suture -> no fixture 'board'"),
    *(f"{RUN} --station {name}.toml -> {said}" for name, said in STATIONS.items()),
    *each("run suture", "--budget 0; --count 0; --count 1000; --plan missing.json; --plan text.npy"),
    *each("run suture", "--station raven-pair"),
    *(f"station {verb} {name}.toml -> {said}" for verb in ("show", "check") for name, said in STATIONS.items()),
    "station show kitchen -> station 'kitchen' is unknown; choose one of peg-transfer",
    "station check folder -> is unknown; choose one of",
    f"{EXPORT} -> nothing to write; give --mjcf FILE.xml, --urdf FOLDER, or both",
    *each(EXPORT, "--mjcf a.txt -> 'a.txt' must end in .xml; --mjcf nowhere/a.xml -> lie in a folder that exists"),
    *each(EXPORT, "--urdf urdf --task peg-transfer -> --task is for the whole station"),
    f"{EXPORT} --mjcf a.xml --task cooking -> 'cooking' is unknown; choose one of",
    *each(EXPORT, "--mjcf a.xml --seed -1 -> --seed is '-1'; --mjcf theirs.xml -> theirs.xml' already exists"),
    *each(EXPORT, "--urdf theirs.xml -> is a file where a folder is to be"),
    "station export kitchen --urdf urdf -> station 'kitchen' is unknown",
    "station export suture --mjcf a.xml --task peg-transfer -> no fixture 'board'",
    "view missing -> holds no trial; make some with",
    "view file -> 'file' is a file; give the folder of a run",
    *each("view", "folder; badtrial -> is not a readable trocar trial; badtrial --session 1"),
    *each("open", "missing -> does not exist; file -> is a file; folder missing -> does not exist"),
    "report file -> 'file' is a file; give the folder of a run",
    *each("report", "missing -> missing; folder -> holds no trial; badtrial; cuttrial; damagedtrial; otherrun"),
    "analyse folder -> recording 'folder' is a folder; give a CSV file",
    *each("analyse", "path.csv --columns q7 -> no column 'q7'; path.csv --columns q1,q2 --arm psm-si -> in order"),
    *each("analyse", "path.csv --arm crane -> choose one of psm-classic; path.csv --smoothness 0 -> --smoothness is 0"),
    *each("analyse", "path.csv --rate -1 -> --rate is -1"),
    *each("analyse", "trial.npz --rate 100 -> no effect on a trial; trial.npz --columns q1 -> --columns has"),
    "recording import some.bag --images file -> --images 'file' is a file; give a folder",
    f"{RUN} --method policy --policy path.csv -> policy 'path.csv' names no function",
    *(f"{FIT} {name}.npz --out m.npz" for name in BAD_ARRAYS),
    *(f"{FIT} {name}.npz --out m.npz" for name in ("short", "unequal", "five", "nan", "allbad", "other", "damaged")),
    *each(FIT, "folder --out m.npz; halfdata --out m.npz; recording.npz --out m.npz --model gru"),
    *each(FIT, "recording.npz --out m.npz --fraction 0; recording.npz --out m.npz --fraction 1.5"),
    *each(FIT, "recording.npz --out m.npz --fraction nan; recording.npz --out m.npz --rows 0"),
    *each(FIT, "recording.npz --out m.npz --rows -1; recording.npz --out m.npz --rows 61"),
    *each(FIT, "recording.npz --out m.npz --rows 10 --fraction 0.5; recording.npz --out m.npz --seed -1"),
    *each(FIT, "recording.npz --out nowhere/m.npz; recording.npz --out m.txt"),
    *each(FIT, "path.csv --out path.csv -> must end in .npz; recording.npz --out folder"),
    *(f"{EVALUATE} {name}.npz recording.npz" for name in (*BAD_ARRAYS, "damaged", "cutmodel")),
    *(f"{EVALUATE} model.npz {name}.npz" for name in (*BAD_ARRAYS, "unequal", "five", "nan", "damaged")),
    *each(EVALUATE, "recording.npz model.npz -> 'recording.npz' is a recording, not a cable model"),
    *each(EVALUATE, "model.npz model.npz -> 'model.npz' is a 'trocar cable model', not a recording"),
    *each(EVALUATE, "other.npz recording.npz -> 'other.npz' is not a trocar cable model, it holds something"),
    f"{EVALUATE} folder recording.npz -> 'folder' is a folder; give a file, a trocar cable model",
    f"{EVALUATE} many.npz recording.npz -> {LONG_LIST}",
    f"{EVALUATE} model.npz many.npz -> {LONG_LIST}",
    *each(EVALUATE, "model.npz recording.npz --from-row -1; model.npz recording.npz --from-row 60 -> 60"),
    *each(EVALUATE, "model.npz recording.npz --refit -1; model.npz recording.npz --refit 1000"),
    *each(EVALUATE, "model.npz recording.npz --plot nowhere/loops.png; model.npz recording.npz --plot folder"),
    *each(EVALUATE, "model.npz recording.npz --plot loops.xyz"),
    *each(APPLY, "path.csv --out path.csv -> is read; path.csv --out commands.txt -> must end in .csv"),
    *each(APPLY, "path.csv --out c.csv --columns q1,q2 -> names 2 different columns"),
    *each(APPLY, "path.csv --out c.csv --columns a,b,c,d,e,f -> has no column 'a'"),
    *each(APPLY, "path.csv --out c.csv --rate nan -> is not a rate; path.csv --out c.csv --rate inf -> is not a rate"),
    *each(APPLY, "holes.csv --out c.csv -> row 22 of; path.csv --out theirs.csv -> not replaced"),
    *each(APPLY, "path.csv --out gone/c.csv -> lie in a folder that exists"),
    "calibrate apply path.csv path.csv --out c.csv -> not a readable trocar cable model",
    *each(EXCITE, "peg-transfer --out minute.csv --arm psm3 -> psm3"),
    *each(EXCITE, "raven-pair --out minute.csv -> does not define where arm 'left' moves"),
    *(f"{EXCITE} peg-transfer --out minute.csv --rows {count} -> {count} samples" for count in (1, 1000000000)),
    *each(EXCITE, "peg-transfer --out nowhere/m.csv -> nowhere; peg-transfer --out m.txt -> must end in .csv"),
    f"{COLLECT} kitchen --out cal -> station 'kitchen' is unknown",
    f"{COLLECT} peg-transfer --out cal --arm psm3 -> arm 'psm3' is unknown; did you mean",
    f"{COLLECT} raven-pair --out cal -> does not define where arm 'left' moves during calibration",
    f"{COLLECT} peg-transfer --out cal --rows 10 -> 10 rows is too small to fit on; give 30 or more",
    *each(COLLECT, "peg-transfer --out cal --rows 60 --fraction 0.8 -> leaves too few to fit on (60 or more)"),
    *each(COLLECT, "peg-transfer --out cal --fraction 1 -> --fraction 1 of 1355 rows"),
    *each(COLLECT, "peg-transfer --out cal --seed -1 -> is '-1'; peg-transfer --out cal --model oracle -> is unknown"),
    f"{COLLECT} peg-transfer --out cal --difficulty easy -> 'easy' is unknown; choose one of mild, recorded, harsh",
    f"{COLLECT} peg-transfer --out cal --flaw creep=1m -> creep=1m",
    f"{COLLECT} peg-transfer --out cal --flaw needle=2 -> flaw 'needle' has no effect",
    *each("study calibration", "--data missing; --data folder; --data recording.npz"),
    f"{STUDY} --variants , -> --variants ',' has a comma too many; choose from unilateral, bilateral, handover",
    f"{STUDY} --methods best,best -> --methods names 'best' twice; name each once",
    f"{STUDY} --methods uncalibrated --model ridge -> --model ridge has no effect with uncalibrated",
    f"{STUDY} --report-only --out nothere -> folder 'nothere' does not exist; give that of a study with --out",
    f"{STUDY} --report-only --out folder -> folder 'folder' holds no study",
    f"{STUDY} --out file -> --out 'file' is a file; give a folder",
    *each(STUDY, "--variants sideways -> 'sideways' is unknown; --methods magic -> --methods 'magic' is unknown"),
    *each(STUDY, "--jobs 0 -> --jobs is '0'; --backend ray -> processes, dask; --sessions 0 -> give 1 or more"),
    *each("study debridement", "--arms 3 -> choose one of 1, 2; --fragments 0 -> give 1 to 12"),
    *each(DEMONSTRATIONS, "--failures hide -> --failures 'hide'; --layout rlds -> --layout 'rlds'"),
    *each(DEMONSTRATIONS, "--command-noise 50 -> --command-noise; --command-noise -1 -> --command-noise"),
    "study debridement --arms 1,,2 -> --arms '1,,2' has a comma too many",
    "study debridement --model ridge -> --model ridge has no effect with best",
    *(f"export {name} --out tables" for name in ("folder", "badtrial", "recording.npz", "empty.npz")),
    *(f"export {name} --out tables -> does not exist" for name in ("missing", "missing.npz")),
    "export otherrun/run.json --out tables -> is not a trial; give the folder of a run, or a file such as",
    "export recording.npz --out recording.npz",
    *each("export folder --out tables", "--format xlsx -> csv, parquet, mcap, lerobot; --layout open-h -> format csv"),
    *each("export folder --out tables", "--truth --format mcap -> --truth is not for; --successes -> not for --format"),
    f"{REGISTER} kitchen --out cell -> station 'kitchen' is unknown",
    f"{REGISTER} peg-transfer --out cell -> is registered by points; give its [registration]",
    f"{REGISTER} raven-pair --out cell --seed -1 -> --seed is '-1'; it should be greater than or equal",
    f"{REGISTER} suture --seed abc -> --seed is 'abc'; it should be a valid integer",
    *(f"register points {name}.npy points.npy -> {name}.npy" for name in (*BAD_ARRAYS, "objects")),
    *(f"register points points.npy {name}.npy -> {name}.npy" for name in (*BAD_ARRAYS, "fewer", "nan")),
    *each("register points", "fewer.npy points.npy -> fewer.npy has shape (19, 3); flat.npy points.npy -> shape"),
    *each("register points", "nan.npy points.npy -> nan.npy' holds NaN or infinity, first in row 2"),
    *each("register points", "line.npy points.npy -> one line; one.npy points.npy; one.npy one.npy"),
    "register points folder file -> 'folder' is a folder; give a .npy file",
    *each("register points", "recording.npz points.npy; cut.npz points.npy; points.npy points.npy --inlier-mm 0"),
    *each("register points", "points.npy points.npy --inlier-mm nan"),
    *(f"register block {name}.npz" for name in (*BAD_ARRAYS, "other", "flat", "nanpoints", "nopoints", "damaged")),
    *(f"register block {name}.npy --unit m" for name in (*BAD_ARRAYS, "objects")),
    "register block points.npy",
    "register block capture.npz --unit inch",
    "register block folder -> 'folder' is a folder; give an .npz or .npy file",
    *(f"plan transfer {name}.npy -> {name}.npy" for name in (*BAD_ARRAYS, "points", "three", "same", "nanway", "far")),
    *(f"plan transfer {name}.npy -> {name}.npy" for name in ("empty_array", "objects")),
    *(f"plan transfer {name}.npz -> {name}.npz" for name in (*BAD_ARRAYS, "other", "damaged")),
    f"plan transfer many.npz -> {LONG_LIST}",
    "plan transfer folder -> 'folder' is a folder; give a .npy or .npz with waypoints",
    *each("plan transfer", "waypoints.npy --planner magic -> spline; waypoints.npy --arm psm-xi"),
    *each("plan transfer", "waypoints.npy --limits none; waypoints.npy --up 0 0 0; waypoints.npy --up nan 0 1"),
    *each("plan transfer", "one.npz --out motions.txt -> must end in .csv, .npz; one.npz --out one.npz -> is read"),
    *each("plan transfer", "one.npz --step-ms 0 -> is outside; one.npz --step-ms nan -> is outside"),
    *each("plan suture", "--preset magic -> default, paper-demo; --count 0; --count 7 --positions 360; --positions 2"),
    *each("plan suture", "--count 6 --gap 70:; --gap nan:; --preset paper-demo --gap 60: -> let theta_is be middle"),
    *each("plan suture", "--search even --gap 60: -> give --search gaps; --search any; --forbid here; --margin best"),
    *each("plan suture", "--forbid 10 -> FROM:TO; --fix 90.5; --fix nan -> fixed positions; --caution nan"),
    *each("plan suture", "--caution 1 -> needs the variance of recorded sutures; --joint-weights 0,0,0 -> not all 0"),
    *each("plan suture", "--joint-weights 1,2 -> give three numbers as R,P,Y; --weight nan; --arm psm-xi"),
    *each("plan suture", "--set circle_radius_mm=0; --set radius=3; --set pushes; --set needle_radius_mm=20"),
    *each("plan suture", "--set needle_arc_deg=nan; --set center_x_mm=nan -> center_x_mm is 'nan'"),
    *each("plan suture", "--set center_x_mm=600 -> give -500 to 500 mm; --set base_up_mm=inf; --set pushes=-1"),
    *each("plan suture", "--set theta_is=end; --out recording.npz; --out /dev/null/x -> cannot be made"),
    *(f"plan suture --demonstrations {name}" for name in ("missing", "folder", "recording.npz", "text.npy")),
    *each("plan setup", "--preset magic; --free foo -> center_x_mm; --evaluations 1; --count 0; --out recording.npz"),
    *each("plan setup", "--bound circle_radius_mm; --bound circle_radius_mm=25 -> NAME=LOW:HIGH"),
    *each("plan setup", "--bound circle_radius_mm=-5:20 -> radius is -5 mm; --bound center_x_mm=-600:0 -> -600 mm"),
    *each("plan setup", "--bound base_tilt_deg=0:nan -> base_tilt_deg is bounded by 0 and nan; --seed -1 -> is '-1'"),
    *each("plan setup", "--arm hand -> raven2-left; --out /dev/null/x -> cannot be made"),
    *each("crtk serve peg-transfer", "--ros 3 -> give 1 or 2; --domain 999 -> 232; --seconds 0 -> more than 0"),
    *each("crtk serve peg-transfer", "--seconds nan; --speed 0 -> above 0"),
    *each("study suture", "--preset magic -> paper-demo; --positions 90 -> multiple of 4; --out recording.npz"),
    *each("study suture", "--demonstrations nowhere; --out file -> is a file; --out file/x -> cannot be made"),
]
USAGE = [
    "fly",
    "run",
    "run peg-transfer --speed 3",
    "run peg-transfer --trials many",
    "run peg-transfer --count 3",
    "run suture --transfers 3",
    "run suture --plugin",
    "station",
    "station fly",
    "view badtrial --port 99999",
    "report",
    "calibrate bend",
    "calibrate fit recording.npz",
    "calibrate evaluate model.npz",
    "plan transfer",
    "plan transfer waypoints.npy --up 1 2",
    "plan suture --count many",
    "plan suture --weight much",
    "register points points.npy",
    "register block capture.npz --unit",
    "study magic",
    "export recording.npz",
]


def contents(folder):
    return {path.relative_to(folder): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("line", BAD)
def test_bad_input_is_one_sentence_and_code_2(folder, trocar, line):
    before = contents(folder)
    words, _, said = line.partition(" -> ")
    flags = ["", *([" --json"] if not line.startswith("view") else [])]
    for flag in flags:
        code, out, err = trocar(*f"{words}{flag}".split())
        assert code == 2, err
        assert out == ""
        assert re.fullmatch(r"trocar: [^\n]+\n", err) and said in err, err
        assert contents(folder) == before, "something was written"


@pytest.mark.parametrize("line", USAGE)
def test_wrong_usage_is_code_2(folder, trocar, line):
    before = contents(folder)
    code, out, err = trocar(*line.split())
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    assert contents(folder) == before


@pytest.mark.parametrize(
    "line",
    [
        "calibrate fit recording.npz --model ridge --out {out}/again.npz",
        "calibrate evaluate model.npz recording.npz",
        "register points points.npy points.npy",
        "register block capture.npz",
        "plan transfer waypoints.npy",
        "plan suture",
        "study suture",
        "station show suture",
        "station list",
    ],
)
def test_json_is_one_object_and_nothing_else(trocar, tmp_path, line):
    code, out, _ = trocar(*line.format(out=tmp_path).split(), "--json")
    assert code == 0
    assert isinstance(json.loads(out), dict)
    assert out.count("\n") == 1


def test_an_absent_block_is_code_1_with_an_object(trocar, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("plate.npy", np.random.default_rng(0).uniform((-0.05, -0.05, 0.5), (0.05, 0.05, 0.5001), (3000, 3)))
    code, out, err = trocar(*["register", "block", "plate.npy", "--unit", "m", "--json"])
    assert code == 1
    assert json.loads(out)["found"] is False
    assert err == ""
