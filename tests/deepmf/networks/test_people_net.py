"""What a set of weights has learned of people: inputs, and the numpy network."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file

from deepmf_sumo.deepmf.networks import people_net, weights
from deepmf_sumo.deepmf.networks.decode import KNOT_STEPS
from deepmf_sumo.deepmf.networks.people import People, moving_pose, untrained
from deepmf_sumo.deepmf.networks.people_net import ODD, PeopleNet, inputs
from deepmf_sumo.errors import WeightsError
from deepmf_sumo.scene import DT_S
from deepmf_sumo.scene.geometry import frames
from deepmf_sumo.scene.road_users import ROAD_USERS
from deepmf_sumo.training import cards
from deepmf_sumo.training.networks.people import PeopleLayers, tensors_of

from tests.support.synthetic import scene, view

KNOTS = list(KNOT_STEPS)
MIRROR = np.array([1.0, -1.0])


def net(seed=3, size=0.3):
    """A network whose last layer is not zero."""
    torch.manual_seed(seed)
    layers = PeopleLayers()
    with torch.no_grad():
        for value in layers.last.parameters():
            value.normal_(0.0, size)
    return layers.eval()


def read(seen, agent_id="walker"):
    return inputs(seen, untrained(seen, agent_id), moving_pose(seen, agent_id))


def mirrored(seen):
    """The view with left and right exchanged."""
    tracks, road = seen.history, seen.road
    return replace(
        seen,
        history=replace(
            tracks,
            position_m=tracks.position_m * MIRROR,
            heading_rad=frames.wrap(-tracks.heading_rad),
            velocity_mps=tracks.velocity_mps * MIRROR,
        ),
        road=replace(
            road,
            lanes={k: replace(v, centre_m=v.centre_m * MIRROR) for k, v in road.lanes.items()},
            edges=tuple(replace(one, points_m=one.points_m * MIRROR) for one in road.edges),
            polygons=tuple(replace(one, points_m=one.points_m * MIRROR) for one in road.polygons),
        ),
    )


def as_set(values):
    """Rows in an order of their own: ways are listed in another order in a mirrored world."""
    return values[np.lexsort(np.round(values, 3).T)]


def test_a_mirrored_world_has_the_mirrored_inputs():
    here, there = read(view()), read(mirrored(view()))
    assert there.own == pytest.approx(here.own * ODD["own"], abs=1e-4)
    assert there.around == pytest.approx(here.around * ODD["around"], abs=1e-4)
    assert as_set(there.motion) == pytest.approx(as_set(here.motion * ODD["motion"]), abs=1e-3)


def test_a_turned_world_has_the_same_inputs():
    here, there = read(view()), read(view(scene(turn=1.1)))
    for one, other in zip(here, there, strict=True):
        assert other == pytest.approx(one, abs=1e-3)


def test_inputs_by_hand():
    """The walker goes north at 1.3 m/s from (14, -6); a crosswalk begins 2 m ahead of it."""
    own = dict(zip(people_net.OWN, read(view()).own.tolist(), strict=True))
    assert own["speed"] == pytest.approx(1.3 / 3.0)
    assert own["known_10"] == 1.0
    assert own["ahead_10"] == pytest.approx(-1.3 / 2.0, abs=1e-3)
    assert own["crosswalk_there"] == 1.0
    assert own["crosswalk_ahead"] == pytest.approx(0.2, abs=1e-3)
    assert own["crosswalk_cos2"] == pytest.approx(1.0, abs=1e-3)  # its longer side runs north
    assert own["edge_ahead"] == pytest.approx(1.2, abs=1e-3)
    assert (own["lane_ahead"], own["lane_far"]) == pytest.approx((0.6, 0.6), abs=1e-3)
    assert own["lane_side_sin"] == pytest.approx(-1.0)  # the lane runs east, to the right
    assert own["on_lane"] == 0.0


def test_before_training_nothing_changes():
    found, plain = People(PeopleNet(tensors_of(PeopleLayers()))), People()
    one, other = (each.predict(view(), "walker") for each in (found, plain))
    assert one.position_m == pytest.approx(other.position_m)
    assert one.share == pytest.approx(other.share)
    assert one.width_m == pytest.approx(other.width_m)


def test_numpy_computes_what_torch_does():
    layers, seen = net(), read(view())
    batch = {name: torch.from_numpy(value)[None] for name, value in seen._asdict().items()}
    with torch.inference_mode():
        expected = layers(batch)[0].numpy()
    assert PeopleNet(tensors_of(layers))(seen) == pytest.approx(expected, abs=1e-5)


def test_residuals_are_where_the_network_says():
    """Bias of the last layer alone: 1 m/s ahead and -0.5 m/s to the left, at each knot."""
    layers = PeopleLayers()
    with torch.no_grad():
        layers.last.bias[1:11:2], layers.last.bias[2:11:2] = 0.2, -0.1
    seen = view()
    found = People(PeopleNet(tensors_of(layers))).predict(seen, "walker")
    slow = np.hypot(*np.diff(found.position_m, axis=1).swapaxes(0, -1)).max(0) / DT_S < 3.4
    assert slow.any()
    off = found.position_m[slow] - untrained(seen, "walker").position_m[slow]
    expected = np.array(people_net.KNOTS_S)[:, None] * [0.05, 0.1]  # it walks to the north
    assert off[:, KNOTS] == pytest.approx(np.broadcast_to(expected, off[:, KNOTS].shape), abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_what_is_learned_begins_here_and_keeps_to_the_speeds_of_the_class(seed):
    found = People(PeopleNet(tensors_of(net(seed)))).predict(view(), "walker")
    start = np.broadcast_to([14.0, -6.0], (len(found.share), 1, 2))
    steps = np.diff(np.concatenate([start, found.position_m], axis=1), axis=1)
    speed = np.hypot(*steps.swapaxes(0, -1)) / DT_S
    assert speed.max() <= ROAD_USERS["pedestrian"].motion.fastest_mps + 1e-6
    assert np.abs(np.diff(speed, axis=0)).max() < 1.5  # no jumps
    assert found.share.sum() == pytest.approx(1.0)
    assert (found.width_m >= people_net.LEAST_M).all()


@pytest.fixture
def folder(tmp_path):
    cards.write(tmp_path, "people", net(), {"inputs": people_net.INPUTS_VERSION})
    return tmp_path


def test_a_set_with_people(folder):
    found = weights.people_net_of(folder)
    assert found is not None
    expected = People(PeopleNet(tensors_of(net()))).predict(view(), "walker")
    one = People(found).predict(view(), "walker")  # layers are stored in half precision
    assert np.abs(one.position_m - expected.position_m).max() < 0.05
    assert weights.without_people(folder) == ""
    assert "people" in weights.listed(folder)


def test_a_set_without_people_says_so(tmp_path):
    assert weights.people_net_of(tmp_path) is None
    assert "without trained weights" in weights.without_people(tmp_path)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda values: values | {"last.weight": values["last.weight"][:3]}, "another shape"),
        (lambda values: values | {"mix.bias": values["mix.bias"] * np.nan}, "not finite"),
        (lambda values: {k: v for k, v in values.items() if k != "own.bias"}, "is missing"),
    ],
)
def test_damaged_tensors(folder, change, expected):
    file = folder / "people.safetensors"
    save_file(change(load_file(file)), file)
    card = json.loads((folder / "people.json").read_text())
    card[weights.DIGEST] = weights.digest_of(file.read_bytes())
    (folder / "people.json").write_text(json.dumps(card))
    with pytest.raises(WeightsError, match=expected):
        weights.people_net_of(folder)


@pytest.mark.parametrize("cut", [0, 4, 9, 200, -1])
def test_a_file_that_ends_early(folder, cut):
    content = (folder / "people.safetensors").read_bytes()[:cut]
    (folder / "people.safetensors").write_bytes(content)
    card = json.loads((folder / "people.json").read_text())
    card[weights.DIGEST] = weights.digest_of(content)
    (folder / "people.json").write_text(json.dumps(card))
    with pytest.raises(WeightsError, match=r"people\.safetensors is damaged"):
        weights.people_net_of(folder)


def test_tensors_are_those_that_another_reader_finds(folder):
    content = (folder / "people.safetensors").read_bytes()
    expected = load_file(folder / "people.safetensors")
    found = PeopleNet.read(content).tensors
    assert found.keys() == expected.keys()
    assert all((found[name] == expected[name].astype(np.float32)).all() for name in found)


def test_tensors_of_another_card_or_other_inputs(folder):
    card = json.loads((folder / "people.json").read_text())
    (folder / "people.json").write_text(json.dumps(card | {"inputs": 99}))
    with pytest.raises(WeightsError, match="it reads inputs 99"):
        weights.people_net_of(folder)
    (folder / "people.json").write_text(json.dumps(card | {weights.DIGEST: "0"}))
    with pytest.raises(WeightsError, match="digest"):
        weights.people_net_of(folder)
    (folder / "people.safetensors").unlink()
    with pytest.raises(WeightsError, match="is missing"):
        weights.people_net_of(folder)
