"""Arrays of the data that flows are read-only, whatever the field's type says around them."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from deepmf_sumo import scene as datatypes
from deepmf_sumo.scene import View

from tests.support.predictor_doubles import straight_tracks
from tests.support.result_folders import plan

TYPES = [one for one in vars(datatypes).values() if isinstance(one, type) and is_dataclass(one)]


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
def test_every_field_with_arrays_is_copied(kind):
    """By the annotations' text, which says `ndarray` in whatever form."""
    named = {one.name for one in fields(kind) if "ndarray" in str(one.type)}
    if named:
        assert issubclass(kind, datatypes._arrays.Frozen)
        assert named == {name for name, _ in datatypes._arrays._arrays_of(kind)}


def test_what_a_planner_and_a_report_get_cannot_be_changed():
    path = np.zeros((3, 2))
    view = View(
        step=10, dt_s=0.1, av_id="av", history=straight_tracks({"av": (0, 0, 0, 1)}), road=None,
        signals={}, steps_left=1, av_path_m=path,
    )  # fmt: skip
    path[0] = 7.0  # the world's own path may change; the view's does not
    assert (view.av_path_m == 0.0).all()
    reason = plan().reason
    changed = type(reason)(
        **{one.name: getattr(reason, one.name) for one in fields(reason)}
        | {"sector": np.zeros((2, 2), int), "allowed": {"fair": np.ones(2, bool)}}
    )
    for array in (view.av_path_m, changed.sector, changed.allowed["fair"], changed.value):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
