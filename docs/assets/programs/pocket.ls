/PROG  POCKET
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "LR Mate 200iD";
LINE_COUNT	= 9;
/MN
   1:  !A pocket in a plate ;
   2:  UFRAME_NUM=0 ;
   3:  UTOOL_NUM=1 ;
   4:J P[1:"ready"] 50% FINE    ;
   5:L P[2] 100mm/sec FINE    ;
   6:L P[3] 50mm/sec CNT10    ;
   7:L P[4] 50mm/sec CNT10    ;
   8:L P[5] 50mm/sec FINE Offset,PR[2]    ;
   9:L P[2] 100mm/sec FINE    ;
/POS
P[1:"ready"]{
   GP1:
	UF : 0, UT : 1,	
	J1=     0.000 deg,	J2=     0.000 deg,	J3=     0.000 deg,
	J4=     0.000 deg,	J5=   -60.000 deg,	J6=     0.000 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   400.000  mm,	Y =     -.500  mm,	Z =   150.000  mm,
	W =   180.000 deg,	P =     -.588 deg,	R =     0.000 deg
};
P[3]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   400.000  mm,	Y =     0.000  mm,	Z =   100.000  mm,
	W =   180.000 deg,	P =     -.588 deg,	R =     0.000 deg
};
P[4]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   400.000  mm,	Y =   100.000  mm,	Z =   100.000  mm,
	W =   180.000 deg,	P =     -.588 deg,	R =     0.000 deg
};
P[5]{
   GP1:
	UF : 0, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   450.000  mm,	Y =   100.000  mm,	Z =   100.000  mm,
	W =   180.000 deg,	P =     -.588 deg,	R =     0.000 deg
};
/END
