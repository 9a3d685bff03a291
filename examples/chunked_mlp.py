"""A plain policy: a network with three hidden layers that predicts the next second of actions from one observation.

It sees and predicts positions relative to the tip, so that what it learns in one place holds in others. Trained with
PyTorch on a data set of ``trocar study demonstrations`` of one transfer; used with NumPy alone:

python examples/chunked_mlp.py out/demonstrations/data out/mlp
trocar run peg-transfer --transfers 1 --method policy-calibrated --policy out/mlp --set observation=state,objects
"""

import shutil
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

CHUNK, PLAYED = 30, 5  # frames predicted, and frames played before the next prediction
STATE, OBJECTS, ACTION = "observation.state", "observation.environment_state", "action"
HOME_M = 0.004
NOISE = np.array([0.002] * 3 + [0.02] * 4 + [0.03])  # training noise on the arm's state (SD; m, quaternion, rad)


class ChunkedMlp:
    """Plays the first actions of each prediction; ends when the task is done and the tip is back where it began."""

    def __init__(self, folder):
        with np.load(folder / "weights.npz") as found:
            self.weights = dict(found)
        self.chunk, self.begin = [], None

    def __call__(self, seen):
        """Return the next action, or None."""
        tip, objects = seen["state"][:3], seen["objects"]
        self.begin = tip if self.begin is None else self.begin
        if not self.chunk:
            if objects[14] and np.linalg.norm(tip - self.begin) < HOME_M:  # seen to be done
                return None
            self.chunk = list(self.predicted(np.hstack([seen["state"], objects, self.begin]))[:PLAYED])
        return self.chunk.pop(0)

    def predicted(self, raw):
        """Return the next actions (CHUNK, n) from the present state, objects and first position."""
        w, n = self.weights, sum(name.startswith("bias") for name in self.weights)
        x = (features(raw, np) - w["mean_in"]) / w["sd_in"]
        for k in range(n):
            x = x @ w[f"weight{k}"].T + w[f"bias{k}"]
            x = np.maximum(x, 0.0) if k < n - 1 else x
        actions = x.reshape(CHUNK, -1) * w["sd_out"] + w["mean_out"]
        actions[:, :3] += raw[:3]
        return actions


def make(folder):
    """Return the policy; ``trocar run --policy DIR`` calls this."""
    return ChunkedMlp(folder)


def features(raw, library):
    """Return what the network sees (..., 18) of state (8), objects (15) and the tip's first position (3)."""
    if raw.shape[-1] != 26:
        raise ValueError("this network does one transfer with one arm: give --transfers 1")
    tip = raw[..., :3]
    places = [raw[..., at : at + 3] - tip for at in (13, 19, 23)]  # grasp, target, first position
    others = [raw[..., 3:8], raw[..., 16:19], raw[..., 22:23]]  # orientation and jaw, grasp's yaw and opening, done
    return library.concatenate([*places, *others], -1)


def frames_of(data):
    """Return, by episode, what is known at each frame (n, 26), and the actions that follow it (n, CHUNK, m)."""
    import pyarrow.parquet as pq

    seen, chunks = [], []
    for file in sorted((data / "data").rglob("*.parquet")):
        table = pq.read_table(file, columns=[STATE, OBJECTS, ACTION]).to_pydict()
        state, objects, action = (np.array(table[name]) for name in (STATE, OBJECTS, ACTION))
        at = np.minimum(np.arange(len(action))[:, None] + np.arange(CHUNK), len(action) - 1)
        seen.append(np.hstack([state, objects, np.tile(state[0, :3], (len(state), 1))]))
        chunks.append(action[at])
    return seen, chunks


def train(data, out, epochs=80, width=512, batch=256, seed=0):
    """Fit the network to a data set; the last tenth of its episodes (at least one) tests the predictions."""
    import torch
    from torch import nn

    def tensors(part):
        raw, actions = (torch.tensor(np.concatenate(each[part]), dtype=torch.float32) for each in (seen, chunks))
        actions[..., :3] -= raw[:, None, :3]
        return raw, actions

    torch.manual_seed(seed)
    seen, chunks = frames_of(data)
    split = len(seen) - max(1, len(seen) // 10)
    (raw, actions), (held_raw, held_actions) = tensors(slice(split)), tensors(slice(split, None))
    ins = features(raw, torch)
    scale = {"mean_in": ins.mean(0), "sd_in": ins.std(0) + 1e-3}
    scale |= {"mean_out": actions.mean((0, 1)), "sd_out": actions.std((0, 1)) + 1e-3}

    def predicted(raw):
        found = model((features(raw, torch) - scale["mean_in"]) / scale["sd_in"])
        return found.reshape(len(raw), CHUNK, -1)  # in standard deviations

    def scaled(actions):
        return (actions - scale["mean_out"]) / scale["sd_out"]

    sizes = [ins.shape[1], width, width, width, actions[0].numel()]
    layers = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    model = nn.Sequential(*[part for layer in layers for part in (layer, nn.ReLU())][:-1])
    noise = torch.tensor(NOISE, dtype=torch.float32)
    steps = epochs * (len(raw) // batch)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 1e-3, total_steps=steps)
    for step in range(steps):
        pick = torch.randint(len(raw), (batch,))
        now, after = raw[pick], actions[pick]  # copies
        moved = noise * torch.randn(batch, len(NOISE))
        now[:, : len(NOISE)] += moved
        after[..., :3] -= moved[:, None, :3]  # from a tip that is off its path, the same actions lead back
        loss = (predicted(now) - scaled(after)).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % (steps // 20) == 0 or step == steps - 1:
            with torch.no_grad():
                off = (predicted(held_raw) - scaled(held_actions))[:, :PLAYED, :3].abs().mean((0, 1))
            off_mm = 1e3 * (off * scale["sd_out"][:3]).numpy()
            print(f"step {step} of {steps}: loss {loss.item():.4f}; held out, position off by {off_mm.round(2)} mm")
    named = {f"weight{k}": layer.weight.detach().numpy() for k, layer in enumerate(layers)}
    named |= {f"bias{k}": layer.bias.detach().numpy() for k, layer in enumerate(layers)}
    out.mkdir(parents=True, exist_ok=True)
    np.savez(out / "weights.npz", **{name: value.numpy() for name, value in scale.items()}, **named)
    shutil.copy(__file__, out / "policy.py")


if __name__ == "__main__":
    train(Path(sys.argv[1]), Path(sys.argv[2]))
