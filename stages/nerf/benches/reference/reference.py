"""A plain PyTorch hash-grid NeRF with nerfacc's recipe: what the bench compares with.

    python reference.py FOLDER    reads what exchange.rs wrote there, prints one JSON object per line

Knows rays, colours and the shape of the field from FOLDER, and nothing of the Rust code. The recipe is that of nerfacc's
examples (Li et al. 2023): an occupancy grid that skips empty cells, a first pass over densities that drops hidden
samples, a second pass with gradients over the rest, Adam with a warm-up and three drops of the rate. Everything is
ordinary PyTorch on the CPU: no custom kernels, no compiler.
"""

import json
import math
import sys
import time
from pathlib import Path

import numpy
import torch
from torch import nn

# The spatial hash's factors for y and z, as 32-bit integers with a sign.
PRIMES = (2_654_435_761 - (1 << 32), 805_459_861)
CORNERS = [(c & 1, c >> 1 & 1, c >> 2) for c in range(8)]
CUT = 1e-4


class LookUp(torch.autograd.Function):
    """Weighted sums of eight entries. The formulations are the fastest that were found on the CPU: an embedding bag, and
    one scatter per feature, ten times faster than the bag's own backward pass."""

    @staticmethod
    def forward(ctx, table, entry, weight):
        ctx.save_for_backward(entry, weight)
        ctx.entries = len(table)
        return nn.functional.embedding_bag(entry.t(), table, mode="sum", per_sample_weights=weight.t())

    @staticmethod
    def backward(ctx, d):
        entry, weight = ctx.saved_tensors
        entry, zeros = entry.flatten().long(), d.new_zeros(ctx.entries)
        columns = [zeros.scatter_add(0, entry, (weight * column).flatten()) for column in d.unbind(1)]
        return torch.stack(columns, 1), None, None


class HashGrid(nn.Module):
    """Trilinear look-up in the multiresolution hash grid (Mueller et al. 2022)."""

    def __init__(self, levels):
        super().__init__()
        self.levels = levels
        tables = [torch.empty(level["entries"], 2).uniform_(-1e-4, 1e-4) for level in levels]
        self.tables = nn.ParameterList(nn.Parameter(table) for table in tables)

    def forward(self, x):
        levels = zip(self.levels, self.tables)
        return torch.cat([LookUp.apply(table, *self.corners(x, level)) for level, table in levels], 1)

    @torch.no_grad()
    def corners(self, x, level):
        x = x * level["scale"] + 0.5
        cell = x.floor()
        near, far = (1 - x + cell).unbind(1), (x - cell).unbind(1)
        x, y, z = cell.int().unbind(1)
        nx, ny, _ = level["resolution"]
        p, q = (nx, nx * ny) if level["dense"] else PRIMES
        xs, ys, zs = (x, x + 1), (y * p, y * p + p), (z * q, z * q + q)
        if level["dense"]:
            entry = torch.stack([xs[i] + ys[j] + zs[k] for i, j, k in CORNERS])
            entry = torch.where(entry >= level["entries"], entry - level["entries"], entry)
        else:
            entry = torch.stack([xs[i] ^ ys[j] ^ zs[k] for i, j, k in CORNERS]) & (level["entries"] - 1)
        share = near, far
        return entry, torch.stack([share[i][0] * share[j][1] * share[k][2] for i, j, k in CORNERS])


class TruncatedExp(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        ctx.save_for_backward(x)
        return x.exp()

    @staticmethod
    def backward(ctx, d):
        return d * ctx.saved_tensors[0].clamp(-15, 15).exp()


def harmonics(d):
    """Real spherical harmonics of degrees 0 to 3."""
    x, y, z = d.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack([
        torch.full_like(x, 0.2820948), -0.48860252 * y, 0.48860252 * z, -0.48860252 * x,
        1.0925485 * x * y, -1.0925485 * y * z, 0.31539157 * (3 * zz - 1), -1.0925485 * x * z, 0.54627424 * (xx - yy),
        -0.5900436 * y * (3 * xx - yy), 2.8906114 * x * y * z, -0.4570458 * y * (5 * zz - 1),
        0.37317634 * z * (5 * zz - 3), -0.4570458 * x * (5 * zz - 1), 1.4453057 * z * (xx - yy),
        -0.5900436 * x * (xx - 3 * yy),
    ], 1)


def mlp(*widths):
    layers = []
    for inputs, outputs in zip(widths, widths[1:]):
        layers += [nn.Linear(inputs, outputs, bias=False), nn.ReLU()]
        nn.init.xavier_uniform_(layers[-2].weight)
    return nn.Sequential(*layers[:-1])


class Field(nn.Module):
    def __init__(self, levels):
        super().__init__()
        self.grid = HashGrid(levels)
        self.density_net = mlp(2 * len(levels), 64, 16)
        self.color_net = mlp(32, 64, 64, 3)

    def density(self, x):
        geometry = self.density_net(self.grid(x.clamp(min=0)))
        return TruncatedExp.apply(geometry[:, 0] - 1), geometry

    def forward(self, x, d):
        sigma, geometry = self.density(x)
        return sigma, self.color_net(torch.cat([geometry, harmonics(d)], 1)).sigmoid()


class Occupancy:
    """nerfacc's grid: a slowly forgetting maximum of the optical depth of a step; -1 where no camera looks."""

    def __init__(self, values, config):
        self.values = values
        self.size = torch.tensor(values.shape[::-1])
        self.resolution, self.step = config["occupancy_resolution"], 1 / config["march_steps"]
        self.updates = 0
        self.binary = values >= 0

    def at(self, x):
        cell = (x * self.resolution).long().clamp(min=0).minimum(self.size - 1)
        return self.binary[cell[..., 2], cell[..., 1], cell[..., 0]]

    @torch.no_grad()
    def update(self, field):
        cells = (self.values.flatten() >= 0).nonzero()[:, 0]
        if self.updates >= 16:
            occupied = self.binary.flatten().nonzero()[:, 0]
            pick = [of[torch.randint(len(of), (len(of) // 8,))] for of in (cells, occupied) if len(of)]
            cells = torch.cat(pick).unique()
        nx, ny, _ = self.size.tolist()
        corner = torch.stack([cells % nx, cells // nx % ny, cells // (nx * ny)], 1)
        x = (corner + torch.rand(len(cells), 3)) / self.resolution
        fresh = torch.cat([field.density(part)[0] for part in x.split(1 << 16)]) * self.step
        flat = self.values.view(-1)
        flat[cells] = torch.maximum(flat[cells] * (0.95 if self.updates else 0.0), fresh)
        seen = flat[flat >= 0]
        self.binary = self.values >= min(0.01, 0.5 * seen.mean().item())
        self.updates += 1


class Renderer:
    def __init__(self, scene):
        self.shortest, self.cone = 1 / scene["config"]["march_steps"], scene["march_cone"]
        self.occupancy = Occupancy(scene["occupancy"], scene["config"])
        self.field = Field(scene["levels"])

    @torch.no_grad()
    def march(self, rays, jitter):
        """Samples of all rays in occupied cells: ray index, middle, length."""
        start, end = rays[:, 6], rays[:, 7]
        step = lambda t: (t * self.cone).clamp(min=self.shortest)
        t = start + jitter * step(start)
        middles, lengths = [], []
        # One step at least, so that a part of an image that no ray hits is nothing rather than an error.
        while not middles or (t < end).any():
            dt = step(t)
            middles.append(torch.where(t < end, t + 0.5 * dt, torch.inf))
            lengths.append(dt)
            t = t + dt
        middle, length = torch.stack(middles, 1), torch.stack(lengths, 1)
        ray, k = (middle < torch.inf).nonzero(as_tuple=True)
        middle, length = middle[ray, k], length[ray, k]
        inside = self.occupancy.at(rays[ray, :3] + middle[:, None] * rays[ray, 3:6])
        return ray[inside], middle[inside], length[inside]

    def weights(self, sigma, length, ray, count):
        """Weight of every sample, and transmittance before it and behind each ray."""
        depth = (sigma * length).double()
        total = depth.cumsum(0)
        sums = torch.zeros(count, dtype=torch.float64).index_add(0, ray, depth)
        before = total - depth - (sums.cumsum(0) - sums)[ray]
        through = (-before).exp().float()
        return through * (1 - (-depth).exp().float()), through, (-sums).exp().float()

    def __call__(self, rays, jitter, background):
        ray, middle, length = self.march(rays, jitter)
        with torch.no_grad():
            sigma, _ = self.field.density(rays[ray, :3] + middle[:, None] * rays[ray, 3:6])
            visible = self.weights(sigma, length, ray, len(rays))[1] >= CUT
            ray, middle, length = ray[visible], middle[visible], length[visible]
            x = rays[ray, :3] + middle[:, None] * rays[ray, 3:6]
        sigma, rgb = self.field(x, rays[ray, 8:])
        weight, _, end = self.weights(sigma, length, ray, len(rays))
        color = torch.zeros(len(rays), 3).index_add(0, ray, weight[:, None] * rgb)
        return color + end[:, None] * background, len(ray)


def read(folder):
    scene = json.loads((folder / "scene.json").read_text())
    load = lambda name, shape: torch.from_numpy(numpy.fromfile(folder / name, "<f4").reshape(shape).copy())
    scene["occupancy"] = load("occupancy.f32", scene["occupancy_size"][::-1])
    for part in ("train", "test"):
        scene[part] = load(f"{part}.rays.f32", (-1, 11)), load(f"{part}.rgba.f32", (-1, 4))
    return scene


def rate(step, steps):
    """Warm-up over 100 steps from a hundredth, then a third at 50, 75 and 90 per cent."""
    return min(1, 0.01 + 0.99 * step / 100) * 0.33 ** sum(step >= steps * part for part in (0.5, 0.75, 0.9))


@torch.no_grad()
def evaluate(renderer, scene):
    """Mean PSNR of the held-out views, rays and samples rendered a second, and the views."""
    rays, rgba = scene["test"]
    background = torch.tensor(scene["background"])
    start, samples, images = time.perf_counter(), 0, []
    for part in rays.split(4096):
        color, count = renderer(part, torch.zeros(len(part)), background)
        images.append(color)
        samples += count
    seconds = time.perf_counter() - start
    error = (torch.cat(images).clamp(0, 1) - rgba[:, :3]).square().view(scene["test_views"], -1).mean(1)
    return (-10 * error.log10()).mean().item(), len(rays) / seconds, samples / seconds, torch.cat(images)


def main():
    torch.set_num_threads(2)
    torch.manual_seed(0)
    folder = Path(sys.argv[1])
    scene = read(folder)
    renderer = Renderer(scene)
    rays, rgba = scene["train"]
    options, field = scene["options"], renderer.field
    # AdamW's decay is not L2: Adam's is, and on matrices only, as in nerfacc and instant-ngp.
    groups = [
        {"params": field.grid.parameters(), "weight_decay": 0.0},
        {"params": [*field.density_net.parameters(), *field.color_net.parameters()], "weight_decay": options["l2"]},
    ]
    adam = torch.optim.Adam(groups, lr=options["rate"], betas=(0.9, 0.99), eps=1e-15, fused=True)
    count, samples, seconds, processor_seconds = 256, 0, 0.0, 0.0
    for step in range(options["steps"]):
        start, work = time.perf_counter(), time.process_time()
        for group in adam.param_groups:
            group["lr"] = options["rate"] * rate(step, options["steps"])
        pick = torch.randint(len(rays), (count,))
        background = torch.rand(count, 3)
        color, kept = renderer(rays[pick], torch.rand(count), background)
        rgb, alpha = rgba[pick].split((3, 1), 1)
        loss = nn.functional.smooth_l1_loss(color, alpha * rgb + (1 - alpha) * background)
        adam.zero_grad()
        loss.backward()
        adam.step()
        if (step + 1) % 16 == 0:
            renderer.occupancy.update(field)
        samples += kept
        count = min(max(int(count * options["samples"] / max(kept, 1)), 16), 1 << 16)
        seconds += time.perf_counter() - start
        processor_seconds += time.process_time() - work
        if step + 1 in scene["marks"]:
            psnr, rays_a_second, samples_a_second, image = evaluate(renderer, scene)
            print(json.dumps({
                "step": step + 1, "seconds": seconds, "processor_seconds": processor_seconds, "samples": samples, "psnr": psnr,
                "rays_a_second": rays_a_second, "samples_a_second": samples_a_second,
            }), flush=True)
    image.numpy().astype("<f4").tofile(folder / "reference.f32")


if __name__ == "__main__":
    main()
