MODULE Pocket
  ! A pocket in a plate, milled on an IRB 120
  PERS tooldata spindle := [TRUE,[[40,0,54],[1,0,0,0]],[1.2,[0,0,30],[1,0,0,0],0,0,0]];
  PERS wobjdata plate := [FALSE,TRUE,"",[[340,-60,180],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
  CONST jointtarget ready := [[0,0,0,0,40,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget p10 := [[0,0,40],[0,0,1,0],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  CONST robtarget p20 := [[80,100,0],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    MoveAbsJ ready\NoEOffs, v1000, fine, spindle;
    MoveJ p10, v500, z10, spindle\WObj:=plate;
    MoveL [[0,0,0],[0,0,1,0],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]], v50, fine, spindle\WObj:=plate;
    MoveL [[80,0,0],[0,0,1,0],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]], v50, z1, spindle\WObj:=plate;
    MoveL p20, v50, z1, spindle\WObj:=plate;
    MoveL Offs(p20,-80,0,0), v50, z1, spindle\WObj:=plate;
    MoveL [[0,0,0],[0,0,1,0],[-1,0,-1,0],[9E9,9E9,9E9,9E9,9E9,9E9]], v50, fine, spindle\WObj:=plate;
    MoveJ p10, v500, fine, spindle\WObj:=plate;
  ENDPROC
ENDMODULE
