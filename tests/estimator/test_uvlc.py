"""UVLC pictures: bits written by hand against an inverse cosine transform that is not ours, encoder to decoder, and damage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.fft import idctn

from estimator.contracts.pictures import CodedPicture, PictureRefusal
from estimator.uvlc import UvlcDecoder
from sitl.ardrone.uvlc import encode

UVLC = UvlcDecoder()
WIDTH, HEIGHT = 176, 144
REAL = bytes.fromhex("438200003c0300e0a9ddf26b")
"""The first three words of a picture of a real AR.Drone 1.0, as published (AR.Drone Development, University of Tokyo, 2012)."""
PLAIN = "0" + "10000000" + "0010000000" * 6
"""A macroblock whose six blocks have a mean alone, of 128 / 8 steps of 3."""
GUIDE = "1 00111" + "000100 0001110" + "1 0001011" + "1 01"
"""The coefficients -3; 0; 0; 0; 0; 7; -5 and the block's end, as the developer guide codes them."""
GUIDE_LEVELS = {1: -3, 6: 7, 7: -5}
"""The same by their places in zigzag order."""


def start(number: int) -> str:
    return f"{0x20 | number:022b}"


def packed(bits: str) -> bytes:
    bits = bits.replace(" ", "")
    bits += "0" * (-len(bits) % 32)
    return b"".join(int(bits[i : i + 32], 2).to_bytes(4, "little") for i in range(0, len(bits), 32))


def aligned(bits: str, to: int = 8) -> str:
    return bits + "0" * (-len(bits) % to)


def picture(first: str = PLAIN, quantizer: int = 31, kind: int = 0, rows: int = 9, align: int = 8) -> bytes:
    """Return a picture of 176x144 px, grey except for its first macroblock."""
    bits = start(0) + "01" + "010" + f"{kind:03b}{quantizer:05b}{77:032b}" + first.replace(" ", "") + PLAIN * 10
    for row in range(1, rows):
        bits = aligned(bits, align) + start(row) + f"{quantizer:05b}" + PLAIN * 11
    return packed(aligned(bits, align) + start(0x1F))


def whole(datagram: bytes) -> NDArray[np.uint8]:
    header = UVLC.header(datagram)
    assert isinstance(header, CodedPicture), header
    px = UVLC.decode(datagram, header)
    assert isinstance(px, np.ndarray), px
    return px


def zigzag() -> list[tuple[int, int]]:
    """Return row and column of each place, by walking the diagonals."""
    places = [(y, x) for y in range(8) for x in range(8)]
    return sorted(places, key=lambda p: (p[0] + p[1], p[0] if (p[0] + p[1]) % 2 else p[1]))


def test_the_header_of_a_real_picture_is_read() -> None:
    assert UVLC.header(REAL) == CodedPicture(320, 240, 31, 6627)
    assert UVLC.decode(REAL, CodedPicture(320, 240, 31, 6627)) is PictureRefusal.TORN


@pytest.mark.parametrize(("quantizer", "steps"), [(31, 2), (2, 2), (7, 7)])
def test_coefficients_are_those_of_another_transform(quantizer: int, steps: int) -> None:
    px = whole(picture("0" + "10000001" + f"{170:010b}" + GUIDE + "0010000000" * 5, quantizer))
    coefficients = np.zeros((8, 8))
    coefficients[0, 0] = 170 * (1 + steps)
    for place, level in GUIDE_LEVELS.items():
        y, x = zigzag()[place]
        coefficients[y, x] = level * (1 + (1 + y + x) * steps)
    light = idctn(coefficients, norm="ortho")
    # The colours' blocks have the mean of the plain ones, which is no colour where it is 128.
    chroma = 128 * (1 + steps) / 8 - 128
    expected = np.stack([light + 1.772 * chroma, light - (0.344136 + 0.714136) * chroma, light + 1.402 * chroma], axis=-1).clip(
        0, 255
    )
    assert np.abs(px[:8, :8] - expected).max() <= 0.51


def test_a_picture_whose_rows_begin_with_a_word_is_the_same() -> None:
    assert np.array_equal(whole(picture(align=8)), whole(picture(align=32)))


def test_a_macroblock_changes_the_quantizer_of_its_row() -> None:
    finer = whole(picture("0" + "11000000" + "00" + "0010000000" * 6, quantizer=8))
    assert finer[40, 40, 1] == whole(picture(quantizer=8))[40, 40, 1]
    assert np.array_equal(finer[:16, :16], whole(picture(quantizer=7))[:16, :16])


def image(seed: int, width: int, height: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(float)
    a, b, c = rng.uniform(5.0, 40.0, 3)
    colours = [127 + 90 * np.sin(x / a), 127 + 90 * np.cos(y / b), 127 + 90 * np.sin((x + y) / c)]
    return np.stack(colours, axis=-1).astype(np.uint8)


@pytest.mark.parametrize(("width", "height"), [(176, 144), (320, 240), (352, 288), (640, 480)])
def test_what_was_encoded_comes_back(width: int, height: int) -> None:
    for seed in range(3):
        px = image(seed, width, height)
        for quantizer, error in ((31, 6.0), (12, 14.0)):
            datagram = encode(px, 2**32 - 1 + seed, quantizer)
            assert UVLC.header(datagram) == CodedPicture(width, height, quantizer, (2**32 - 1 + seed) % 2**32)
            assert np.abs(whole(datagram).astype(float) - px).mean() < error


def test_noise_fits_a_datagram_by_coarser_steps() -> None:
    rough = np.random.default_rng(1).integers(0, 256, (480, 640, 3), np.uint8)
    datagram = encode(rough, 5)
    assert len(datagram) <= 65504
    header = UVLC.header(datagram)
    assert 2 < header.quantizer < 31
    with pytest.raises(ValueError, match="no picture of 100x80 px"):
        encode(np.zeros((80, 100, 3), np.uint8), 1)


def test_what_is_no_picture_is_refused() -> None:
    good = picture()
    grey = CodedPicture(WIDTH, HEIGHT, 31, 77)
    assert UVLC.header(good) == grey
    assert UVLC.header(b"") is PictureRefusal.TOO_SHORT
    assert UVLC.header(b"PaVE" + good) is PictureRefusal.BAD_MAGIC
    assert UVLC.header(picture(kind=1)) is PictureRefusal.INTER_PICTURE
    assert UVLC.header(picture(quantizer=0)) is PictureRefusal.BAD_MAGIC
    assert UVLC.header(packed(start(0) + "01" + "001" + "000" + "11111" + "0" * 40)) is PictureRefusal.BAD_SIZE
    assert UVLC.header(packed(start(0) + "10" + "111" + "000" + "11111" + "0" * 40)) is PictureRefusal.BAD_SIZE
    assert UVLC.decode(good, CodedPicture(320, 240, 31, 77)) is PictureRefusal.BAD_SIZE
    assert UVLC.decode(picture(rows=8), grey) is PictureRefusal.BAD_CODE
    too_far = "0" + "10000001" + "0010000000" + "0000001 11111 1 0" * 2 + "101" + "0010000000" * 5
    assert UVLC.decode(picture(too_far), grey) is PictureRefusal.BAD_CODE
    assert UVLC.decode(picture("0" + "00000000" + "0010000000" * 6), grey) is PictureRefusal.BAD_CODE


def test_a_torn_picture_is_refused_wherever_it_is_torn() -> None:
    datagram = encode(image(1, WIDTH, HEIGHT), 9)
    header = UVLC.header(datagram)
    assert isinstance(header, CodedPicture)
    for size in range(0, len(datagram) - 4, 4):
        assert UVLC.decode(datagram[:size], header) in (PictureRefusal.TORN, PictureRefusal.TOO_SHORT, PictureRefusal.BAD_CODE)


@given(st.binary(max_size=600), st.booleans())
def test_any_bytes_are_refused_or_a_whole_picture(data: bytes, begun: bool) -> None:
    datagram = (picture()[:12] if begun else b"") + data
    header = UVLC.header(datagram)
    if isinstance(header, CodedPicture):
        px = UVLC.decode(datagram, header)
        assert isinstance(px, PictureRefusal) or px.shape == (header.height, header.width, 3)


@given(st.lists(st.tuples(st.integers(12, 3000), st.integers(0, 7)), min_size=1, max_size=12))
def test_flipped_bits_are_refused_or_a_whole_picture(flips: list[tuple[int, int]]) -> None:
    datagram = bytearray(encode(image(2, WIDTH, HEIGHT), 9))
    for at, bit in flips:
        datagram[at % len(datagram)] ^= 1 << bit if at % len(datagram) >= 12 else 0
    px = UVLC.decode(bytes(datagram), CodedPicture(WIDTH, HEIGHT, 31, 9))
    assert isinstance(px, PictureRefusal) or px.shape == (HEIGHT, WIDTH, 3)
