"""A plain policy: a network with three hidden layers that predicts the next second of actions from one observation.

Trained with PyTorch on a data set of ``trocar study demonstrations``; used with NumPy alone:

python examples/chunked_mlp.py out/demonstrations/data out/mlp
trocar run peg-transfer --transfers 1 --method policy-calibrated --policy out/mlp --set observation=state,objects
"""

import shutil
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

CHUNK, PLAYED = 30, 10  # frames predicted, and frames played before the next prediction
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
        now = np.hstack([seen["state"], seen["objects"]])
        self.begin = now[:3] if self.begin is None else self.begin
        if not self.chunk:
            # the last of each transfer's 15 numbers: done
            if seen["objects"][14::15].all() and np.linalg.norm(now[:3] - self.begin) < HOME_M:
                return None
            self.chunk = list(self.predicted(now)[:PLAYED])
        return self.chunk.pop(0)

    def predicted(self, now):
        """Return the next actions (CHUNK, n) from the present state and objects."""
        w, n = self.weights, sum(name.startswith("bias") for name in self.weights)
        x = (now - w["mean_in"]) / w["sd_in"]
        for k in range(n):
            x = x @ w[f"weight{k}"].T + w[f"bias{k}"]
            x = np.maximum(x, 0.0) if k < n - 1 else x
        return x.reshape(CHUNK, -1) * w["sd_out"] + w["mean_out"]


def make(folder):
    """Return the policy; ``trocar run --policy DIR`` calls this."""
    return ChunkedMlp(folder)


def frames_of(data):
    """Return, by episode, the observations (n, k) and the actions that follow each of them (n, CHUNK, m)."""
    import pyarrow.parquet as pq

    seen, chunks = [], []
    for file in sorted((data / "data").rglob("*.parquet")):
        table = pq.read_table(file, columns=[STATE, OBJECTS, ACTION]).to_pydict()
        state, objects, action = (np.array(table[name]) for name in (STATE, OBJECTS, ACTION))
        at = np.minimum(np.arange(len(action))[:, None] + np.arange(CHUNK), len(action) - 1)
        seen.append(np.hstack([state, objects]))
        chunks.append(action[at])
    return seen, chunks


def train(data, out, epochs=80, width=512, batch=256, seed=0):
    """Fit the network to a data set without the last tenth of its episodes, which test the predictions."""
    import torch
    from torch import nn

    torch.manual_seed(seed)
    seen, chunks = frames_of(data)
    split = len(seen) - len(seen) // 10
    x, y = np.concatenate(seen[:split]), np.concatenate(chunks[:split])
    scale = {"mean_in": x.mean(0), "sd_in": x.std(0) + 1e-3}
    scale |= {"mean_out": y.mean((0, 1)), "sd_out": y.std((0, 1)) + 1e-3}

    def tensors(seen, chunks):
        ins = (np.concatenate(seen) - scale["mean_in"]) / scale["sd_in"]
        outs = (np.concatenate(chunks) - scale["mean_out"]) / scale["sd_out"]
        return torch.tensor(ins, dtype=torch.float32), torch.tensor(outs.reshape(len(outs), -1), dtype=torch.float32)

    ins, outs = tensors(seen[:split], chunks[:split])
    held_in, held_out = tensors(seen[split:], chunks[split:])
    sizes = [ins.shape[1], width, width, width, outs.shape[1]]
    layers = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    model = nn.Sequential(*[part for layer in layers for part in (layer, nn.ReLU())][:-1])
    noise = torch.tensor(np.append(NOISE, np.zeros(ins.shape[1] - len(NOISE))) / scale["sd_in"], dtype=torch.float32)
    steps = epochs * (len(ins) // batch)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 1e-3, total_steps=steps)
    for step in range(steps):
        pick = torch.randint(len(ins), (batch,))
        blurred = ins[pick] + noise * torch.randn(batch, ins.shape[1])
        loss = (model(blurred) - outs[pick]).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % (steps // 20) == 0 or step == steps - 1:
            with torch.no_grad():
                off = (model(held_in) - held_out).reshape(len(held_in), CHUNK, -1)[:, :PLAYED, :3].abs().mean((0, 1))
            off_mm = 1e3 * off.numpy() * scale["sd_out"][:3]
            print(f"step {step} of {steps}: loss {loss.item():.4f}; held out, position off by {off_mm.round(2)} mm")
    named = {f"weight{k}": layer.weight.detach().numpy() for k, layer in enumerate(layers)}
    named |= {f"bias{k}": layer.bias.detach().numpy() for k, layer in enumerate(layers)}
    out.mkdir(parents=True, exist_ok=True)
    np.savez(out / "weights.npz", **scale, **named)
    shutil.copy(__file__, out / "policy.py")


if __name__ == "__main__":
    train(Path(sys.argv[1]), Path(sys.argv[2]))
