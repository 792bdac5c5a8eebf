"""Statements that set a state which is not read, each with its public source.

A program with one of them differs from the program without it only by motions that are listed.
"""

from __future__ import annotations

KSS = "KUKA System Software 8.x, operating and programming instructions for system integrators"
KRL_GUIDE = "KUKA, expert programming, release 5.2: coordinate systems, geometric operator"
KRL = {
    "$BASE.X=100.0": KRL_GUIDE,
    "$BASE=$BASE:{X 10.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}": KRL_GUIDE,
    "$BASE=INV_POS(XP2)": KRL_GUIDE,
    "$BASE=EK(MACHINE_DEF[2].ROOT,MACHINE_DEF[2].MECH_TYPE,XP2)": KSS,
    "$BASE=BASE_DATA[NUMBER]": KSS,
    "$TOOL=$TOOL:XP2": KRL_GUIDE,
    "$TOOL={X 0.0,Y OFFSET,Z 0.0,A 0.0,B 0.0,C 0.0}": KRL_GUIDE,
    "BAS(#EX_BASE,1)": "bas.src of KSS 5 to 8",
    "BAS(#BASE,NUMBER)": "bas.src of KSS 5 to 8",
    "BAS(#TOOL,GRIPPER)": "bas.src of KSS 5 to 8",
    "BAS(#CP_PARAMS,0.2)": "bas.src of KSS 5 to 8",
    "FDAT_ACT.BASE_NO=3\nBAS(#FRAMES,0)": "bas.src of KSS 5 to 8",
    "$ACT_BASE=2": KSS,
    "$IPO_MODE=#TCP": KSS,
    "$ROBROOT={X 0.0,Y 0.0,Z 100.0,A 0.0,B 0.0,C 0.0}": KSS,
    "IF $IN[1] THEN\n$BASE=$WORLD\nENDIF": KRL_GUIDE,
    "FOR I=1 TO 3\n$BASE.Z=$BASE.Z+10.0\nENDFOR": KRL_GUIDE,
    "SWITCH N\nCASE 1\n$TOOL=$NULLFRAME\nENDSWITCH": KRL_GUIDE,
    "XP1.Z=XP1.Z+5.0": KRL_GUIDE,
    "XP1=XP2:{X 1.0,Y 0.0,Z 0.0,A 0.0,B 0.0,C 0.0}": KRL_GUIDE,
    "SHIFT(XP1)": KRL_GUIDE,
    "CALIBRATE()": KRL_GUIDE,
    "GLOBAL INTERRUPT DECL 5 WHEN $IN[3] DO SHIFT()": KSS,
    "TRIGGER WHEN DISTANCE=0 DELAY=0 DO SHIFT() PRIO=-1": KSS,
    "X=MEASURE(1)": KRL_GUIDE,
}
RAPID_MANUAL = "ABB, technical reference manual: RAPID instructions, functions and data types"
RAPID = {
    "PDispOn p20, mill;": RAPID_MANUAL,
    "PDispOn\\Rot\\ExeP:=p20, p10, mill\\WObj:=fix;": RAPID_MANUAL,
    "PDispSet [[0,0,10],[1,0,0,0]];": RAPID_MANUAL,
    "EOffsOn p20;": RAPID_MANUAL,
    "EOffsSet [10,0,0,0,0,0];": RAPID_MANUAL,
    "SoftAct 1, 20;": RAPID_MANUAL,
    "SyncMoveOn sync1, tasks;": RAPID_MANUAL,
    "IF di1=1 PDispSet shift;": RAPID_MANUAL,
    "fix.uframe.trans.x:=100;": RAPID_MANUAL,
    "fix:=table;": RAPID_MANUAL,
    "mill.tframe:=CalcTool(1);": RAPID_MANUAL,
    "p10.trans.z:=p10.trans.z+5;": RAPID_MANUAL,
    "p10:=Offs(p20,0,0,5);": RAPID_MANUAL,
    "Shift p10;": RAPID_MANUAL,
    "%stName%;": RAPID_MANUAL,
    'CallByVar "proc", 1;': RAPID_MANUAL,
    "EGMSetupUC ROB_1, egm1, name, device;": "ABB, application manual: externally guided motion",
    "CapRefresh;": "ABB, application manual: continuous application platform",
}
FANUC_MANUAL = "FANUC, operator's manual: handling tool, program instructions"
FANUC = {
    "UFRAME_NUM=R[1]": FANUC_MANUAL,
    "UFRAME_NUM=2": FANUC_MANUAL,
    "UTOOL_NUM=3": FANUC_MANUAL,
    "UTOOL[1]=PR[2]": FANUC_MANUAL,
    "UTOOL[R[1]]=PR[2]": FANUC_MANUAL,
    "P[2]=PR[5]": FANUC_MANUAL,
    "TOUCH OFFSET START PR[1]": "FANUC, arc tool operator's manual: touch sensing",
    "Track TAST[1]": "FANUC, arc tool operator's manual: through-arc seam tracking",
    "$MNUFRAME[1,1]=PR[1]": "FANUC, software reference: system variables",
    "IF R[1]=1,CALL MOVEFRM": FANUC_MANUAL,
    "CALL MOVEFRM": FANUC_MANUAL,
    "IF (DI[1]) THEN ;\n   9:  UTOOL[1]=PR[2] ;\n   9:  ENDIF": FANUC_MANUAL,
    "VISION GET_OFFSET 'A' VR[1] JMP LBL[1]": "FANUC, iRVision operator's manual",
}
UR_MANUAL = "Universal Robots, script manual e-series, SW 5.x"
URSCRIPT = {
    "set_tcp(tool)": UR_MANUAL,
    "set_tcp(pose_trans(get_tcp_offset(), p[0,0,0.1,0,0,0]))": UR_MANUAL,
    "set_tcp(p[0,0,length,0,0,0])": UR_MANUAL,
    "if a: set_tcp(p[0,0,0.1,0,0,0]) end": UR_MANUAL,
    "while a < 3:\n  set_tcp(tools[a])\nend": UR_MANUAL,
    "force_mode(p[0,0,0,0,0,0],[0,0,1,0,0,0],[0,0,9,0,0,0],2,[1,1,1,1,1,1])": UR_MANUAL,
    "path_offset_enable()": UR_MANUAL,
    "track_conveyor_linear(p[1,0,0,0,0,0], 500)": UR_MANUAL,
    "corner[2] = corner[2] + 0.05": UR_MANUAL,
    "corner = pose_add(corner, p[0,0,0.05,0,0,0])": UR_MANUAL,
    "corner = p[0,0,0,0,0,0]": UR_MANUAL,
    "gripper_close(40)": UR_MANUAL,
    "width = gripper_width(1)": UR_MANUAL,
    "run worker()": UR_MANUAL,
}
