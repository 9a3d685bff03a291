"""Commands of the suture task, with one line each for the help, so that listing them imports nothing heavy."""

from trocar.cli.group import Known

PLAN_SUTURE = Known(
    "Plan where to place sutures round a circle, and in which direction to drive each.",
    f"{__name__}.plan_suture:suture",
    "trocar plan suture --preset paper-demo --out out/plan",
)
PLAN_SETUP = Known(
    "Search for the circle, port and grasp whose best plan of sutures scores highest.",
    f"{__name__}.plan_setup:setup",
    "trocar plan setup --free circle --free port --evaluations 1000",
)
STUDY_SUTURE = Known(
    "Print Table I of the circle-suture paper beside ours, the changes of direction, and the sweep over lambda.",
    f"{__name__}.study_suture:suture",
    "trocar study suture --out out/study",
)
STUDY_SETUPS = Known(
    "Draw which circles arms can sew with needles of the catalogue, as maps over the place of the base.",
    f"{__name__}.study_setups:setups",
    "trocar study suture-setup --arm psm-classic --needle SH --out out/setups",
)
