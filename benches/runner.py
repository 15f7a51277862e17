#!/usr/bin/env python3
"""What a runner costs when there is nothing to do: srnerf-dag beside ninja, Snakemake and DVC on the same graph.

A graph of COUNT stages, WIDTH chains side by side, each stage reading the one before it in its chain. srnerf-dag's stages are real ones
(`Interpolate` on pictures of 8 x 8 pixels), computed by a first run; the others' are `cp`, with files of one line. The others' first runs
would take hours, so their outputs, and DVC's lock file, are written here, as those runs would leave them. Every tool then finds
that nothing is to be done, several times; the fastest counts. Memory is the largest resident set of that process. A second table has
the time to hash a file of 1 GiB that is in the page cache, beside b3sum: `whence` reads a file through to look for its bytes in the store.

    pip install ninja snakemake dvc
    cargo install b3sum
    python3 benches/runner.py PROGRAM FOLDER [--count 10000] [--limit SECONDS]

FOLDER is kept, so that a second call only measures. The rows of docs/performance.md are what this prints.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

WIDTH = 100
REPEATS = 5


def stages(count):
    """Names of stages, and of what each reads: `None` for the first of a chain."""
    for at in range(count):
        yield f"s{at:05}", f"s{at - WIDTH:05}" if at >= WIDTH else None


def write_srnerf(folder, count):
    # Factors that differ by so little that the pictures keep their size, and the cameras do not: no two stages share a key.
    lines = [
        f'        "{name}": Interpolate(images: "{reads or "scene.train"}", factor: {1 + (at + 1) * 1e-7:.7f}, filter: Nearest),'
        for at, (name, reads) in enumerate(stages(count - 1))
    ]
    scene = '        "scene": Scene(source: Procedural(views: 2, size: (8, 8), samples: 1), downscale: 1, holdout: 2),'
    (folder / "graph.ron").write_text("\n".join(["(", '    name: "graph",', "    stages: {", scene, *lines, "    },", ")\n"]))


def write_files(folder, count):
    """The source and every output, each newer than what it is made of, as far as tools look."""
    (folder / "files").mkdir()
    for name in ["source", *(name for name, _ in stages(count))]:
        (folder / "files" / name).write_text("line\n")
    past = time.time() - 3600
    os.utime(folder / "files/source", (past - 10, past - 10))
    for name, reads in stages(count):
        depth = int(name[1:]) // WIDTH
        os.utime(folder / "files" / name, (past + depth, past + depth))


def write_ninja(folder, count):
    write_files(folder, count)
    lines = ["rule copy", "  command = cp $in $out"]
    lines += [f"build files/{name}: copy files/{reads or 'source'}" for name, reads in stages(count)]
    (folder / "build.ninja").write_text("\n".join(lines) + "\n")
    # A first run with a log, so that the next one has nothing to do: `touch` would not write the log.
    subprocess.run(["ninja", "-C", folder, "--quiet"], check=True)


def write_snakemake(folder, count):
    write_files(folder, count)
    (folder / "Snakefile").write_text(f"""
READS = {{{", ".join(f"{name!r}: {reads or 'source'!r}" for name, reads in stages(count))}}}

rule all:
    input: expand("files/{{name}}", name=list(READS))

rule copy:
    input: lambda wildcards: "files/" + READS[wildcards.name]
    output: "files/{{name}}"
    wildcard_constraints: name="s[0-9]+"
    shell: "cp {{input}} {{output}}"
""")


def write_dvc(folder, count):
    write_files(folder, count)
    digest = hashlib.md5(b"line\n").hexdigest()
    spec, lock = ["stages:"], ["schema: '2.0'", "stages:"]
    for name, reads in stages(count):
        source = f"files/{reads or 'source'}"
        command = f"cp {source} files/{name}"
        spec += [f"  {name}:", f"    cmd: {command}", "    deps:", f"    - {source}", "    outs:", f"    - files/{name}"]
        entry = lambda path: [f"    - path: {path}", "      hash: md5", f"      md5: {digest}", "      size: 5"]
        lock += [f"  {name}:", f"    cmd: {command}", "    deps:", *entry(source), "    outs:", *entry(f"files/{name}")]
    (folder / "dvc.yaml").write_text("\n".join(spec) + "\n")
    (folder / "dvc.lock").write_text("\n".join(lock) + "\n")
    subprocess.run(["dvc", "init", "--no-scm", "--quiet"], cwd=folder, check=True)
    subprocess.run(["dvc", "config", "core.analytics", "false"], cwd=folder, check=True)


def measure(command, folder, limit, repeats):
    """Seconds of the fastest run and megabytes of the largest; `None` where one took longer than the limit."""
    best, most = None, 0
    for _ in range(repeats):
        begun = time.perf_counter()
        with open(folder / "last.log", "w") as log:
            process = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)
            # Waiting by looking again costs the child nothing; `Popen.poll` would take its resources away unread.
            while time.perf_counter() - begun < limit:
                pid, status, usage = os.wait4(process.pid, os.WNOHANG)
                if pid:
                    process.returncode = os.waitstatus_to_exitcode(status)
                    most = max(most, usage.ru_maxrss / 1024)
                    break
                time.sleep(0.0005)
        if process.returncode is None:
            process.kill()
            process.wait()
            return None, None
        if process.returncode:
            sys.exit(f"{command} failed: see {folder / 'last.log'}")
        seconds = time.perf_counter() - begun
        best = seconds if best is None else min(best, seconds)
        if seconds > limit / repeats:
            break
    return best, most


def hash_beside_b3sum(program, folder):
    """The second table. The two take turns, so that what else the machine does troubles both."""
    file = folder / "random.bin"
    if not file.exists():
        file.write_bytes(b"".join(os.urandom(1 << 20) for _ in range(1024)))
    # `whence` exits with 5, since nothing says where these bytes come from.
    commands = {"srnerf-dag whence": [program, "whence", file], "b3sum": ["b3sum", file]}
    best = {}
    for _ in range(2 * REPEATS):
        for title, command in commands.items():
            if title == "b3sum" and not shutil.which("b3sum"):
                continue
            begun = time.perf_counter()
            subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            best[title] = min(best.get(title, 1e9), time.perf_counter() - begun)
    print("\n| 1 GiB hashed | time |\n|---|---|")
    for title, seconds in best.items():
        print(f"| {title} | {seconds * 1000:.0f} ms |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=10000)
    parser.add_argument("--limit", type=float, default=100.0)
    arguments = parser.parse_args()
    program, count = arguments.program.resolve(), arguments.count

    rows = [
        ("srnerf-dag plan", write_srnerf, [program, "plan", "graph.ron"], "srnerf"),
        ("srnerf-dag run", write_srnerf, [program, "run", "-q", "graph.ron"], "srnerf"),
        ("ninja", write_ninja, ["ninja", "--quiet"], "ninja"),
        ("snakemake -n", write_snakemake, ["snakemake", "-n", "--quiet", "--rerun-triggers", "mtime"], "snakemake"),
        ("dvc status", write_dvc, ["dvc", "status", "--quiet"], "dvc"),
    ]
    print(f"| {count} stages, nothing to do | time | memory |\n|---|---|---|")
    for title, write, command, name in rows:
        if name != "srnerf" and not shutil.which(command[0]):
            print(f"| {title} | not installed | |")
            continue
        folder = arguments.folder / f"{name}-{count}"
        if not folder.exists():
            folder.mkdir(parents=True)
            write(folder, count)
            if name == "srnerf":
                subprocess.run([program, "run", "-q", "graph.ron"], cwd=folder, check=True)
                time.sleep(2.5)
        # The first run fills caches: the index of srnerf-dag, the page cache for all.
        measure(command, folder, arguments.limit, 1)
        seconds, memory = measure(command, folder, arguments.limit, REPEATS)
        if seconds is None:
            print(f"| {title} | more than {arguments.limit:.0f} s | |", flush=True)
        else:
            print(f"| {title} | {seconds * 1000:.0f} ms | {memory:.0f} MB |", flush=True)
    hash_beside_b3sum(program, arguments.folder.resolve())


main()
