"""Train LeRobot's ACT, unmodified, on the states of a data set, in LeRobot's own virtual environment.

python examples/lerobot_act.py out/demonstrations/data out/act
python examples/lerobot_server.py out/act

All frames are kept in memory: LeRobot's own loader takes 9 ms per frame, which would be most of the training time.
"""

import sys
import time
from pathlib import Path

import numpy as np
import torch
from chunked_mlp import ACTION, CHUNK, NOISE, OBJECTS, PLAYED, STATE, frames_of
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

SIZE = {"dim_model": 128, "dim_feedforward": 512, "n_heads": 4, "n_encoder_layers": 3, "use_vae": False}
MEAN_STD = dict.fromkeys(("STATE", "ENV", "ACTION"), NormalizationMode.MEAN_STD)  # by default ENV is not normalised


def train(data, out, minutes=25.0, batch=64, peak=1e-3, seed=0):
    """Fit ACT to a data set without the last tenth of its episodes, which test the predictions."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    seen, chunks = frames_of(data)
    split = len(seen) - len(seen) // 10
    n, m = len(NOISE), chunks[0].shape[-1]
    config = ACTConfig(
        chunk_size=CHUNK,
        n_action_steps=PLAYED,
        device="cpu",
        dropout=0.0,
        normalization_mapping=MEAN_STD,
        input_features={
            STATE: PolicyFeature(FeatureType.STATE, (n,)),
            OBJECTS: PolicyFeature(FeatureType.ENV, (seen[0].shape[1] - n,)),
        },
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (m,))},
        **SIZE,
    )
    policy = ACTPolicy(config)
    stats = LeRobotDatasetMetadata("local/data", root=data).stats
    before, after = make_pre_post_processors(config, dataset_stats=stats)

    def frames(seen, chunks):
        ins, outs = np.concatenate(seen), np.concatenate(chunks)
        return torch.tensor(ins, dtype=torch.float32), torch.tensor(outs, dtype=torch.float32)

    def batch_of(ins, outs):
        pad = torch.zeros(outs.shape[:2], dtype=torch.bool)
        found = {STATE: ins[:, :n], OBJECTS: ins[:, n:], ACTION: outs}
        return before(found) | {"action_is_pad": pad}

    ins, outs = frames(seen[:split], chunks[:split])
    held_in, held_out = frames(seen[split:], chunks[split:])
    noise = torch.tensor(np.append(NOISE, np.zeros(ins.shape[1] - n)), dtype=torch.float32)
    optimizer = torch.optim.AdamW(policy.parameters(), lr=peak, weight_decay=1e-4)
    began, step, due = time.monotonic(), 0, 0.0
    while (share := (time.monotonic() - began) / (60 * minutes)) < 1.0:
        for group in optimizer.param_groups:
            group["lr"] = peak * min(1.0, step / 500) * 0.5 * (1 + np.cos(np.pi * share))
        pick = torch.randint(len(ins), (batch,))
        loss, _ = policy.forward(batch_of(ins[pick] + noise * torch.randn(batch, ins.shape[1]), outs[pick]))
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimizer.step()
        step += 1
        if share >= due:
            due += 0.05
            pick = torch.randperm(len(held_in))[:1000]
            with torch.no_grad():
                policy.eval()
                found = after(policy.predict_action_chunk(batch_of(held_in[pick], held_out[pick])))
                policy.train()
            off_mm = 1e3 * (found - held_out[pick])[:, :PLAYED, :3].abs().mean((0, 1)).numpy()
            print(f"step {step}: loss {loss.item():.4f}; held out, position off by {off_mm.round(2)} mm", flush=True)
    for part in (policy, before, after):
        part.save_pretrained(out)


if __name__ == "__main__":
    train(Path(sys.argv[1]), Path(sys.argv[2]), *map(float, sys.argv[3:]))
