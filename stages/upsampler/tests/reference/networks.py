"""The families of upsamplers in PyTorch, with random weights: golden files, and comparisons of new draws with the program.

python networks.py write                                    the files of ../golden
python networks.py compare PROGRAM [--count N] [--ncnn F..] drawn networks, and pairs of ncnn, asked of the program

Parameters have the names of the authors' checkpoints, by which the program tells them.
"""

import argparse
import random
import struct
import subprocess
import tempfile
from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors.torch import load_file, save_file
from torch import nn

GOLDEN = Path(__file__).parent.parent / "golden"
TOLERANCE = 1e-4
ROUNDED = {"f32": torch.float32, "f16": torch.float16, "bf16": torch.bfloat16}


def conv3(inputs, outputs):
    return nn.Conv2d(inputs, outputs, 3, padding=1)


class Residual(nn.Module):
    """Ours: pairs of convolutions, and what they add to bicubic enlargement."""

    scale = 4

    def __init__(self, width, pairs):
        super().__init__()
        self.first, self.after, self.last = conv3(3, width), conv3(width, width), conv3(width, 48)
        self.a = nn.ModuleList(conv3(width, width) for _ in range(pairs))
        self.b = nn.ModuleList(conv3(width, width) for _ in range(pairs))

    def forward(self, x):
        first = deep = self.first((x - 0.45) * 4)
        for a, b in zip(self.a, self.b):
            deep = deep + b(torch.relu(a(deep)))
        detail = F.pixel_shuffle(self.last(first + self.after(deep)), 4)
        return F.interpolate(x, scale_factor=4, mode="bicubic") + detail / 4


class Compact(nn.Module):
    """SRVGGNetCompact."""

    def __init__(self, width, count, scale):
        super().__init__()
        self.scale = scale
        self.body = nn.ModuleList([conv3(3, width), nn.PReLU(width)])
        for _ in range(count):
            self.body.extend([conv3(width, width), nn.PReLU(width)])
        self.body.append(conv3(width, 3 * scale * scale))

    def forward(self, x):
        y = x
        for layer in self.body:
            y = layer(y)
        return F.pixel_shuffle(y, self.scale) + F.interpolate(x, scale_factor=self.scale, mode="nearest")


class Dense(nn.Module):
    def __init__(self, width, growth):
        super().__init__()
        for i in range(1, 6):
            setattr(self, f"conv{i}", conv3(width + (i - 1) * growth, width if i == 5 else growth))

    def forward(self, x):
        seen = [x]
        for i in range(1, 5):
            seen.append(F.leaky_relu(getattr(self, f"conv{i}")(torch.cat(seen, 1)), 0.2))
        return x + 0.2 * self.conv5(torch.cat(seen, 1))


class DenseOfDense(nn.Module):
    def __init__(self, width, growth):
        super().__init__()
        self.rdb1, self.rdb2, self.rdb3 = (Dense(width, growth) for _ in range(3))

    def forward(self, x):
        return x + 0.2 * self.rdb3(self.rdb2(self.rdb1(x)))


class Rrdb(nn.Module):
    """RRDBNet: x4 as it is, x2 and x1 behind a pixel unshuffle."""

    def __init__(self, width, growth, blocks, scale):
        super().__init__()
        self.scale, self.unshuffle = scale, 4 // scale
        self.conv_first = conv3(3 * self.unshuffle**2, width)
        self.body = nn.Sequential(*(DenseOfDense(width, growth) for _ in range(blocks)))
        for name in ["conv_body", "conv_up1", "conv_up2", "conv_hr"]:
            setattr(self, name, conv3(width, width))
        self.conv_last = conv3(width, 3)

    def forward(self, x):
        height, width = x.shape[2:]
        x = F.pad(x, (0, -width % self.unshuffle, 0, -height % self.unshuffle), mode="reflect")
        first = self.conv_first(F.pixel_unshuffle(x, self.unshuffle))
        y = first + self.conv_body(self.body(first))
        for up in [self.conv_up1, self.conv_up2]:
            y = F.leaky_relu(up(F.interpolate(y, scale_factor=2, mode="nearest")), 0.2)
        return self.conv_last(F.leaky_relu(self.conv_hr(y), 0.2))[:, :, : self.scale * height, : self.scale * width]


class Parts(nn.Module):
    """SPAN's convolution as it is trained: three in a row on a padded image, beside one of single pixels."""

    def __init__(self, inputs, outputs, gain=2):
        super().__init__()
        self.sk = nn.Conv2d(inputs, outputs, 1)
        self.conv = nn.Sequential(
            nn.Conv2d(inputs, inputs * gain, 1), nn.Conv2d(inputs * gain, outputs * gain, 3), nn.Conv2d(outputs * gain, outputs, 1)
        )

    def forward(self, x):
        return self.conv(F.pad(x, (1, 1, 1, 1))) + self.sk(x)


class Whole(nn.Module):
    """The same as it is run: one convolution."""

    def __init__(self, inputs, outputs):
        super().__init__()
        self.eval_conv = conv3(inputs, outputs)

    def forward(self, x):
        return self.eval_conv(x)


class Block(nn.Module):
    def __init__(self, width, layer):
        super().__init__()
        self.c1_r, self.c2_r, self.c3_r = (layer(width, width) for _ in range(3))

    def forward(self, x):
        early = F.silu(self.c1_r(x))
        y = self.c3_r(F.silu(self.c2_r(early)))
        return (y + x) * (torch.sigmoid(y) - 0.5), early


class Span(nn.Module):
    def __init__(self, width, scale, layer, norm=True):
        super().__init__()
        self.scale, self.norm = scale, norm
        if not norm:
            self.register_buffer("no_norm", torch.zeros(1))
        self.conv_1, self.conv_2 = layer(3, width), layer(width, width)
        for i in range(1, 7):
            setattr(self, f"block_{i}", Block(width, layer))
        self.conv_cat = nn.Conv2d(4 * width, width, 1)
        self.upsampler = nn.Sequential(conv3(width, 3 * scale * scale), nn.PixelShuffle(scale))

    def forward(self, x):
        if self.norm:
            x = 255 * (x - torch.tensor([0.4488, 0.4371, 0.4040]).view(1, 3, 1, 1))
        first = self.conv_1(x)
        results, y = [], first
        for i in range(1, 7):
            y, early = getattr(self, f"block_{i}")(y)
            results.append(y)
        return self.upsampler(self.conv_cat(torch.cat([first, self.conv_2(y), results[0], early], 1)))


def drawn(network, seed, number="f32"):
    """The network with seeded weights that keep numbers near 1, rounded to a number type."""
    generator = torch.Generator().manual_seed(seed)
    network.requires_grad_(False)
    for parameter in network.parameters():
        size = (1.4 / parameter[0].numel()) ** 0.5 if parameter.ndim == 4 else 0.2
        parameter.copy_((torch.randn(parameter.shape, generator=generator) * size).to(ROUNDED[number]))
    if isinstance(network, Span):
        # Trained networks weaken the colours' range of 255 at once, and give numbers from 0 to 1.
        for name, parameter in network.conv_1.named_parameters():
            if name.startswith(("sk", "conv.2", "eval_conv")):
                parameter.copy_((parameter * (0.02 if network.norm else 1)).to(ROUNDED[number]))
        spread = network(torch.rand(1, 3, 16, 16, generator=generator)).std()
        for parameter in network.upsampler.parameters():
            parameter.copy_((parameter / (3 * spread)).to(ROUNDED[number]))
    return network


def saved(network, path, number="f32", prefix="", rename=lambda name: name, more={}):
    tensors = {prefix + rename(name): value.to(ROUNDED[number]).contiguous() for name, value in network.state_dict().items()}
    save_file({**tensors, **more}, path)


def old_names(blocks):
    """ESRGAN's names for tensors, by their places."""
    places = {"conv_first": "model.0", "conv_body": f"model.1.sub.{blocks}", "conv_up1": "model.3", "conv_up2": "model.6", "conv_hr": "model.8", "conv_last": "model.10"}

    def rename(name):
        layer, _, end = name.rpartition(".")
        if layer in places:
            return f"{places[layer]}.{end}"
        _, block, dense, conv = layer.split(".")
        return f"model.1.sub.{block}.{dense.upper()}.{conv}.0.{end}"

    return rename


class Pair:
    """The files of ncnn, layer by layer."""

    def __init__(self, number):
        self.lines, self.data, self.half = [], b"", number == "f16"

    def layer(self, kind, inputs, output, parameters="", outputs=None):
        outputs = outputs or [output]
        self.lines.append(f"{kind:<16} {output}_{kind} {len(inputs)} {len(outputs)} {' '.join([*inputs, *outputs])} {parameters}".rstrip())
        return output

    def convolution(self, module, source, output):
        weight, bias = module.weight, module.bias
        side, count = weight.shape[2], weight.numel()
        self.plain_or_half(weight)
        self.plain(bias)
        return self.layer("Convolution", [source], output, f"0={weight.shape[0]} 1={side} 4={side // 2} 5=1 6={count}")

    def plain(self, tensor):
        self.data += tensor.contiguous().numpy().astype("<f4").tobytes()

    def plain_or_half(self, tensor):
        if not self.half:
            self.data += struct.pack("<I", 0)
            return self.plain(tensor)
        self.data += struct.pack("<I", 0x01306B47) + tensor.contiguous().numpy().astype("<f2").tobytes()
        self.data += b"\0" * (-len(self.data) % 4)

    def write(self, path):
        blobs = sum(int(line.split()[3]) for line in self.lines)
        Path(f"{path}.param").write_text("\n".join(["7767517", f"{len(self.lines)} {blobs}", *self.lines]) + "\n")
        Path(f"{path}.bin").write_bytes(self.data)


def span_pair(network, number):
    p = Pair(number)
    x = p.layer("Input", [], "data")
    p.layer("MemoryData", [], "mean", "0=1 1=1 2=3")
    p.plain(torch.tensor([0.4488, 0.4371, 0.4040]))
    x = p.layer("BinaryOp", [x, "mean"], "centred", "0=1")
    x = p.layer("BinaryOp", [x], "spread", "0=2 1=1 2=2.550000e+02")
    p.convolution(network.conv_1.eval_conv, x, "first")
    x, *firsts = p.layer("Split", ["first"], "s0", outputs=["f0", "f1", "f2"]) and ["f0", "f1", "f2"]
    skip = firsts.pop()
    for i in range(1, 7):
        block = getattr(network, f"block_{i}")
        a = p.layer("Swish", [p.convolution(block.c1_r.eval_conv, x, f"a{i}")], f"b{i}")
        p.layer("Split", [a], f"sa{i}", outputs=[f"b{i}x", f"b{i}y"] if i == 6 else [f"b{i}x"])
        c = p.layer("Swish", [p.convolution(block.c2_r.eval_conv, f"b{i}x", f"c{i}")], f"d{i}")
        e = p.convolution(block.c3_r.eval_conv, c, f"e{i}")
        p.layer("Split", [e], f"se{i}", outputs=[f"e{i}x", f"e{i}y"])
        g = p.layer("BinaryOp", [p.layer("Sigmoid", [f"e{i}y"], f"f{i}s")], f"g{i}", "0=1 1=1 2=5.000000e-01")
        h = p.layer("BinaryOp", [p.layer("BinaryOp", [f"e{i}x", skip], f"h{i}"), g], f"i{i}", "0=2")
        names = {1: ["x", "y", "z"], 6: ["x"]}.get(i, ["x", "y"])
        p.layer("Split", [h], f"sh{i}", outputs=[f"i{i}{n}" for n in names])
        x, skip = f"i{i}x", f"i{i}y"
    after = p.convolution(network.conv_2.eval_conv, x, "after")
    x = p.layer("Concat", ["f1", after, "i1z", "b6y"], "joined")
    x = p.convolution(network.upsampler[0], p.convolution(network.conv_cat, x, "merged"), "last")
    p.layer("PixelShuffle", [x], "output", f"0={network.scale}")
    return p


def compact_pair(network, number):
    p = Pair(number)
    p.layer("Input", [], "data")
    p.layer("Split", ["data"], "s", outputs=["x0", "x1"])
    x = "x1"
    for i, layer in enumerate(network.body):
        if isinstance(layer, nn.Conv2d):
            x = p.convolution(layer, x, f"c{i}")
        else:
            p.plain(layer.weight)
            x = p.layer("PReLU", [x], f"p{i}", f"0={layer.weight.numel()}")
    x = p.layer("PixelShuffle", [x], "shuffled", f"0={network.scale}")
    base = p.layer("Interp", ["x0"], "base", f"0=1 1={network.scale}.0 2={network.scale}.0")
    p.layer("BinaryOp", [x, base], "output")
    return p


def asked(network, seed, size=(9, 11), smooth=False):
    x = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(seed))
    if smooth:
        x = F.interpolate(x, scale_factor=4, mode="bicubic").clamp(0, 1)
    return {"sample": x, "expected": network(x).contiguous()}


def write():
    GOLDEN.mkdir(exist_ok=True)
    stale = {f"params_ema.conv_2.eval_conv.{name}": torch.zeros(shape) for name, shape in [("weight", (6, 6, 3, 3)), ("bias", (6,))]}
    cases = [
        ("residual-x4", drawn(Residual(8, 2), 1, "f16"), dict(number="f16")),
        ("compact-x4", drawn(Compact(8, 3, 4), 2), dict(prefix="params.")),
        ("compact-x2", drawn(Compact(7, 2, 2), 3, "bf16"), dict(number="bf16", prefix="module.")),
        ("compact-x1", drawn(Compact(5, 1, 1), 4), {}),
        ("rrdb-x4", drawn(Rrdb(8, 4, 2, 4), 5, "f16"), dict(number="f16", prefix="params_ema.")),
        ("rrdb-x2", drawn(Rrdb(6, 3, 1, 2), 6, "f16"), dict(number="f16")),
        ("rrdb-x1", drawn(Rrdb(6, 3, 1, 1), 7, "f16"), dict(number="f16")),
        ("rrdb-x4-old", drawn(Rrdb(5, 2, 2, 4), 8, "f16"), dict(number="f16", rename=old_names(2))),
        ("span-x4", drawn(Span(6, 4, Parts), 9, "f16"), dict(number="f16", prefix="params_ema.", more=stale)),
        ("span-x2", drawn(Span(6, 2, Whole, norm=False), 10), {}),
    ]
    for name, network, options in cases:
        saved(network, GOLDEN / f"{name}.safetensors", **options)
        save_file(asked(network, 100), GOLDEN / f"{name}.expected.safetensors")
    for number in ["f16", "f32"]:
        for name, network, pair in [("span", drawn(Span(6, 4, Whole), 11, number), span_pair), ("compact", drawn(Compact(7, 2, 2), 12, number), compact_pair)]:
            pair(network, number).write(GOLDEN / f"ncnn-{name}-{number}")
            save_file(asked(network, 101), GOLDEN / f"ncnn-{name}-{number}.expected.safetensors")


def random_network(draw, folder):
    """A network whose sizes are drawn, saved; its file."""
    number, width, seed = draw.choice(list(ROUNDED)), draw.randint(3, 70), draw.randint(0, 1 << 30)
    kind = draw.choice(["residual", "compact", "rrdb", "span", "parts", "ncnn-span", "ncnn-compact"])
    if kind.startswith("ncnn"):
        number = draw.choice(["f16", "f32"])
        network, pair = (Span(width, draw.choice([1, 2, 3, 4]), Whole), span_pair) if kind == "ncnn-span" else (Compact(width, draw.randint(0, 5), draw.choice([1, 2, 3, 4])), compact_pair)
        pair(drawn(network, seed, number), number).write(folder / "drawn")
        return kind, network, folder / "drawn.param"
    network = {
        "residual": lambda: Residual(width, draw.randint(1, 4)),
        "compact": lambda: Compact(width, draw.randint(0, 5), draw.choice([1, 2, 3, 4])),
        "rrdb": lambda: Rrdb(width, draw.randint(2, 12), draw.randint(1, 3), draw.choice([1, 2, 4])),
        "span": lambda: Span(width, draw.choice([1, 2, 3, 4]), Whole, norm=draw.random() < 0.7),
        "parts": lambda: Span(width, draw.choice([2, 4]), Parts),
    }[kind]()
    prefix = draw.choice(["", "params.", "params_ema.", "module."])
    saved(drawn(network, seed, number), folder / "drawn.safetensors", number=number, prefix=prefix)
    return kind, network, folder / "drawn.safetensors"


def ncnn_network(path):
    """What the graph of a pair computes, by PyTorch's functions."""
    data, at, program = path.with_suffix(".bin").read_bytes(), 0, []

    def plain(shape, dtype=torch.float32):
        nonlocal at
        count = torch.Size(shape).numel()
        tensor = torch.frombuffer(bytearray(data[at : at + count * dtype.itemsize]), dtype=dtype).view(shape)
        at += count * dtype.itemsize
        return tensor.float()

    def marked(shape):
        nonlocal at
        half = data[at : at + 4] != bytes(4)
        at += 4
        tensor = plain(shape, torch.float16 if half else torch.float32)
        at += -at % 4
        return tensor

    channels = {}
    for line in path.read_text().splitlines()[2:]:
        kind, _, takes, gives, *rest = line.split()
        takes, gives = int(takes), int(gives)
        inputs, outputs = rest[:takes], rest[takes : takes + gives]
        p = dict(word.split("=") for word in rest[takes + gives :])
        width, weights = channels.get(inputs[0], 3) if inputs else 3, None
        if kind == "Convolution":
            weights = marked((int(p["0"]), width, int(p["1"]), int(p["1"]))), plain((int(p["0"]),))
            width = int(p["0"])
        elif kind == "PReLU":
            weights = plain((int(p["0"]),))
        elif kind == "MemoryData":
            weights = plain((1, int(p["2"]), 1, 1))
        elif kind == "Concat":
            width = sum(channels[name] for name in inputs)
        elif kind == "PixelShuffle":
            width //= int(p["0"]) ** 2
        channels.update({name: width for name in outputs})
        program.append((kind, inputs, outputs, p, weights))
    assert at == len(data)

    def layer(kind, x, p, weights):
        if kind == "Convolution":
            y = F.conv2d(x[0], *weights, padding=weights[0].shape[2] // 2)
            return F.leaky_relu(y, float(p["-23310"].split(",")[1])) if p.get("9") == "2" else y
        if kind == "BinaryOp":
            other = x[1] if len(x) == 2 else float(p["2"])
            return {"0": torch.add, "1": torch.sub, "2": torch.mul}[p.get("0", "0")](x[0], other)
        if kind == "Eltwise":
            return sum(float(factor) * value for factor, value in zip(p["-23301"].split(",")[1:], x))
        if kind == "Interp":
            return F.interpolate(x[0], scale_factor=float(p["1"]), mode={"1": "nearest", "3": "bicubic"}[p["0"]])
        one = {"Split": lambda v: v, "PReLU": lambda v: F.prelu(v, weights), "Swish": F.silu, "Sigmoid": torch.sigmoid}
        return torch.cat(x, 1) if kind == "Concat" else F.pixel_shuffle(x[0], int(p["0"])) if kind == "PixelShuffle" else one[kind](x[0])

    def run(image):
        values = {}
        for kind, inputs, outputs, p, weights in program:
            value = image if kind == "Input" else weights if kind == "MemoryData" else layer(kind, [values[name] for name in inputs], p, weights)
            values.update({name: value for name in outputs})
        return value

    return run


def compare(program, count, pairs):
    draw, worst = random.Random(), 0.0
    seed = draw.randint(0, 1 << 30)
    draw.seed(seed)
    print(f"upsamplers drawn with seed {seed}")
    with tempfile.TemporaryDirectory() as folder, torch.no_grad():
        folder = Path(folder)
        cases = [lambda: random_network(draw, folder) for _ in range(count)]
        cases += [lambda path=path: (path.stem, ncnn_network(path), path) for pair in pairs for path in sorted(Path(pair).glob("*.param"))]
        for case in cases:
            name, network, file = case()
            # Trained networks see pictures: of white noise SPAN makes numbers in the hundreds, and PyTorch's own f32 is up
            # to 1e-3 from its f64 there.
            expected = asked(network, draw.randint(0, 1 << 30), (draw.randint(3, 20), draw.randint(3, 20)), file.stem != "drawn")
            save_file({"sample": expected["sample"]}, folder / "in.safetensors")
            command = [program, "model", "run", file, "--part", "upsample", "--input", folder / "in.safetensors", "--output", folder / "out.safetensors"]
            subprocess.run(command, check=True)
            got, expected = load_file(folder / "out.safetensors")["sample"], expected["expected"]
            assert got.shape == expected.shape, f"{name}: {got.shape}, PyTorch's is {expected.shape}"
            error = ((got - expected).abs().max() / expected.abs().max().clamp(min=1)).item()
            worst = max(worst, error)
            assert error <= TOLERANCE, f"{name}: {error:.1e} from PyTorch's"
    print(f"{len(cases)} upsamplers agree with PyTorch, the furthest to {worst:.1e}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["write", "compare"])
    parser.add_argument("program", nargs="?")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--ncnn", nargs="*", default=[])
    told = parser.parse_args()
    write() if told.what == "write" else compare(told.program, told.count, told.ncnn)
