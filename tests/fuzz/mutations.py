"""Damage valid input by a seed: as bytes, lines or words of a text."""

from __future__ import annotations

import re
from collections.abc import Callable
from random import Random

Mutator = Callable[[bytes, Random], bytes]

NUMBERS = (
    *("nan", "inf", "-inf", "1e999", "-1e308", "5e-324", "-0.0", "0", "-1", "1e3", "0x10", "1_0"),
    *("9" * 25, "-" + "9" * 400, "9" * 5000, "1,5", "1.5.5", "2147483648", "9223372036854775808"),
)
WORDS = (
    *("", " ", "\x00", "\ufeff", "\u2028", "\u202e", "é", "姿勢", "\U0001f916", "\n", "\r", "\t"),
    *'" \' """ \\ , ; = [ ] { } < > &lt; ]]> ../../etc/passwd'.split(),
    *("true", "null", "None", "NA", "=1+1", "%s%n", "{0}", "<script>", "/dev/null", "a" * 70_000),
)
NONSENSE = (*NUMBERS, *WORDS)
ENCODINGS = ("utf-16", "utf-32", "utf-8-sig", "utf-16-le", "utf-7", "cp037")
_TOKEN = re.compile(r"[\w.+-]+")


def damage_bytes(data: bytes, rng: Random) -> bytes:
    """Flip, cut, double, insert or overwrite some bytes, one to three times."""
    content = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        start = rng.randrange(len(content) + 1)
        end = min(len(content), start + int(rng.expovariate(1 / 20)))
        match rng.randrange(6):
            case 0 if start < len(content):
                content[start] ^= 1 << rng.randrange(8)
            case 1:
                del content[start:end]
            case 2:
                content[start:start] = content[start:end] * rng.choice((1, 2, 50))
            case 3:
                content[start:start] = rng.choice(NONSENSE).encode()
            case 4:
                content[start:end] = rng.randbytes(end - start)
            case _ if rng.random() < 0.3:
                del content[start:]
    return bytes(content)


def replace_tokens(text: str, rng: Random) -> str:
    """Replace one to four tokens by nonsense or by another token."""
    tokens = list(_TOKEN.finditer(text))
    chosen_tokens = rng.sample(tokens, min(len(tokens), rng.randint(1, 4)))
    for token in sorted(chosen_tokens, key=re.Match.start, reverse=True):
        replacement = rng.choice(tokens).group() if rng.random() < 0.3 else rng.choice(NONSENSE)
        text = text[: token.start()] + replacement + text[token.end() :]
    return text


def damage_lines(text: str, rng: Random) -> str:
    """Remove, repeat, move or empty a line, or change all line ends."""
    lines = text.split("\n")
    index = rng.randrange(len(lines))
    match rng.randrange(4):
        case 0:
            lines[index : index + 1] = [lines[index]] * rng.choice((0, 2, 100))
        case 1:
            rng.shuffle(lines)
        case 2:
            lines[index] = rng.choice(("", lines[index] + rng.choice(WORDS)))
        case _:
            return rng.choice(("\r", "\r\n", "\n\n", "\x0b")).join(lines)
    return "\n".join(lines)


def damage_text(data: bytes, rng: Random) -> bytes:
    """Damage UTF-8 text in tokens, lines, bytes or its encoding."""
    text = data.decode()
    damages = (
        *(lambda: damage_bytes(data, rng), lambda: text.encode(rng.choice(ENCODINGS))),
        lambda: replace_tokens(damage_lines(text, rng), rng).encode(),
        lambda: replace_tokens(text, rng).encode(),
    )
    (damage,) = rng.choices(damages, (2, 1, 3, 4))
    return damage()
