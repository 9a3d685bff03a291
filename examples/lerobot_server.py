"""Serves a policy that LeRobot trained, in LeRobot's own virtual environment, to ``trocar run``.

python examples/lerobot_server.py out/act/checkpoints/last/pretrained_model --port 5555
trocar run peg-transfer --transfers 1 --method policy-calibrated --policy tcp://127.0.0.1:5555 \
    --set observation=state,objects

One connection is one trial; several may be open at a time.
"""

import argparse
import json
import socketserver
import threading

import numpy as np
import torch
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

HOME_M = 0.004
NAMES = {"state": "observation.state", "objects": "observation.environment_state"}


class Trial(socketserver.StreamRequestHandler):
    """One trial: a line in, a line out."""

    def handle(self):
        """Answer each observation with an action; null once the task is done and the arm is back."""
        policy = ACTPolicy.from_pretrained(self.server.folder)
        before, after = make_pre_post_processors(policy.config, self.server.folder)
        policy.reset()
        begin = None
        for line in self.rfile:
            said = json.loads(line)
            if "observation" not in said:
                continue
            seen = said["observation"]
            begin = seen["state"][:3] if begin is None else begin
            action = None
            # the last of each transfer's 15 numbers: done
            if not (all(seen["objects"][14::15]) and np.linalg.norm(np.subtract(seen["state"][:3], begin)) < HOME_M):
                batch = {NAMES[key]: torch.tensor(seen[key], dtype=torch.float32)[None] for key in NAMES}
                with torch.no_grad(), self.server.lock:
                    action = after(policy.select_action(before(batch)))[0].tolist()
            self.wfile.write(json.dumps({"action": action}).encode() + b"\n")


class Server(socketserver.ThreadingTCPServer):
    """Serves the policy of one folder."""

    allow_reuse_address, daemon_threads = True, True

    def __init__(self, folder, port):
        super().__init__(("127.0.0.1", port), Trial)
        self.folder, self.lock = folder, threading.Lock()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder")
    parser.add_argument("--port", type=int, default=5555)
    given = parser.parse_args()
    torch.set_num_threads(1)
    with Server(given.folder, given.port) as server:
        print(f"serving {given.folder} on port {given.port}", flush=True)
        server.serve_forever()
