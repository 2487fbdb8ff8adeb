"""How texts and files go wrong: repeatable damage from a generator, the same for the short run and for the long one."""

import numpy as np

# What people and programs write where something else belongs; each has broken a parser somewhere.
NASTY = (
    "", "0", "-1", "1e400", "-1e-400", "nan", "-inf", "9" * 30, "9" * 400, "9" * 5000,
    "0x7fffffffffffffff", "1_0", "true",
    '""', '"210 bar"', '"-3 furlongs"', '"1e999 bar"', '"\\u0000"', '"' + "x" * 300 + '"', "[]", "{}", "[[1], {}]",
    "[" * 3000, "{a = " * 3000, "a.b.c", "1979-05-27T07:32:00Z", "\x00", "\ud7ff", "é", "'''", '"""', "#", "=", "[[a]]",
)  # fmt: skip

NUMBERS = (0, 1, 2**31, 2**63 - 1, 2**64 - 1)


def damaged_lines(random: np.random.Generator, text: str) -> str:
    """One to three mistakes in a text made of lines: lost, doubled, moved, cut off, or with something else in them."""
    lines = text.splitlines()
    for _ in range(random.integers(1, 4)):
        k = int(random.integers(len(lines))) if lines else 0
        way = random.integers(8)
        if not lines or way == 0:
            lines.insert(k, NASTY[random.integers(len(NASTY))])
        elif way == 1:
            del lines[k]
        elif way == 2:
            lines.insert(k, lines[random.integers(len(lines))])
        elif way == 3:
            del lines[k + 1 :]
            lines[k] = lines[k][: random.integers(len(lines[k]) + 1)]
        elif way in (4, 5):
            head, sign, _ = lines[k].partition("=")
            lines[k] = f"{head}{sign} {NASTY[random.integers(len(NASTY))]}"
        elif way == 6:
            words = lines[k].split(" ")
            words[random.integers(len(words))] = NASTY[random.integers(len(NASTY))]
            lines[k] = " ".join(words)
        else:
            at = int(random.integers(len(lines[k]) + 1))
            lines[k] = lines[k][:at] + chr(random.integers(1, 0x2FF)) + lines[k][at + 1 :]
    return "\n".join(lines)


def damaged_bytes(random: np.random.Generator, data: bytes) -> bytes:
    """One to three mistakes in bytes: flipped bits, cut off, something foreign in between, a number blown up."""
    out = bytearray(data)
    for _ in range(random.integers(1, 4)):
        at = int(random.integers(max(1, len(out))))
        way = random.integers(5)
        if way == 0 and out:
            out[at] ^= 1 << random.integers(8)
        elif way == 1:
            del out[at:]
        elif way == 2:
            out[at:at] = random.bytes(int(random.integers(1, 40)))
        elif way == 3:
            out[at : at + 8] = NUMBERS[random.integers(len(NUMBERS))].to_bytes(8, "little")
        else:
            del out[at : at + int(random.integers(1, 40))]
    return bytes(out)
