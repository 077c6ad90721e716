from deepmf_sumo.report.tables.layouts import _difference


def test_a_difference_on_one_scene_has_no_interval():
    row = {"difference": "0.5", "difference_lo": "", "difference_hi": ""}
    assert _difference(row) == "+0.50"
    assert _difference({"difference": "", "difference_lo": "", "difference_hi": ""}) == "-"
    known = {"difference": "-1", "difference_lo": "-2", "difference_hi": "0.25"}
    assert _difference(known) == "-1.00 (-2.00 to +0.25)"
