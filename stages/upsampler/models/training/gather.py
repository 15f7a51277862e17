"""Gathers the photos of unpacked Debian or Ubuntu packages that their copyright files place under CC0, reduced for training.

    gather.py OUT PACKAGE_FOLDER...     (folders that `dpkg -x` made; writes OUT/NAME.jpg, and OUT/photos.tsv with their authors)
"""
import fnmatch
import re
import sys
from pathlib import Path

from PIL import Image

# Reduced photos are sharper for each pixel, and small enough to travel.
SIDE = 1280
FREE = ("CC0", "CC0-1.0", "Public-Domain")
# Smaller files are icons and plain backgrounds.
LEAST_BYTES = 150_000
# Pictures that are no photos, by the beginnings of their names.
DRAWN = (
    "ai_generated", "apo-", "abstract-spiral", "valley-midnight", "waves-midnight", "jelly", "kudu-", "Lunar", "minotaur", "2204-", "blue-lobster",
)


def rules(copyright_file):
    """(pattern, licence, author) of every `Files` paragraph."""
    for paragraph in re.split(r"\n\s*\n", copyright_file.read_text(errors="replace")):
        fields = dict(re.findall(r"^(Files|Copyright|License):[ \t]*((?:.*(?:\n[ \t]+.*)*))", paragraph, re.M))
        for pattern in fields.get("Files", "").split():
            yield pattern.rsplit("/", 1)[-1], fields.get("License", "").split("\n")[0], fields.get("Copyright", "").split("\n")[0]


def licence(name, found):
    """The last rule that names the file, as Debian's format has it; one that names all files is no statement about this one."""
    return next((rule for rule in reversed(found) if rule[0] != "*" and fnmatch.fnmatch(name, rule[0])), ("", "", ""))


def free_photos(package):
    """(path, author, licence) of the photos of a package that are free."""
    found = [rule for file in package.glob("usr/share/doc/*/copyright") for rule in rules(file)]
    for path in sorted([*package.glob("usr/share/**/*.jpg"), *package.glob("usr/share/**/*.png")]):
        _, terms, author = licence(path.name, found)
        small = path.is_symlink() or path.stat().st_size < LEAST_BYTES
        if terms in FREE and not small and not path.name.startswith(DRAWN):
            yield path, author, terms


def main(out, packages):
    out.mkdir(parents=True, exist_ok=True)
    rows = {}
    for package in packages:
        for path, author, terms in free_photos(package):
            image = Image.open(path).convert("RGB")
            image.thumbnail((SIDE, SIDE), Image.LANCZOS)
            image.save(out / f"{path.stem}.jpg", quality=92, subsampling=0, optimize=True)
            rows.setdefault(path.name, f"{package.name}\t{path.name}\t{author}\t{terms}\n")
    (out / "photos.tsv").write_text("package\tphoto\tauthor\tlicence\n" + "".join(sorted(rows.values())))


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(folder) for folder in sys.argv[2:]])
