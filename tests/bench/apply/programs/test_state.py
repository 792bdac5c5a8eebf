"""Check which state holds at a motion, and that no setting of the state stays unnoticed."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.state_statements import FANUC, KRL, RAPID, URSCRIPT
from stiff_apply.programs.languages import read_program

POSE = "{X 0,Y 0,Z 50,A 180,B 0,C 180}"
FRAMES = "$BASE={X 380,Y -60,Z 250,A 0,B 0,C 0}\n$TOOL={X 60,Y 0,Z 80,A 0,B 0,C 0}\n"
EXTERNAL = "[9E9,9E9,9E9,9E9,9E9,9E9]"
DATA = """MODULE M
 VAR tooldata mill:=[TRUE,[[40,0,54],[1,0,0,0]],[1,[0,0,30],[1,0,0,0],0,0,0]];
 VAR wobjdata fix:=[FALSE,TRUE,"",[[340,-60,180],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
"""
MOVE = "v100, z1, mill\\WObj:=fix;"


def robtarget(x: float = 0.0, track: str = "9E9") -> str:
    axes = EXTERNAL.replace("9E9", track, 1)
    return f"[[{x},0,0],[0,0,1,0],[-1,0,-1,0],{axes}]"


def fanuc(*lines: str, fields: str = "", **frames: str) -> str:
    """Return a program with the positions 1 to 4."""
    body = "".join(f"{i:4}:{line} ;\n" for i, line in enumerate(lines, 1))
    text = (
        "P[{}]{{\n GP1:\n\tUF : {}, UT : 1, CONFIG : 'N U T, 0, 0, 0',\n\tX = {}.0 mm, Y = 0.0 mm,"
    )
    text += " Z = 150.0 mm,\n\tW = 180.0 deg, P = -.588 deg, R = 0.0 deg{}\n}};\n"
    places = "".join(text.format(i, frames.get("uf", "0"), 400 + i, fields) for i in range(1, 5))
    return f"/PROG P\n/MN\n{body}/POS\n{places}/END\n"


def read(tmp_path, suffix: str, text: str, harmless=()):
    file = tmp_path / f"a{suffix}"
    file.write_text(text)
    return read_program(file, harmless)


def outcomes(program) -> list[tuple[int, str]]:
    """Return line and reason of each motion; "" for one that is corrected."""
    lines = program.motion_lines.tolist()
    return [*zip(lines, program.reasons, strict=True)]


def bases(program) -> list[float]:
    """Return the first number of each target's base frame."""
    return [(*frames_at(program, row)[0].values, np.nan)[0] for row in range(len(program))]


def frames_at(program, row):
    """Return base and tool of a target."""
    return program.frames[program.frame_index[row]]


PROGRAMS = {
    ".src": (
        f"DEF m()\n{FRAMES}XP1={POSE}\nXP2={POSE}\n|$VEL.CP=0.1|LIN XP1 C_DIS|LIN {POSE}|LIN {POSE}"
        f"\n$OUT[3]=TRUE|CIRC {POSE},{POSE}|WAIT SEC 0.5|LIN {POSE}|END\n"
    ).replace("DEF m()\n", "DEF m()\nDECL FRAME XP1\nDECL FRAME XP2\n"),
    ".mod": (
        f"{DATA} VAR robtarget p10:={robtarget()};\n VAR robtarget p20:={robtarget(40)};\n "
        f"PROC main()|Set doGlue;|MoveJ p10, {MOVE}|MoveL p20, {MOVE}|MoveC p20, p10, {MOVE}|"
        f"WaitTime 1;|MoveL {robtarget(9)}, {MOVE}| ENDPROC\nENDMODULE\n"
    ),
    ".ls": fanuc("UFRAME_NUM=0", "L P[1] 9mm/sec FINE", "DO[1]=ON", "L P[2] 9mm/sec CNT5", "END")
    .replace(";\n   ", ";|   ")
    .replace("|   1", "\n   1"),
    ".script": (
        "def m():\n set_tcp(p[0,0.06,0.08,0,0,0])\n corner = p[-0.45,0,0.2,0,3.1,0]|sleep(1)"
        "|movel(corner, a=1)|movel(p[-0.4,0,0.2,0,3.1,0])|movec(corner, corner)|movel(corner)|end\n"
    ),
}
"""Programs in which statements can be inserted at "|"."""


OWN_FRAMES = ("UFRAME_NUM=R[1]", "CALL MOVEFRM", "IF R[1]=1,CALL MOVEFRM")
"""Settings of the active frame, while each position of FANUC TP has the numbers of its own."""


@pytest.mark.parametrize(
    ("suffix", "statement"),
    [
        (suffix, statement)
        for suffix, statements in (
            (".src", KRL),
            (".mod", RAPID),
            (".ls", FANUC),
            (".script", URSCRIPT),
        )
        for statement in statements
    ],
)
def test_an_inserted_setting_of_the_state_changes_only_what_is_listed(tmp_path, suffix, statement):
    parts = PROGRAMS[suffix].split("|")
    before = read(tmp_path, suffix, "\n".join(parts))
    assert not any(before.reasons)
    n_listed = 0
    for place in range(1, len(parts)):
        first, last = "\n".join(parts[:place]), "\n".join(parts[place:])
        line = f"   9:  {statement} ;" if suffix == ".ls" else statement
        text = f"{first}\n{line}\n{last}"
        after = read(tmp_path, suffix, text)
        assert len(after.motions) == len(before.motions)
        n_listed += sum(map(bool, after.reasons))
        for index, reason in enumerate(after.reasons):
            if reason:
                continue
            old, new = (np.flatnonzero(program.motion == index) for program in (before, after))
            for row, same in zip(old, new, strict=True):
                pairs = zip(frames_at(before, row), frames_at(after, same), strict=True)
                changed = [frame for old_frame, frame in pairs if frame != old_frame]
                assert not any(frame.values for frame in changed)
                n_listed += len(changed)  # a frame in the controller is listed, unless it is given
                np.testing.assert_array_equal(before.values[row], after.values[same])
                np.testing.assert_array_equal(before.config[row], after.config[same])
    assert n_listed or statement in OWN_FRAMES


@pytest.mark.parametrize(
    ("suffix", "text", "expected"),
    [
        # component and element assignments
        (".src", f"DEF m()\n{FRAMES}LIN XP1\nXP1.Z=XP1.Z+20.0\nEND", {4: "XP1"}),
        (".script", "t = p[-0.4,0,0.2,0,3,0]\nmovel(t)\nt[2] = t[2] + 0.05\n", {2: "a variable"}),
        # frames of inline forms
        (
            ".src",
            f"{FRAMES}LIN {POSE}\nFDAT_ACT={{TOOL_NO 1,BASE_NO 3,IPO_FRAME #BASE}}\nLIN {POSE}\n"
            f"FDAT_ACT.BASE_NO=4\nBAS(#FRAMES)\nLIN {POSE}",
            {3: "", 5: "", 8: "FDAT_ACT.BASE_NO=4"},
        ),
        # branches, loops, labels
        (
            ".src",
            f"{FRAMES}IF $IN[1] THEN\n$BASE=$WORLD\nELSE\n$BASE=$WORLD\nENDIF\nLIN {POSE}\n"
            f"IF $IN[2] THEN\n$TOOL=$NULLFRAME\nENDIF\nLIN {POSE}",
            {8: "", 12: "not the same"},
        ),
        (
            ".src",
            f"{FRAMES}LOOP\nLIN {POSE}\n$BASE=$WORLD\nENDLOOP",
            {4: "not the same"},
        ),
        (
            ".src",
            f"{FRAMES}AGAIN:\nLIN {POSE}\n$BASE=$WORLD\nLIN {POSE}\nGOTO AGAIN\nLIN {POSE}",
            {4: "not the same", 6: "", 8: "never reached"},
        ),
        # subprograms
        (
            ".src",
            f"DEF m()\n{FRAMES}SUB()\n$BASE=$WORLD\nSUB()\nLIN {POSE}\nOTHER()\nLIN {POSE}\nEND\n"
            f"DEF SUB()\nLIN {POSE}\nEND",
            {7: "", 9: "OTHER()", 12: "not the same"},
        ),
        (
            ".mod",
            f"{DATA}PROC main()\nsub;\nMoveL {robtarget()}, {MOVE}\nENDPROC\n"
            f"PROC sub()\nPDispOn p1, mill;\nENDPROC\nENDMODULE",
            {6: "PDispOn"},
        ),
        # expressions, relative motions, external kinematics
        (
            ".src",
            f"{FRAMES}LIN XP1:{POSE}\nLIN {POSE}:XP1\nLIN_REL {{Z 5}}\nLIN {POSE}\n"
            f"$BASE=EK(A,B,C)\nLIN {POSE}",
            {3: "expression", 4: "expression", 5: "relative", 6: "", 8: "EK(A,B,C)"},
        ),
        # numbers of the target before, after a circle that ends elsewhere; half a configuration
        (
            ".src",
            f"{FRAMES}LIN {POSE}\nCIRC {POSE},{POSE},CA 360\nLIN {{Z 5}}\n"
            f"PTP {POSE[:-1]},S 2,T N}}\nLIN {POSE[:-1]},E1 N}}",
            {3: "", 4: "", 5: "not all numbers", 6: "S and T", 7: "E1 N"},
        ),
        # tools and work objects that move
        (
            ".mod",
            f"{DATA}VAR tooldata gun:=[FALSE,[[0,0,9],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
            'VAR wobjdata belt:=[FALSE,FALSE,"CNV",[[0,0,9],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
            f"PROC main()\nMoveL {robtarget()}, v1, z1, gun;\n"
            f"MoveL {robtarget()}, v1, z1, mill\\WObj:=belt;\nMoveExtJ [[9]], v1, z1;\n"
            f"MoveL {robtarget()}, {MOVE}\nENDPROC\nENDMODULE",
            {7: "tool on the robot", 8: "does not move", 9: "not read", 10: "MoveExtJ"},
        ),
        (
            ".mod",
            f"{DATA}CONST robtarget p:={robtarget()};\n"
            f"PROC go(robtarget p\\PERS wobjdata WObj)\nMoveL p, {MOVE}\n"
            f"MoveL {robtarget()}, v1, z1, mill\\WObj?WObj;\nENDPROC\nENDMODULE",
            {6: "parameter", 7: "parameter"},
        ),
        # names of routines
        (
            ".mod",
            f"{DATA}PROC main()\nCONST robtarget a:={robtarget(1)};\nMoveL a, {MOVE}\nENDPROC\n"
            f"PROC two()\nCONST robtarget a:={robtarget(2)};\nMoveL a, {MOVE}\nENDPROC\nENDMODULE",
            {6: "", 10: ""},
        ),
        (
            ".script",
            "global a = p[-0.4,0,0.2,0,3,0]\ndef go(a):\n movel(a)\nend\ngo(a)\nmovel(a)",
            {3: "parameter", 6: ""},
        ),
        # one line
        (
            ".mod",
            f"{DATA}PROC main()\nIF DInput(di1)=1 MoveL {robtarget()}, {MOVE} TEST n CASE 1: "
            f"MoveL {robtarget()}, {MOVE} ENDTEST\nENDPROC\nENDMODULE",
            {5: "", -1: ""},
        ),
        (
            ".script",
            "if (a): movel(p[-0.4,0,0.2,0,3,0]) else: movel(b) end\nmovel(p[\n "
            "-0.4,0,0.2,\n 0,3,0])",
            {1: "", -1: "b is a variable", 2: ""},
        ),
        # motions of processes, and names like motions
        (
            ".mod",
            f"{DATA}PROC main()\nMoveLDO {robtarget()}, v1, z1, mill\\WObj:=fix, do1, 1;\n"
            f"TriggL {robtarget()}, v1, t1, z1, mill\\WObj:=fix;\nmoveCount:=moveCount+1;\n"
            f"display_state;\nMoveL Offs(p1,0,0,5), {MOVE}\nMoveL pPath{{i}}, {MOVE}\n"
            f"MoveL [[n+1,0,0],[1,0,0,0]], {MOVE}\nENDPROC\n"
            f"PROC display_state()\nENDPROC\nENDMODULE",
            {5: "", 6: "", 9: "expression", 10: "expression", 11: "not a literal"},
        ),
        # FANUC
        (
            ".ls",
            fanuc(
                "!goto /POS 2",
                "L P[1] 9mm/sec FINE",
                "L P[R[5]] 9mm/sec FINE",
                "L P[2] 9mm/sec CNT0 TB .10sec,P-SPS",
                "L P[2] 9mm/sec FINE COORD",
                "L P[2] 9mm/sec FINE RTCP",
                "L P[2] 9mm/sec FINE Offset",
                "C P[3]\n      P[4] 9mm/sec FINE",
                "L P[2] 9mm/sec FINE Skip,LBL[4]",
                "UFRAME_NUM=2",
                "L P[2] 9mm/sec FINE",
            ),
            {4: "", 5: "register", 6: "", 7: "COORD", 8: "RTCP", 9: "Offset", 10: "", 12: "",
             14: "frame number is 2"},
        ),
        # URScript
        (
            ".script",
            "set_tcp(p[0,0,0.1,0,0,0],\"Mill\")\nd = [f()[0]-0.1, 2]\n"
            "W = struct(p=p[-0.4,0,0.2,0,3,0],q=[0,-1,1,0,0,0])\nmovej(W.q)\n"
            "movel(W.p)\nmovej([d2r(90),0,0,0,0,0])\n"
            "movej(get_inverse_kin(W.p, qnear=W.q))",
            {4: "d = [f()", 5: "d = [f()", 6: "d = [f()", 7: "d = [f()"},
        ),
        (
            ".script",
            "daemon = rpc_factory(\"xmlrpc\", \"http://127.0.0.1\")\nset_tcp(p[0,0,0.1,0,0,0])\n"
            "daemon.show(\"a\")\nmovel(p[-0.4,0,0.2,0,3,0])\nfan.turn(1)\n"
            "movel(p[-0.4,0,0.2,0,3,0])",
            {4: "", 6: "fan.turn"},
        ),
        # routines that are entered at any time
        (
            ".src",
            f"DEF m()\n{FRAMES}INTERRUPT DECL 3 WHEN $IN[1] DO S()\n{FRAMES}LIN {POSE}\nEND\n"
            "DEF S()\n$BASE=$WORLD\nEND",
            {7: "at any time"},
        ),
        (
            ".mod",
            f"{DATA}PROC main()\nPDispOff;\nMoveL {robtarget()}, {MOVE}\nENDPROC\n"
            "TRAP t1\nPDispSet d;\nENDTRAP\nENDMODULE",
            {6: "PDispSet"},
        ),
        (
            ".mod",
            f"{DATA}PROC main()\nPDispOff;\nMoveL {robtarget()}, {MOVE}\nERROR\nPDispSet d;\n"
            "RETRY;\nENDPROC\nENDMODULE",
            {6: "PDispSet"},
        ),
        (
            ".script",
            "def m():\n run w()\n set_tcp(p[0,0,0.1,0,0,0])\n movel(p[-0.4,0,0.2,0,3,0])\nend\n"
            "thread w():\n set_tcp(p[0,0,0.2,0,0,0])\n movel(p[-0.4,0,0.2,0,3,0])\nend",
            {4: "at any time", 8: "at any time"},
        ),
        # calls in conditions and in motions
        (
            ".src",
            f"DEF m()\n{FRAMES}WHILE NXT()\n$BASE=$WORLD\nENDWHILE\nLIN GET($BASE)\nEND\n"
            f"DEFFCT BOOL NXT()\nLIN {POSE}\nRETURN TRUE\nENDFCT",
            {7: "GET($BASE)", 10: "not the same"},
        ),
        (
            ".src",
            f"DEF m()\n{FRAMES}SHIFT($BASE)\nLIN {POSE}\nEND\nDEF SHIFT(F:OUT)\nF.X=9\nEND",
            {5: "SHIFT($BASE)"},
        ),
        (
            ".mod",
            f"{DATA}PROC main()\nIF a THEN\nMoveL {robtarget()}, {MOVE}\nELSEIF f() THEN\n"
            f"MoveL {robtarget()}, {MOVE}\nELSE\nMoveL {robtarget()}, {MOVE}\nENDIF\nPDispOff;\n"
            f"MoveL f(), {MOVE}\nMoveL {robtarget()}, {MOVE}\nPDispOff;\n"
            f'MoveLSync {robtarget()}, {MOVE[:-1]}, "f";\nMoveL {robtarget()}, {MOVE}\nENDPROC\n'
            "FUNC bool f()\nPDispSet d;\nENDFUNC\nENDMODULE",
            {6: "", 8: "PDisp", 10: "PDisp", 13: "PDisp", 14: "PDisp", 16: "not read", 17: "PDisp"},
        ),
        (
            ".script",
            "set_tcp(p[0,0,0.1,0,0,0])\nif a:\nmovel(p[-0.4,0,0.2,0,3,0])\nelif other():\n"
            "movel(p[-0.4,0,0.2,0,3,0])\nend",
            {3: "", 5: "other()"},
        ),
        (
            ".script",
            "def movehome():\nset_tcp(a)\nend\ndef m():\nset_tcp(p[0,0,0.1,0,0,0]);\n"
            "movel(p[-0.4,0,0.2,0,3,0]); movej([0,-1,1,0,0,0])\nmovel(movehome())\n"
            "movel(p[-0.4,0,0.2,0,3,0])\nend",
            {6: "", -1: "", 7: "not the same", 8: "not the same"},
        ),
        # what searches write, and joint targets in a state that moves them
        (
            ".mod",
            f"{DATA}VAR robtarget s:={robtarget()};\nPROC main()\n"
            f"SearchL\\Stop, d, s, p, v1, mill;\nMoveL s, {MOVE}\nSoftAct 1, 20;\n"
            f"MoveAbsJ [[0,0,0,0,30,0],{EXTERNAL}], v1, z1, mill;\nENDPROC\nENDMODULE",
            {6: "not read", 7: "SearchL", 9: "SoftAct"},
        ),
        (
            ".src",
            f"{FRAMES}$IPO_MODE=#TCP\nPTP {{A1 0,A2 -90,A3 90,A4 0,A5 60,A6 0}}\n$IPO_MODE=#BASE\n"
            f"LIN (XP1)\nLIN {POSE}C_DIS\nSLIN {POSE} WITH $BASE=$WORLD C_SPL\nEXT GRIP(INT:IN)\n"
            f"LIN {POSE.replace('X 0', 'X 9E9')}\nLIN {POSE}",
            {4: "#TCP", 6: "expression", 7: "", 8: "", 10: "not within", 11: ""},
        ),
        (
            ".ls",
            fanuc(
                "UFRAME_NUM=1",
                "UTOOL_NUM=1",
                "L P[1] 9mm/sec FINE TB .10sec,CALL A",
                "L P[1] 9mm/sec FINE",
                "UFRAME_NUM=1",
                "UTOOL_NUM=1",
                "WAIT DI[1]=ON TIMEOUT,LBL[5]",
                "UFRAME_NUM=2",
                "LBL[5]",
                "L P[1] 9mm/sec FINE",
                "UFRAME_NUM=1+R[2]",
                "L P[1] 9mm/sec FINE",
                "GP1:L P[1] 9mm/sec FINE",
                uf="F",
            ),
            {5: "", 6: "CALL A", 12: "not the same", 14: "R[2]", 15: "no motion is expected"},
        ),
        (
            ".ls",
            fanuc("L P[1] 9mm/sec FINE", fields=", E1 = ******** mm"),
            {3: "not set"},
        ),
        (
            ".ls",
            fanuc("C P[2] P[3] 9mm/sec FINE").replace("UF : 0", "UF : 1", 2),
            {3: "different frames"},
        ),
        # FANUC with texts of another language
        (
            ".ls",
            fanuc("L P[1] 9mm/sec FINE").replace("CONFIG", "KONFIG"),
            {3: "configuration"},
        ),
    ],
)  # fmt: skip
def test_a_motion_is_corrected_or_listed_with_its_cause(tmp_path, suffix, text, expected):
    listed = outcomes(read(tmp_path, suffix, text))
    assert len(listed) == len(expected)
    for (line, reason), (place, part) in zip(listed, expected.items(), strict=True):
        assert place in (line, -1)
        assert part in reason and bool(part) == bool(reason), (line, reason)


def test_a_routine_of_another_file_may_be_declared_harmless(tmp_path):
    text = f"{FRAMES}GRIP(1)\nLIN {POSE}\n"
    assert read(tmp_path, ".src", text).reasons != ("",)
    assert read(tmp_path, ".src", text, ["grip"]).reasons == ("",)


def test_krl_takes_over_missing_numbers_of_a_literal_target(tmp_path):
    text = (
        f"{FRAMES}LIN {POSE}\nLIN {{X 5}}\nLIN {{Z 7}}\nPTP {{A1 1}}\n$BASE=$WORLD\nLIN {{X 1}}\n"
    )
    program = read(tmp_path, ".src", text)
    assert [bool(reason) for reason in program.reasons] == [False, False, False, True, True]
    np.testing.assert_array_equal(program.values[2, :6], [5, 0, 7, 180, 0, 180])


def test_each_subprogram_has_the_frames_of_its_calls(tmp_path):
    text = f"DEF m()\n{FRAMES}EDGE()\n$BASE=$WORLD\nLIN {POSE}\nEND\nDEF EDGE()\nLIN {POSE}\nEND"
    assert bases(read(tmp_path, ".src", text)) == [0.0, 380.0]


def test_splines_have_the_frames_of_their_with_clauses(tmp_path):
    (tmp_path / "a.dat").write_text("DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}\n")
    (tmp_path / "$config.dat").write_text(f"BASE_DATA[2]={POSE.replace('X 0', 'X 7')}\n")
    clause = "WITH $VEL=SVEL_CP(0.2, , L1), $TOOL=STOOL2(FP1), $BASE=SBASE(FP1.BASE_NO)"
    text = f"{FRAMES}SLIN {POSE} {clause}\nSLIN {POSE} WITH $BASE=SBASE(FP2.BASE_NO)\nSLIN {POSE}"
    program = read(tmp_path, ".src", text)
    assert bases(program) == [7.0, 380.0]
    assert "FP2" in program.reasons[1]
    assert program.frames[0][1].name == "TOOL_DATA[1]"
