import errno
import json

import pytest
from safetensors.torch import load_file

from deepmf_sumo.cli import main
from deepmf_sumo.scene.readers import npz
from deepmf_sumo.training.fit import checkpoints

from tests.support.synthetic import scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two folders of few scenes, and room for what is made of them."""
    made = tmp_path_factory.mktemp("training")
    for name, shift in (("mine", 0.0), ("sumo", 5.0)):
        (made / name).mkdir()
        for number in range(3):
            scenes = scene(shift=shift + number - 20, av_speed=8.0 + number)
            npz.write(scenes, made / name / f"{number}.npz")
    (made / "sumo" / "broken.npz").write_bytes(b"PK\x03\x04 nothing")
    return made


@pytest.fixture
def train(folder, tmp_path, capsys):
    """`deepmf-sumo train opponent` with arguments -> (exit code, output, errors)."""

    def run(*arguments, out="set"):
        fixed = ["--out", str(tmp_path / out), "--cache", str(folder / "cache")]
        code = main.run(["train", "opponent", *map(str, arguments), *fixed])
        text = capsys.readouterr()
        return code, text.out, text.err

    return run


def card(folder):
    return json.loads((folder / "opponent.json").read_text(encoding="utf-8"))


def test_sources_are_mixed_by_weight_and_listed_in_the_card(train, folder, tmp_path):
    mine, sumo = f"{folder / 'mine'}=3", f"{folder / 'sumo'}=1"
    code, text, _ = train(
        "--data", mine, "--data", sumo, "--set", "steps=2", "--set", "licence=ours"
    )
    assert code == 0
    assert "sumo: 1 record(s) cannot be used and are left out: broken.npz" in text
    found = card(tmp_path / "set")
    assert [source["name"] for source in found["data"]] == ["mine", "sumo"]
    assert [source["share"] for source in found["data"]] == [0.75, 0.25]
    assert [source["refused"] for source in found["data"]] == [0, 1]
    losses = [source["held_out_loss"] for source in found["data"]]
    assert all(
        loss is None or loss > 0 for loss in losses
    )  # places are held out, not a share of each
    assert any(losses)
    assert (found["scenes"], found["refused"], found["licence"]) == (6, 1, "ours")
    assert (tmp_path / "set/curves/opponent.csv").is_file()
    assert not list((tmp_path / "set").glob("*checkpoint*"))


def test_what_has_been_made_is_left_as_it_is(train, folder, tmp_path):
    arguments = ["--data", folder / "mine", "--set", "steps=2"]
    train(*arguments)
    file = tmp_path / "set" / "opponent.safetensors"
    first, time = file.read_bytes(), file.stat().st_mtime_ns
    code, text, _ = train(*arguments)
    assert (code, file.stat().st_mtime_ns) == (0, time)
    assert "this training is complete; --again repeats it" in text
    train(*arguments, "--again")
    assert file.stat().st_mtime_ns > time
    assert file.read_bytes() == first  # the same seed, the same bytes
    train(*arguments, "--set", "seed=1")
    assert file.read_bytes() != first


def test_a_key_may_be_set_over_those_of_a_file(train, folder, tmp_path):
    file = folder / "train.yaml"
    file.write_text(
        "version: 1\ndata: [mine]\nseed: 5\nsteps: 9\nlicence: theirs\n"
        "opponent: {steps: 2, batch: 4}\n",
        encoding="utf-8",
    )
    assert train("--config", file, "--set", "opponent.batch=2")[0] == 0
    found = card(tmp_path / "set")
    assert (found["seed"], found["steps"], found["licence"]) == (5, 2, "theirs")
    assert found["schedule"]["batch"] == 2


def test_a_network_begins_from_another_set(train, folder, tmp_path):
    data = ["--data", folder / "mine"]
    train(*data, "--set", "steps=2", out="before")
    first = tmp_path / "before"
    assert (
        train(*data, "--set", "steps=1", "--set", "rate=1.0e-12", "--set", f"begin_from={first}")[0]
        == 0
    )
    before = load_file(first / "opponent.safetensors")
    after = load_file(tmp_path / "set" / "opponent.safetensors")
    assert card(tmp_path / "set")["began_from"] == str(first)
    changed = [
        name
        for name in before
        if "running" not in name and (before[name].float() - after[name].float()).abs().max() > 1e-4
    ]
    assert set(changed) <= {name for name in before if "num_batches" in name}


def test_what_one_network_cannot_begin_from_is_said_before_another_is_trained(
    train, folder, tmp_path, capsys
):
    data, first, made = ["--data", str(folder / "mine")], tmp_path / "before", tmp_path / "set"
    assert train(*data, "--set", "steps=2", out="before")[0] == 0  # an opponent network alone
    code = main.run(["train", "all", *data, "--set", f"begin_from={first}", "--out", str(made)])
    assert code == 2
    assert "marginal" in capsys.readouterr().err
    assert not made.exists()


def test_weights_that_cannot_be_written_leave_the_checkpoint(train, folder, tmp_path, monkeypatch):
    arguments = ["--data", folder / "mine", "--set", "steps=2"]

    real = checkpoints.write

    def full(file, content):
        if ".checkpoint" not in file.name:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(file, content)

    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "write", full)
        code, _, error = train(*arguments)
    assert code == 2
    assert "No space left on device" in error
    assert list((tmp_path / "set").glob("*.checkpoint"))
    code, text, _ = train(*arguments)
    assert code == 0
    assert "resuming from step 2" in text
    assert not list((tmp_path / "set").glob("*.checkpoint*"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "No data to train on"),
        (["--data", "nowhere"], "nowhere does not exist"),
        (["--data", "nowhere=much"], "'much' is not a weight"),
        (["--data", "mine=1", "--data", "sumo"], "sumo has no weight"),
        (["--data", "mine", "--set", "preset=huge"], "huge"),
        (["--data", "mine", "--set", "begin_from=nobody"], "There are no weights 'nobody'"),
        (["--data", "mine", "--set", "ema=1"], "key 'ema'"),
        (["--data", "mine", "--set", "rate=2"], "key 'rate'"),
        (["--data", "mine", "--set", "weight_decay=2"], "key 'weight_decay'"),
        (["--data", "mine", "--config", "missing.yaml"], "missing.yaml"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_made(
    train, folder, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(folder)
    code, _, error = train(*arguments)
    assert code == 2
    assert message in error
    assert not (tmp_path / "set").exists()


def test_a_folder_without_recordings_ends_with_3(train, tmp_path):
    (tmp_path / "empty").mkdir()
    code, _, error = train("--data", tmp_path / "empty")
    assert code == 3
    assert "empty contains no files; give recordings to train on" in error
