"""Check reading, refusing and writing back programs of four languages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from helpers.robot_programs import DOCS, FILES
from stiff_apply.programs.languages import language_of, read_program
from stiff_apply.programs.program import Edit, edited_texts
from stiff_protocols.contract.errors import DataError

SETTINGS = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
SPACE = st.sampled_from(["", " ", "  ", "\t"])
NEWLINE = st.sampled_from(["\n", "\r\n"])
REAL = st.one_of(
    st.floats(-999, 999).map(lambda x: f"{x:.3f}"),
    st.integers(-500, 500).map(str),
    st.floats(0.001, 0.999).map(lambda x: f"{x:.4f}"[1:]),
)
EXTERNAL = "[9E9,9E9,9E9,9E9,9E9,9E9]"


def write_program(tmp_path: Path, name: str, text: str) -> Path:
    file = tmp_path / name
    file.write_bytes(text.encode("latin-1"))
    return file


def rewrite_numbers(program) -> list[str]:
    """Return a program's texts after each number was replaced by its own text."""
    edits = []
    for row in range(len(program)):
        index = int(program.text_index[row])
        for start, end in [*program.places[row], *program.config_places[row]]:
            edits.append(Edit(index, int(start), int(end), program.texts[index][start:end]))
    return edited_texts(program.texts, [*dict.fromkeys(edits)])


@pytest.mark.parametrize("name", FILES)
def test_a_program_of_the_docs_is_written_back_to_the_byte(name):
    program = read_program(DOCS / name)
    for path, text in zip(program.paths, rewrite_numbers(program), strict=False):
        assert text.encode("latin-1") == path.read_bytes()
    for row in range(len(program)):
        text = program.texts[program.text_index[row]]
        numbers = [float(text[a:b]) for a, b in program.places[row] if b > a]
        np.testing.assert_array_equal(numbers, program.values[row, : len(numbers)])


def left_motions(program) -> list[tuple[int, str, str]]:
    """Return line, statement and reason of the motions without targets."""
    return [program.left_motion(i, reason) for i, reason in enumerate(program.reasons) if reason]


@pytest.mark.parametrize(
    ("name", "n", "reasons"),
    [
        ("pocket.src", 9, ["XHOME", "DEPTH+50.0"]),
        ("pocket.mod", 7, ["Offs(..)"]),
        ("pocket.ls", 5, ["Offset"]),
        ("pocket.script", 6, ["pose_trans"]),
    ],
)
def test_targets_are_read_and_the_others_are_listed_with_a_reason(name, n, reasons):
    program = read_program(DOCS / name)
    assert len(program) == n
    assert len(left_motions(program)) == len(reasons)
    for motion, part in zip(left_motions(program), reasons, strict=True):
        assert part in motion.reason
        assert motion.text.split()[0] in program.texts[0].splitlines()[motion.line - 1]


@pytest.mark.slow
@SETTINGS
@given(
    rows=st.lists(st.lists(REAL, min_size=6, max_size=6), min_size=1, max_size=5),
    newline=NEWLINE,
    space=SPACE,
    comment=st.text("aäß ;{}()LINPTP", max_size=12),
)
def test_any_krl_motion_is_read_and_written_back(tmp_path, rows, newline, space, comment):
    lines = ["DEF part()", f";{comment}"]
    for row in rows:
        parts = f",{space}".join(f"{name} {n}" for name, n in zip("XYZABC", row, strict=True))
        lines.append(f"{space}LIN {{{parts}}} C_DIS{space};{comment}")
    check(tmp_path, "part.src", newline.join([*lines, "END"]), rows)


@pytest.mark.slow
@SETTINGS
@given(
    rows=st.lists(st.lists(REAL, min_size=3, max_size=3), min_size=1, max_size=5),
    newline=NEWLINE,
    space=SPACE,
    comment=st.text("aäß ;[]\\MoveL", max_size=12),
)
def test_any_rapid_motion_is_read_and_written_back(tmp_path, rows, newline, space, comment):
    lines = ["MODULE M", f"! {comment}", "PROC main()"]
    for row in rows:
        target = f"[[{f',{space}'.join(row)}],[1,0,0,0],[0,-1,0,1],{EXTERNAL}]"
        lines.append(f"{space}MoveL{space}{target},{space}v100,z10,{newline}  tool0;!{comment}")
    rows = [[*row, 1, 0, 0, 0] for row in rows]
    lines = [line.replace("MoveL[", "MoveL [") for line in lines]
    check(tmp_path, "part.mod", newline.join([*lines, "ENDPROC", "ENDMODULE"]), rows)


@pytest.mark.slow
@SETTINGS
@given(
    rows=st.lists(st.lists(REAL, min_size=6, max_size=6), min_size=1, max_size=5),
    newline=NEWLINE,
    space=SPACE,
)
def test_any_fanuc_position_is_read_and_written_back(tmp_path, rows, newline, space):
    lines = ["/PROG P", "/MN"]
    lines += [f"{i:4}:L P[{i}]{space} 9mm/sec FINE{space};" for i in range(len(rows))]
    lines.append("/POS")
    for i, row in enumerate(rows):
        parts = f",{space}".join(
            f"{name} ={space}{n} {'mm' if name in 'XYZ' else 'deg'}"
            for name, n in zip("XYZWPR", row, strict=True)
        )
        config = "CONFIG : 'N U T, 0, -1, 0'"
        lines.append(f'P[{i}:"a;b"]{{{newline}  GP1:{newline}\tUF : 0, UT : 1, {config},{parts}')
        lines.append("};")
    check(tmp_path, "part.ls", newline.join([*lines, "/END"]), rows)


@pytest.mark.slow
@SETTINGS
@given(
    rows=st.lists(st.lists(REAL, min_size=6, max_size=6), min_size=1, max_size=5),
    newline=NEWLINE,
    space=SPACE,
    comment=st.text("aäß ()[]movelp", max_size=12),
)
def test_any_urscript_motion_is_read_and_written_back(tmp_path, rows, newline, space, comment):
    lines = ["def part():", f"# {comment}"]
    for row in rows:
        pose = f"p[{f',{space}'.join(row)}]"
        lines.append(f"{space}movel({space}{pose},{space}a=1.2, v=0.1){space}# {comment}")
    check(tmp_path, "part.script", newline.join([*lines, "end"]), rows)


def check(tmp_path: Path, name: str, text: str, rows) -> None:
    program = read_program(write_program(tmp_path, name, text))
    np.testing.assert_array_equal(
        program.values[:, : len(rows[0])], np.array(rows, dtype=float), err_msg=text
    )
    assert rewrite_numbers(program)[0] == text


@pytest.mark.parametrize(
    ("name", "text", "part"), [("a.nc", "G1 X1", "unknown language"), ("a.src", "", "no motion")]
)
def test_what_is_no_program_is_refused_with_its_file(tmp_path, name, text, part):
    with pytest.raises(DataError, match=part) as caught_error:
        read_program(write_program(tmp_path, name, text))
    assert name in str(caught_error.value)


TARGET = f"[[1,2,3],[1,0,0,0],[0,0,0,0],{EXTERNAL}]"


@pytest.mark.parametrize(
    ("name", "text", "line", "part"),
    [
        ("a.src", "DEF a()\nLIN {X 1,Y 2,Z\nEND", 2, "cannot be read"),
        ("a.src", "\n\nLIN_REL {X 1}\n", 3, "relative"),
        ("a.src", "$TOOL={X 1,Y 2}\nLIN {X 1,Y 2,Z 3,A 0,B 0,C 0}", 2, "$TOOL={X 1,Y 2}"),
        ("a.src", "LIN {X 1}", 1, "not all numbers"),
        ("a.mod", "MoveL [[1,2],[1,0,0,0]], v1, z1, t;", 1, "not a literal robtarget"),
        (
            "a.mod",
            f"\nMoveL [[1,2,3],[1,1,0,0],[0,0,0,0],{EXTERNAL}], v1, z1, t;",
            2,
            "length 1.414",
        ),
        ("a.mod", "MoveL p10;", 1, "cannot be read"),
        (
            "a.mod",
            f"PERS tooldata t:=[FALSE,[[0,0,0],[1,0,0,0]],[1]];MoveL {TARGET}, v1, z1, t;",
            1,
            "tool on the robot",
        ),
        (
            "a.ls",
            "/MN\n1:L P[1] 9mm/sec FINE ;\n/POS\nP[1]{ GP1: UF : 0 X 1 };",
            2,
            "no number X",
        ),
        ("a.script", "movel(p[1,2,3])", 1, "six numbers"),
        ("a.script", "movel(p[1,2,3,4,5,6)\nmovel(x)", 1, "cannot be read"),
    ],
)
def test_a_motion_that_cannot_be_read_is_listed_with_line_and_cause(
    tmp_path, name, text, line, part
):
    program = read_program(write_program(tmp_path, name, text))
    assert len(program) == 0
    motion = left_motions(program)[0]
    assert motion.line == line and part in motion.reason


def test_krl_takes_frames_from_inline_forms_and_points_from_the_dat(tmp_path):
    src = (
        "LDAT_ACT=LCPDAT1\nFDAT_ACT=FP1\nBAS(#CP_PARAMS,2)\nLIN XP1 C_DIS\n"
        "BAS(#TOOL,2)\n$BASE=$NULLFRAME\nLIN XP1 C_DIS C_DIS\nXP2={X 1}\nLIN XP2\n"
    )
    dat = (
        'DECL FDAT FP1={TOOL_NO 1,BASE_NO 0,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}\n'
        "DECL E6POS XP1={X 1.5,Y 2,Z 3,A 4,B 5,C 6,S 'B010',T 'H23',E1 0.0}\n"
        "E6AXIS XP2={A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}\n"
    )
    write_program(tmp_path, "a.dat", dat)
    program = read_program(write_program(tmp_path, "a.src", src))
    assert len(program) == 2 and (program.text_index == 1).all()
    np.testing.assert_array_equal(program.config[0, :2], [2.0, 35.0])
    names = [[frame.name for frame in program.frames[i]] for i in program.frame_index]
    assert names == [["BASE_DATA[0]", "TOOL_DATA[1]"], ["$NULLFRAME", "TOOL_DATA[2]"]]
    assert "assigned" in left_motions(program)[0].reason


def test_the_configurations_of_the_makers_manuals():
    signs = np.array([[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0]])
    angles = np.radians(
        [[10, -90, 90, 5, 60, -5], [-10, 0, 0, 100, -60, -100], [0, 0, 0, 0, -1, 0]]
    )
    status, turn = language_of(Path("a.src")).configurations(signs, angles).T
    assert status.tolist() == [2, 7, 4]
    assert turn.tolist() == [2 + 32, 1 + 16 + 32, 16]
    quadrants = language_of(Path("a.mod")).configurations(signs, angles)
    assert quadrants.tolist() == [[0, 0, -1, 0], [-1, 1, -2, 5], [0, 0, 0, 3]]
    letters = language_of(Path("a.ls")).configurations(signs, np.radians(np.full((3, 6), 200.0)))
    assert letters.tolist() == [[1, 1, 1, 1, 1, 1], [0, 1, 0, 1, 1, 1], [0, 0, 1, 1, 1, 1]]
