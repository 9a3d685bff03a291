"""Contradictory options and options without effect are refused, and files of the wrong kind are named."""

import zipfile

import numpy as np
import pytest

from trocar.calibration.models import MODELS, save_model
from trocar.calibration.plant import PSM1_GREY
from trocar.calibration.recording import Recording

STUDY, RUN = "study peg-transfer", "run peg-transfer"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    rng = np.random.default_rng(0)
    q = np.clip(np.cumsum(rng.normal(0, 0.05, (60, 6)), axis=0), -1, 1)
    recording = Recording(q, PSM1_GREY.measure(PSM1_GREY.run(q), rng), np.ones(60, bool), np.arange(60.0), "made")
    np.savez(folder / "recording.npz", q_cmd=recording.q_cmd, q_phy=recording.q_phy)
    save_model(MODELS["offset"].fit(recording, rng), folder / "model.npz")
    np.savez(folder / "other.npz", something=q)
    (folder / "file").write_text("")
    (folder / "folder").mkdir()
    with zipfile.ZipFile(folder / "many.npz", "w") as many:
        many.writestr("q_cmd.npy", b"")
        many.comment = b""
    _claim_long_list(folder / "many.npz")
    return folder


def _claim_long_list(path):
    """Let a zip's last record claim a list of 16 MB, which a file of 200 000 members really has."""
    data = bytearray(path.read_bytes())
    place = data.rfind(b"PK\5\6")
    data[place + 12 : place + 16] = (16 << 20).to_bytes(4, "little")
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (f"{STUDY} --variants ,", "--variants ',' has a comma too many; choose from unilateral, bilateral, handover"),
        (f"{STUDY} --methods best,best", "--methods names 'best' twice; name each once"),
        (f"{STUDY} --methods uncalibrated --model ridge", "--model ridge has no effect with uncalibrated"),
        ("study debridement --arms 1,,2", "--arms '1,,2' has a comma too many"),
        ("study debridement --model ridge", "--model ridge has no effect with best"),
        (f"{STUDY} --report-only --out nothere", "folder 'nothere' does not exist; give that of a study with --out"),
        (f"{STUDY} --report-only --out folder", "folder 'folder' holds no study"),
        (f"{STUDY} --out file", "--out 'file' is a file; give a folder"),
        (f"{RUN} --method uncalibrated --model lstm", "--model lstm has no effect with --method uncalibrated"),
        ("run debridement --calibration images", "--calibration images has no effect with --method best"),
        (f"{RUN} --method adaptive --new-session", "--method adaptive makes none; drop --new-session"),
        (f"{RUN} --flaw print=-0.1mm", "flaw 'print=-0.1mm' has a negative size; give 0 or more"),
        (f"{RUN} --flaw depth=2mm", "give how many times what was recorded, as in 'depth=2x'"),
        (f"{RUN} --out file", "'file' is a file; choose a folder with --out"),
        ("calibrate evaluate recording.npz model.npz", "'recording.npz' is a recording, not a cable model"),
        ("calibrate evaluate model.npz model.npz", "'model.npz' is a 'trocar cable model', not a recording"),
        ("calibrate evaluate other.npz recording.npz", "'other.npz' is not a trocar cable model, it holds something"),
        ("calibrate evaluate folder recording.npz", "'folder' is a folder; give a file, a trocar cable model"),
        ("calibrate evaluate many.npz recording.npz", "is a zip whose list of members alone is 16 MB long"),
        ("calibrate evaluate model.npz many.npz", "is a zip whose list of members alone is 16 MB long"),
        ("plan transfer many.npz", "is a zip whose list of members alone is 16 MB long"),
        ("plan transfer folder", "'folder' is a folder; give a .npy or .npz with waypoints"),
        ("register points folder file", "'folder' is a folder; give a .npy file"),
        ("register block folder", "'folder' is a folder; give an .npz or .npy file"),
        ("analyse folder", "recording 'folder' is a folder; give a CSV file"),
        ("report file", "'file' is a file; give the folder of a run"),
        ("view file", "'file' is a file; give the folder of a run"),
    ],
)
def test_one_sentence_says_what_is_wrong(trocar, files, monkeypatch, line, said):
    monkeypatch.chdir(files)
    code, out, err = trocar(*line.split())
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert said in err


def test_a_flaw_without_a_unit_is_given_in_times_what_was_recorded(trocar, tmp_path):
    code, _, err = trocar(*RUN.split(), "--flaw", "depth=2x", "--station", "nowhere", "--out", tmp_path)
    assert code == 2 and "station 'nowhere' is unknown" in err, "the flaw was read"
