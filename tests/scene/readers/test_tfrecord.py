import gzip

import google_crc32c
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepmf_sumo.errors import ReaderError
from deepmf_sumo.scene.readers import womd

PAYLOADS = st.lists(st.binary(max_size=40), min_size=1, max_size=6)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("framing") / "shard.tfrecord"


def test_the_checksum_is_crc_32c():
    assert google_crc32c.value(b"123456789") == 0xE3069283


def test_an_empty_payload_is_framed_by_known_bytes():
    # Length 0 and the masked CRC-32C of eight zero bytes (0x8C28B28A) and of nothing (0).
    masked = (((0x8C28B28A >> 15) | (0x8C28B28A << 17)) + 0xA282EAD8) & 0xFFFFFFFF
    expected = bytes(8) + masked.to_bytes(4, "little") + (0xA282EAD8).to_bytes(4, "little")
    assert womd.framed(b"") == expected


@settings(deadline=None)
@given(payloads=PAYLOADS, packed=st.booleans())
def test_round_trip(file, payloads, packed):
    content = b"".join(womd.framed(one) for one in payloads)
    file.write_bytes(gzip.compress(content) if packed else content)
    found = list(womd.records(file))
    assert [one.payload for one in found] == payloads
    assert womd.looks_framed(file)
    for one in found:
        assert womd.record_at(file, one.offset, one.index) == one


@pytest.mark.slow_unit
@settings(max_examples=300, deadline=None)
@given(payloads=PAYLOADS, data=st.data())
def test_a_flipped_bit_never_gives_a_wrong_payload(file, payloads, data):
    content = bytearray(b"".join(womd.framed(one) for one in payloads))
    where = data.draw(st.integers(0, len(content) - 1))
    content[where] ^= 1 << data.draw(st.integers(0, 7))
    file.write_bytes(content)
    found = list(womd.records(file))
    broken = [one for one in found if isinstance(one, womd.Broken)]
    assert len(broken) == 1
    good = [one for one in found if isinstance(one, womd.TfRecord)]
    assert all(one.payload == payloads[one.index] for one in good)
    # With its length known, only the damaged record is lost.
    lost = len(payloads) - broken[0].index if broken[0].end is None else 1
    assert len(good) == len(payloads) - lost


@settings(deadline=None)
@given(payloads=PAYLOADS, packed=st.booleans(), data=st.data())
def test_a_cut_file_gives_the_whole_records_and_one_report(file, payloads, packed, data):
    framed = [womd.framed(one) for one in payloads]
    content = b"".join(framed)
    content = gzip.compress(content) if packed else content
    file.write_bytes(content[: data.draw(st.integers(1, len(content) - 1))])
    found = list(womd.records(file))
    good = [one for one in found if isinstance(one, womd.TfRecord)]
    assert [one.payload for one in good] == payloads[: len(good)]
    borders = {sum(map(len, framed[:count])) for count in range(len(framed))}
    if not packed and file.stat().st_size in borders:
        assert len(found) == len(good)
    elif len(good) < len(payloads):
        assert isinstance(found[-1], womd.Broken)
        assert found[-1].end is None


@settings(deadline=None)
@given(noise=st.binary(min_size=1, max_size=200))
def test_noise_ends_in_one_report(file, noise):
    file.write_bytes(noise)
    found = list(womd.records(file))
    assert len(found) == 1
    assert isinstance(found[0], womd.Broken)


def test_a_record_past_the_end_is_an_error_that_names_the_file(file):
    file.write_bytes(womd.framed(b"one"))
    with pytest.raises(ReaderError, match=r"shard.tfrecord record 1: the file ends before it"):
        womd.record_at(file, file.stat().st_size, 1)


def test_a_huge_length_with_a_right_checksum_is_refused(file):
    length = (2**40).to_bytes(8, "little")
    crc = google_crc32c.value(length)
    masked = (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF
    file.write_bytes(length + masked.to_bytes(4, "little") + b"x" * 100)
    (found,) = womd.records(file)
    assert "claims 1099511627776 bytes" in found.reason
