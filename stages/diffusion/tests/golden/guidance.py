"""Golden numbers for ../guidance/golden.rs: ten guidance steps of RSD, SDS and VSD with tiny-x4, by PyTorch, diffusers and PEFT.

    python guidance.py   # writes guidance.json beside itself

Needs torch, diffusers, transformers, peft and numpy. Random numbers are those of the crate `compute`: `Random` below is its generator.
"""

import json
from pathlib import Path

import numpy as np
import torch
from diffusers import UNet2DConditionModel
from peft import LoraConfig
from transformers import CLIPTextModel, CLIPTokenizer

HERE = Path(__file__).resolve().parent
MODEL = HERE.parents[1] / "models" / "tiny-x4"
PROMPTS = ["high resolution, 4K, photo", "blurry, low quality"]
SEED, NOISE_LEVEL, CROP, STEPS, WARM_UP, SCALE, LORA_RATE, ANCHOR, CAMERA_DROP = 3, 20, 10, 10, 2, 2.0, 1e-3, 0.1, 0.5
SIZES = [(14, 12), (12, 16)]
ALPHA_BAR = (1 - torch.linspace(1e-4**0.5, 0.02**0.5, 1000, dtype=torch.float64) ** 2).cumprod(0)


class Random:
    """Philox4x32-10, keyed by a seed and the name of what the numbers are for."""

    def __init__(self, seed, domain):
        name = 0xCBF29CE484222325
        for byte in domain.encode():
            name = (name ^ byte) * 0x100000001B3 % 2**64
        counter = [seed % 2**32, seed >> 32, name % 2**32, name >> 32]
        self.key = [int(x) for x in self.philox([np.uint64(x) for x in counter], [0, 0])[:2]]

    @staticmethod
    def philox(c, key):
        low, high, k = np.uint64(0xFFFFFFFF), np.uint64(32), list(key)
        for _ in range(10):
            a, b = np.uint64(0xD2511F53) * c[0], np.uint64(0xCD9E8D57) * c[2]
            c = [(b >> high) ^ c[1] ^ np.uint64(k[0]), b & low, (a >> high) ^ c[3] ^ np.uint64(k[1]), a & low]
            k = [(k[0] + 0x9E3779B9) % 2**32, (k[1] + 0xBB67AE85) % 2**32]
        return c

    def bits(self, step, elements):
        elements = np.asarray(elements, dtype=np.uint64)
        counter = [elements & np.uint64(0xFFFFFFFF), elements >> np.uint64(32)]
        return self.philox([*counter, np.uint64(step % 2**32), np.uint64(step >> 32)], self.key)

    def normals(self, step, *shape):
        a, b, *_ = (x.astype(np.float64) for x in self.bits(step, np.arange(np.prod(shape))))
        values = np.sqrt(-2 * np.log((a + 0.5) / 2**32)) * np.cos(2 * np.pi * b / 2**32)
        return torch.from_numpy(values.astype(np.float32)).reshape(shape)

    def uniform(self, step, element):
        return (int(self.bits(step, element)[0]) >> 8) / 2**24

    def below(self, step, element, n):
        a, b, *_ = self.bits(step, element)
        return ((int(a) << 32 | int(b)) * n) >> 64


class WithCamera(torch.nn.Module):
    """The noise level's embedding plus, if a camera is set, the camera's."""

    def __init__(self, inner, width):
        super().__init__()
        self.inner, self.camera = inner, None
        self.linear_1, self.linear_2 = torch.nn.Linear(16, width), torch.nn.Linear(width, width)

    def forward(self, labels):
        embedding = self.inner(labels)
        if self.camera is not None:
            embedding = embedding + self.linear_2(torch.nn.functional.silu(self.linear_1(self.camera)))
        return embedding


def a_s(t):
    """Factors of the latent and of the noise, ready for [N, C, h, w]."""
    alpha_bar = ALPHA_BAR[t].reshape(-1, 1, 1, 1)
    return alpha_bar.sqrt().float(), (1 - alpha_bar).sqrt().float()


class Prior:
    def __init__(self):
        load = dict(torch_dtype=torch.float32)
        self.unet = UNet2DConditionModel.from_pretrained(MODEL / "unet", **load).eval().requires_grad_(False)
        tokenizer = CLIPTokenizer.from_pretrained(MODEL / "tokenizer")
        text = CLIPTextModel.from_pretrained(MODEL / "text_encoder", **load).eval()
        ids = tokenizer(PROMPTS, padding="max_length", max_length=77, truncation=True, return_tensors="pt").input_ids
        with torch.no_grad():
            self.good, self.bad = text(ids).last_hidden_state.split(1)
        self.unet.add_adapter(LoraConfig(r=4, lora_alpha=4, target_modules=["to_q", "to_k", "to_v", "to_out.0"]))
        self.camera = WithCamera(self.unet.class_embedding, self.unet.time_embedding.linear_2.out_features)
        self.unet.class_embedding = self.camera
        self.lora = dict(sorted(self.named_lora()))
        random = Random(SEED, "golden/lora")
        for i, (name, parameter) in enumerate(self.lora.items()):
            parameter.data = random.normals(i, *parameter.shape) * (0.25 if "lora_A" in name else 0.05)

    def named_lora(self):
        """The trainable parameters, named as the crate names them."""
        for name, parameter in self.unet.named_parameters():
            if ".lora_" in name:
                yield "unet." + name.replace(".default", ""), parameter
            elif name.startswith("class_embedding.linear_"):
                yield "camera_" + name.removeprefix("class_"), parameter.requires_grad_()

    def v(self, noisy, low, t, states, cameras=None):
        self.unet.enable_adapters() if cameras is not None else self.unet.disable_adapters()
        self.camera.camera = cameras
        n = len(noisy)
        labels = torch.full((n,), NOISE_LEVEL)
        return self.unet(torch.cat([noisy, low], 1), t, states.expand(n, -1, -1), class_labels=labels).sample


class Residual:
    """h of one view with Adam's moments and, by pixel, its step count."""

    def __init__(self, shape):
        self.h, self.m, self.v, self.visits = (torch.zeros(shape, dtype=torch.float64) for _ in range(4))

    def descend(self, window, g, rate, betas=(0.9, 0.99), eps=0.1):
        at = (slice(None), *window)
        g = g.double()
        self.visits[at] += 1
        self.m[at] = betas[0] * self.m[at] + (1 - betas[0]) * g
        self.v[at] = betas[1] * self.v[at] + (1 - betas[1]) * g * g
        mean = self.m[at] / (1 - betas[0] ** self.visits[at])
        square = self.v[at] / (1 - betas[1] ** self.visits[at])
        self.h[at] -= rate * mean / (square.sqrt() + eps)


def windows(step, sizes, order):
    """Around a pixel drawn evenly, moved inside: a window for each view, in the order of their turns."""
    random = Random(SEED, "optimize/window")
    for place, view in enumerate(order):
        start = []
        for axis, extent in enumerate(sizes[view]):
            centre = random.below(step, 2 * place + axis, extent)
            start.append(min(max(centre - CROP // 2, 0), extent - CROP))
        yield view, (slice(start[0], start[0] + CROP), slice(start[1], start[1] + CROP))


def run(mode, rate):
    prior, vsd, n = Prior(), mode == "vsd", len(SIZES)
    z = [0.6 * Random(SEED, "golden/latent").normals(i, 16, *size) for i, size in enumerate(SIZES)]
    low = [0.5 * Random(SEED, "golden/low").normals(i, 3, *size) for i, size in enumerate(SIZES)]
    cameras = Random(SEED, "golden/camera").normals(0, n, 16)
    residuals = [Residual(latent.shape) for latent in z]
    order = [0, 1] if Random(SEED, "optimize/order").below(0, 1, 2) == 1 else [1, 0]
    optimiser = torch.optim.AdamW(prior.lora.values(), lr=LORA_RATE)
    random = lambda domain: Random(SEED, f"optimize/{domain}")
    log = []
    for step in range(STEPS + (WARM_UP if vsd else 0)):
        guided, line = step - (WARM_UP if vsd else 0), {}
        places = list(windows(step, SIZES, order))
        cut = lambda maps: torch.stack([maps[view][:, *window] for view, window in places])
        current = lambda: cut([latent + residual.h.float() for latent, residual in zip(z, residuals)])
        a, s = a_s(torch.tensor([NOISE_LEVEL]))
        noisy_low = a * cut(low) + s * random("low_noise").normals(step, n, 3, CROP, CROP)
        camera = cameras[[view for view, _ in places]]
        if guided >= 0:
            with torch.no_grad():
                t = [20 + random("timestep").below(step, i, 961) for i in range(n)] if mode == "sds" else [int(1000 * (0.5 + (1 - guided / STEPS) * (0.98 - 0.5)))] * n
                t = torch.tensor(t)
                (a, s), latent = a_s(t), current()
                noise = random("noise").normals(step, *latent.shape)
                noisy = a * latent + s * noise
                bad = prior.v(noisy, noisy_low, t, prior.bad)
                v = bad + SCALE * (prior.v(noisy, noisy_low, t, prior.good) - bad)
                if mode == "sds":
                    g = s**2 * (a * v + s * noisy - noise)
                else:
                    g = latent - (a * noisy - s * v)
                if vsd:
                    g = s**2 * a * (v - prior.v(noisy, noisy_low, t, prior.good, camera)) + ANCHOR * g
            for (view, window), gradient in zip(places, g):
                residuals[view].descend(window, gradient, rate)
            rms = lambda x: x.double().square().mean().sqrt().item()
            residual = rms(cut([residual.h for residual in residuals]))
            line = {"timestep": t.double().mean().item(), "loss": rms(g) ** 2 / 2, "direction": rms(g), "residual": residual}
        if vsd:
            line["lora_loss"] = lora_step(prior, optimiser, current(), noisy_low, camera, step, random)
        log.append(line)
    return log


def lora_step(prior, optimiser, latent, noisy_low, camera, step, random):
    t = torch.tensor([random("lora_timestep").below(step, i, 1000) for i in range(len(latent))])
    kept = torch.tensor([[float(random("camera_drop").uniform(step, i) >= CAMERA_DROP)] for i in range(len(latent))])
    (a, s), noise = a_s(t), random("lora_noise").normals(step, *latent.shape)
    prediction = prior.v(a * latent + s * noise, noisy_low, t, prior.good, camera * kept)
    loss = (prediction - (a * noise - s * latent)).square().mean()
    optimiser.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(prior.lora.values(), 1.0)
    optimiser.step()
    return loss.item()


if __name__ == "__main__":
    torch.set_num_threads(1)
    logs = {mode: run(mode, rate) for mode, rate in [("rsd", 0.02), ("sds", 0.02), ("vsd", 0.01)]}
    (HERE / "guidance.json").write_text(json.dumps(logs, indent=1) + "\n")
