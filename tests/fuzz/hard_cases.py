"""Hold inputs that random damage rarely makes: bombs, deep nests, endless names, loops."""

from __future__ import annotations

import zipfile

import skops.io

from helpers.model_files import archived, members
from stiff_models.io.model_file import TRUSTED

LONG = 500_000


def tables(valid: bytes) -> tuple[bytes, ...]:
    """Return CSV inputs: no bytes, long names, NULs, unclosed quotes."""
    header, first_row, *other_lines = valid.split(b"\n")
    pose, *cells = first_row.split(b",")
    return (
        *(b"", b"\n" * LONG, b"," * LONG, b"\x00" * LONG, b'"' * LONG),
        b"\n".join([header, b",".join([pose * 20_000, *cells]), *other_lines * 1000]),
        header + b'\n"' + b"a" * LONG,
        header + b"\n" + first_row.replace(b".", b"." + b"0" * LONG, 1),
    )


def cards() -> tuple[bytes, ...]:
    """Return data cards with long rows of the signs that start Markdown and facts."""
    row = b"| | |\n|---|---|\n| What | %s |\n\n| column | meaning |\n|---|---|\n| %s | x |\n"
    signs = (b"[", b"![", b"[a](", b"`", b"`a", b"|", b"\\|", b"*", b"https://", b"`1` .. ", b"-")
    return (
        *(row % ((sign * (LONG // len(sign)),) * 2) for sign in signs),
        *(word * (LONG // len(word)) for word in (b"torque ", b"# data card: ", b"|-", b"|a")),
        *(b"instrument noise" + sign * LONG for sign in (b" ", b"|", b": 9")),
        b"| a | b |\n" * 50_000,
    )


def tomls(valid: bytes) -> tuple[bytes, ...]:
    """Return TOML inputs: deep nests, long numbers, long dotted keys."""
    return (
        b"",
        b"a = " + b"[" * 5000 + b"]" * 5000,
        b"a = " + b"{a=" * 5000,
        b"a = " + b"9" * 100_000,
        b"a" + b".a" * 100_000 + b" = 1",
        b"[a" + b".a" * 2000 + b"]\nb = 1",
        b"".join(b"[a%d]\n" % i for i in range(20_000)),
        valid + b"#" * LONG,
        valid + b"\n[mlp.width" + b".a" * 900 + b"]\nb = 1",
    )


def twins(valid: bytes) -> tuple[bytes, ...]:
    """Return twins whose robot file is endless, has no name, or is a folder."""
    head, key, tail = valid.partition(b'urdf = "')
    names = (b"/dev/zero", b"", b"..", b"\\u0000", b"twin.toml", b"x" * 5000)
    return tuple(head + key + name + tail[tail.index(b'"') :] for name in names)


def urdfs(valid: bytes) -> tuple[bytes, ...]:
    """Return URDF inputs: deep nests, loops of joints, endless chains, invalid numbers."""
    rotated = valid.replace(b'<axis xyz="', b'<axis xyz="%s" was="')
    return (
        b"",
        b"<robot>" + b"<a>" * 10_000 + b"</a>" * 10_000 + b"</robot>",
        _robot([(f"L{i}", f"L{i + 1}") for i in range(3000)]),
        _robot([("root", "A"), ("A", "A")]),
        _robot([("A", "B"), ("B", "A")]),
        _robot([("root", "A"), ("root", "B"), ("A", "C"), ("B", "C")]),
        _robot([("root", "A" * LONG)]),
        *(rotated.replace(b"%s", axis) for axis in (b"0 0 0", b"nan 0 1", b"1e308 1e308 1e308")),
        valid.replace(b' xyz="0', b' xyz="1e999'),
        valid.replace(b'lower="', b'lower="nan" was="'),
        valid.replace(b'upper="', b'upper="1e308" was="'),
    )


def _robot(joints: list[tuple[str, str]]) -> bytes:
    links = sorted({link for pair in joints for link in pair})
    text = "".join(f'<link name="{link}"/>' for link in links) + "".join(
        f'<joint name="J{i}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        '<axis xyz="0 0 1"/></joint>'
        for i, (parent, child) in enumerate(joints)
    )
    return f'<robot name="r">{text}</robot>'.encode()


def results(valid: bytes) -> tuple[bytes, ...]:
    """Return results files: empty, cut, not a database."""
    return (b"", valid[: len(valid) // 2], b"SQLite format 3\x00", b"x" * 4096)


def npy_header(shape: tuple[int, ...], dtype: str) -> bytes:
    """Return the head of an array file."""
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def models(valid: list[bytes]) -> tuple[bytes, ...]:
    """Return model files: too large options, deep structures, archive bombs."""
    inputs = [b"", b"PK\x05\x06" + bytes(18)]
    for data in valid:
        content = skops.io.loads(data, trusted=list(TRUSTED))
        params = content["model"]["params"]
        for name, value in params.items():
            if type(value) is int:
                model = {**content["model"], "params": {**params, name: 4096}}
                inputs.append(skops.io.dumps({**content, "model": model}))
    parts = members(valid[0])  # every model's archive is checked in the same way
    arrays = [name for name in parts if name.endswith(".npy")][:1]
    bombs = [(name, npy_header((2**27,), "|u1") + bytes(2**27)) for name in arrays]
    for name, bomb in (*bombs, ("schema.json", b"[" * 2**27)):
        inputs.append(archived(parts | {name: bomb}, zipfile.ZIP_DEFLATED))
    inputs += [archived(parts | {name: npy_header((2**40,), "<f8")}) for name in arrays]
    return tuple(inputs)
