"""LZF, the compression of binary_compressed PCD files (Lehmann, liblzf)."""

from __future__ import annotations


def lzf_decompress(data: bytes, size: int) -> bytes:
    """`size` bytes out of an LZF stream (literal runs and back references). Raises ValueError where it is broken."""
    out = bytearray()
    at = 0
    try:
        while at < len(data):
            control = data[at]
            at += 1
            if control < 32:
                run = data[at : at + control + 1]
                if len(run) != control + 1:
                    raise ValueError("the compressed data ends inside a run")
                out += run
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            start = len(out) - ((control & 31) << 8) - data[at] - 1
            at += 1
            length += 2
            if start < 0 or len(out) + length > size:
                raise ValueError("the compressed data refers outside itself")
            step = len(out) - start
            piece = bytes(out[start : start + length])
            out += (piece * (length // step + 1))[:length]  # an overlapping reference repeats itself
    except IndexError:
        raise ValueError("the compressed data ends too early") from None
    if len(out) != size:
        raise ValueError(f"the compressed data gives {len(out)} bytes, {size} announced")
    return bytes(out)
