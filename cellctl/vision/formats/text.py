"""Plain text: a point a line, separated by blanks, tabs, commas or semicolons."""

from __future__ import annotations

import io

import numpy as np

from cellctl.vision.formats.limits import MAX_POINTS, Coordinates, points_of, xyz_places

_SEPARATORS = bytes.maketrans(b",;\t\"'", b"     ")
_COMMENTS = (b"#", b"//")


def read_xyz(data: bytes) -> Coordinates:
    """Points (N, 3): x y z in the first columns, or in those that a line of names calls so.

    Comments begin with '#', or '//' before the first point; a line with one number there is the number of points.
    """
    if b"\0" in data[:4096]:
        raise ValueError("this is no text with one byte a character")
    start, names, announced = _head(data.removeprefix(b"\xef\xbb\xbf"))
    body = data.removeprefix(b"\xef\xbb\xbf")[start:]
    if b";" in body[:4096] and b"," in body[:4096]:
        raise ValueError("both ',' and ';' separate numbers: a comma for the decimal point is not understood")
    body = body.translate(_SEPARATORS)
    if not body.strip():
        raise ValueError("the file holds no points")
    table = np.loadtxt(io.BytesIO(body), dtype=np.float64, comments="#", ndmin=2)
    if table.shape[1] < 3 or len(table) > MAX_POINTS:
        raise ValueError(f"{table.shape[0]} lines of {table.shape[1]} numbers are no cloud")
    if announced is not None and announced != len(table):
        raise ValueError(f"{announced} points announced, {len(table)} found")
    if names and len(names) != table.shape[1]:
        raise ValueError(f"{len(names)} columns named, {table.shape[1]} found")
    _ends_whole(body)
    places = xyz_places(names) if {"x", "y", "z"} <= set(names) else (0, 1, 2)
    return points_of([table[:, place] for place in places])


def _head(data: bytes) -> tuple[int, list[str], int | None]:
    """Where the points begin, what the columns are called, how many points are announced."""
    at, names, announced = 0, list[str](), None
    while at < len(data):
        end = data.find(b"\n", at)
        end = len(data) if end < 0 else end + 1
        line = data[at:end].strip()
        # CloudCompare puts the names of the columns into such a comment
        plain = line.removeprefix(b"//") if line.startswith(b"//") else line
        words = plain.translate(_SEPARATORS).decode("ascii", errors="replace").split()
        if line.startswith(_COMMENTS) or not words:
            names = names or [word.lower() for word in words if line.startswith(b"//")]
        elif len(words) == 1 and words[0].isdigit() and announced is None:
            announced = int(words[0])
        elif len(words) >= 3 and not any(_is_number(word) for word in words) and not names:
            names = [word.lower() for word in words]
        else:
            break
        at = end
    return at, names if {"x", "y", "z"} <= set(names) else [], announced


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _ends_whole(body: bytes) -> None:
    """A last line without its end may have lost digits: it has, where all others show more decimals."""
    if body.endswith((b"\n", b"\r")):
        return
    lines = body[-65536:].split(b"\n")[1:]
    if len(lines) < 3:
        return
    decimals = [len(line.split()[-1].partition(b".")[2]) for line in lines if line.split()]
    if decimals[-1] < min(decimals[:-1]):
        raise ValueError("truncated: the last line does not end")
