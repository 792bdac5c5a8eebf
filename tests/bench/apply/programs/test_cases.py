"""Check which motions of the collected cases are read, and which are listed.

`../shared/cases/programs/README.md` says what each case is about.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from stiff_apply.programs.languages import read_program

CASES = Path(__file__).parents[5] / "shared/cases/programs"
LINES = {
    "01_component_assignment.src": ([6], [8, 9]),
    "03_spline_with_frames.src": ([3, 5, 8, 11, 14], []),
    "04_fdat_act_literal.src": ([5, 6, 9], []),
    "05_base_in_subprogram.src": ([5, 8, 12, 13], []),
    "08_base_data_in_program.src": ([7, 8, 9], []),
    "09_full_circle_ca.src": ([5, 6, 7, 8], []),
    "11_lin_rel.src": ([5, 6, 8], [7]),
    "12_linear_track_e1.src": ([5, 6, 7, 8], []),
    "15_external_kinematics_base.src": ([5, 6], [8]),
    "16_assigned_once.src": ([7, 10, 11], []),
    "17_geometric_operator.src": ([5, 7], [6, 8]),
    "18_two_bases_inline.src": ([3, 8, 13], []),
    "20_compact_if.mod": ([8, 9, 10], []),
    "22_local_constants.mod": ([11, 15], []),
    "24_expression_in_target.mod": ([7], [8, 9]),
    "27_track_axis.mod": ([6, 7], []),
    "28_target_array.mod": ([10], [8]),
    "29_process_motions.mod": ([10, 11, 12, 13, 14], []),
    "30_names_like_motions.mod": ([7], [11]),
    "31_program_displacement.mod": ([6, 10], [8]),
    "34_offset_of_corrected_target.mod": ([8], [7, 9]),
    "40_indirect_position.ls": ([9, 11], [10]),
    "42_local_instruction_lines.ls": ([6, 11, 15], []),
    "44_coordinated_group.ls": ([], [8, 9, 10]),
    "46_circle_without_colon.ls": ([8, 9, 11], []),
    "47_slash_pos_in_comment.ls": ([9, 10], []),
    "48_offset_condition.ls": ([9, 11], [10]),
    "50_remote_tcp.ls": ([], [5, 6]),
    "60_list_of_expressions.script": ([3, 5], []),
    "62_list_on_lines.script": ([3, 12, 13], []),
    "63_element_assignment.script": ([3], [7]),
    "64_parameter_shadows.script": ([2], [5]),
    "65_two_tools.script": ([3, 5], []),
    "66_degrees.script": ([3, 5], [4]),
    "67_polyscope_export.script": ([3, 9], [8, 10]),
    "69_one_line_if.script": ([3], [4, 5]),
    "72_time_and_blend_every.script": ([3, 4, 5], []),
    "73_set_tcp_with_name.script": ([3], []),
    "74_waypoint_struct.script": ([4, 5, 6], []),
    "81_joint_targets_only.src": ([4, 5], []),
    "82_program_with_its_own_tool.src": ([5, 6], []),
    "83_load_in_turned_base.src": ([4, 5], []),
}
"""Program -> lines of the motions with literal targets, and lines of the other motions."""


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not part of the repository")
@pytest.mark.parametrize("name", LINES)
def test_each_motion_of_a_case_is_read_or_listed(name):
    program = read_program(CASES / name)
    lines, reasons = program.motion_lines.tolist(), program.reasons
    read_lines = [line for line, reason in zip(lines, reasons, strict=True) if not reason]
    listed_lines = [line for line, reason in zip(lines, reasons, strict=True) if reason]
    assert (read_lines, listed_lines) == LINES[name]
