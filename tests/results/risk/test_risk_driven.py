"""Tracks of a run, read for the AV and its opponents alone."""

import csv
import gzip

import numpy as np
import pytest

from deepmf_sumo.errors import UsageError
from deepmf_sumo.results import tracks as stored_tracks
from deepmf_sumo.results.risk import tracks

COLUMNS = ("step", "time_s", "id", "kind", "role", "driver", "x_m", "y_m", "heading_rad")
COLUMNS += ("speed_mps", "length_m", "width_m")
OPPONENT = 'the "red", one'


def write(file, vehicles, steps):
    """Tracks of an AV `ego` and of vehicles (id, role) that are there at some steps."""
    rng = np.random.default_rng(3)
    with gzip.open(file, "wt", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(COLUMNS)
        for step in range(steps):
            for name, role in vehicles:
                if role == "av" or rng.random() < 0.8:
                    place = [round(float(value), 3) for value in rng.normal(size=4)]
                    time = round(0.1 * (step - 10), 1)
                    table.writerow([step, time, name, "vehicle", role, "sumo", *place, 4.5, 1.8])


@pytest.mark.parametrize("piece", [7, 100, 4096, 1 << 20])
def test_vehicles_asked_for_are_read_whole_wherever_the_text_is_cut(tmp_path, monkeypatch, piece):
    file = tmp_path / "tracks.csv.gz"
    others = [("12", "opponent"), ("123", "other"), (OPPONENT, "opponent"), ("à 12", "other")]
    write(file, [("ego", "av"), *others], 60)
    monkeypatch.setattr(stored_tracks, "_PIECE", piece)
    read = stored_tracks.read_tracks(file, ["12", OPPONENT, "never there"])
    found = read.tracks
    assert read.av_id == "ego"
    assert set(found.ids) == {"ego", "12", OPPONENT}
    assert (read.now, found.valid.shape) == (10, (3, 60))
    with gzip.open(file, "rt", encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for name in ("ego", "12", OPPONENT):
        number = found.row(name)
        own = {int(row["step"]): row for row in rows if row["id"] == name}
        assert list(np.flatnonzero(found.valid[number])) == sorted(own)
        for step, row in own.items():
            assert tuple(found.position_m[number, step]) == (float(row["x_m"]), float(row["y_m"]))
            assert found.heading_rad[number, step] == float(row["heading_rad"])


def test_heights_are_read_where_a_result_has_them(tmp_path):
    file = tmp_path / "tracks.csv.gz"
    write(file, [("ego", "av"), ("12", "opponent")], 20)
    assert not tracks.read_tracks(file).tracks.z_m.any()
    with gzip.open(file, "rt", encoding="utf-8") as stream:
        head, *rows = stream.read().splitlines()
    with gzip.open(file, "wt", encoding="utf-8") as stream:
        stream.write("\n".join([head + ",z_m", *(row + ",8.0" for row in rows)]) + "\n")
    found = tracks.read_tracks(file).tracks
    assert (found.z_m[found.valid] == 8.0).all()


@pytest.mark.parametrize("share", [0.0, 0.4, 0.9])
def test_a_file_cut_short_is_refused_by_name(tmp_path, share):
    file = tmp_path / "tracks.csv.gz"
    write(file, [("ego", "av"), ("12", "opponent")], 60)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(UsageError, match=r"tracks.csv.gz is damaged \(.+\); run it again"):
        tracks.read_tracks(file)
